"""What every source contributes to the cameras' uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from measurements import simulate
from planned import a_plan
from vfm_sdm.geometry.propagation import compute_gain_sensitivity
from vfm_sdm.stages.cameras.contributions import share_variance
from vfm_sdm.stages.cameras.solution import read_solution, write_solution
from vfm_sdm.studies.planning.layout import lay_out
from vfm_sdm.studies.planning.simulation import adjust, list_matches


@pytest.fixture(scope="module")
def run():
    return simulate(3, focal_std=0.03, range_std=0.02, length_std=0.01)


def test_contributions_add_up_to_the_covariance(run):
    parts = sum(one.covariance for one in run.solution.contributions)
    scale = np.sqrt(np.diag(run.solution.covariance))
    scale[scale == 0] = 1.0
    np.testing.assert_allclose(
        parts / np.outer(scale, scale), run.solution.covariance / np.outer(scale, scale), atol=1e-6
    )


def test_every_lens_and_reading_has_its_own(run):
    named = {one.source for one in run.solution.contributions}
    readings = {q.name for q in run.solution.quantities if q.measured}
    assert readings <= named
    assert {f"focal {view}" for view in run.solution.rig.names} <= named
    assert {"matches", "points off the face"} <= named


@pytest.mark.parametrize("field", ["baseline", "perpendicular_distance", "longitudinal_distance"])
def test_a_share_is_what_a_less_certain_reading_adds(field):
    """The adjustment weighs by variances: its result's variance grows with a reading's by the reading's own part."""
    step = 1.005
    laid = lay_out(a_plan())
    matches = list_matches(laid)
    before = adjust(laid, matches)
    reading = getattr(laid.session.site, field)
    wider = reading.model_copy(update={"std": step * reading.std})
    site = laid.session.site.model_copy(update={field: wider})
    after = adjust(replace(laid, session=laid.session.model_copy(update={"site": site})), matches)
    slope = np.pad(compute_gain_sensitivity(laid.pixels[:, :1], laid.rig)[0, :, 0, 0], (0, 3))
    found, more = (float(slope @ one.covariance @ slope) for one in (before, after))
    share = share_variance(before.contributions, before.covariance, slope)[field.replace("_", " ")]
    assert share > 1e-5
    assert (more / found - 1) / (step**2 - 1) == pytest.approx(share, rel=0.02)


def test_what_others_that_agree_add_is_a_share_of_its_own(run):
    covariance, slope = run.solution.covariance, np.zeros(len(run.solution.covariance))
    slope[0] = 1.0
    shares = share_variance(run.solution.contributions, 2 * covariance, slope)
    assert shares["other cameras that agree as well"] == pytest.approx(0.5, abs=1e-6)
    assert sum(shares.values()) == pytest.approx(1)
    assert share_variance((), covariance, slope) == {}


def test_contributions_are_kept_with_the_cameras(run, tmp_path):
    kept, _ = read_solution(write_solution(tmp_path / "cameras.toml", run.solution, "key"))
    assert [one.source for one in kept.contributions] == [one.source for one in run.solution.contributions]
    for one, other in zip(kept.contributions, run.solution.contributions, strict=True):
        np.testing.assert_array_equal(one.factor, other.factor)
