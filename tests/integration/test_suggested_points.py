"""Points that nobody named, on the demonstration's films: they are found, measured, and scatter as predicted."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from vfm_sdm.inputs.session import Site, read_session, write_session
from vfm_sdm.measurement import measure
from vfm_sdm.studies.planning.suggestion import suggest_points
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_demo

pytestmark = pytest.mark.slow
SEED = 1


@pytest.fixture(scope="module")
def suggested(tmp_path_factory):
    """The demonstration without its points and what refers to them, the suggestion, and its measurement."""
    folder = tmp_path_factory.mktemp("suggested")
    session = read_session(make_demo(folder / "recording", seed=SEED))
    site = Site(**{**session.site.model_dump(), "range": (), "length": ()})
    found = suggest_points(session.model_copy(update={"point": (), "site": site}))
    written = write_session(folder / "session.toml", found.session)
    return found, measure(read_session(written)).displacement


def errors_of(displacement, point):
    """Errors of a suggested point (T, 3) [mm], without gains and offsets, whose uncertainty is not scatter."""
    one, plan = displacement.sel(point=point.name), demo_plan(seed=SEED)
    place = np.nanmedian(one["position"].values, axis=0)
    truth = 1e3 * plan.motion.displacement(plan.frame_times(0), place[None])[:, 0] * (not point.static)
    parts = np.column_stack([truth, np.ones(len(truth))])
    return one["displacement"].values - parts @ np.linalg.lstsq(parts, one["displacement"].values, rcond=None)[0]


def test_points_are_spread_along_the_span_and_on_what_is_still(suggested):
    found, _ = suggested
    structure, still = ([p for p in found.points if p.static is static] for static in (False, True))
    along = np.array([p.along_m for p in structure])
    assert len(structure) == 8
    assert len(still) == 3
    assert (np.diff(along) > 0).all()
    assert np.diff(along).max() < 0.3 * np.ptp(along)
    assert max(p.moved_px for p in still) < 0.05 < 0.3 < min(p.moved_px for p in structure)


def test_points_scatter_as_predicted(suggested):
    found, displacement = suggested
    achieved = np.array([errors_of(displacement, point).std(axis=0) for point in found.points])
    predicted = np.array([point.std_mm for point in found.points])
    assert (achieved <= 1.5 * predicted).mean() >= 0.9
    assert np.median(achieved / predicted) > 0.5  # an interval that holds everything tells nothing
    ranked = spearmanr(np.linalg.norm(predicted, axis=1), np.linalg.norm(achieved, axis=1)).statistic
    assert ranked >= 0.7
