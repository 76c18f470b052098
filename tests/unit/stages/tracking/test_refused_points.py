"""Points that are refused before tracking: no track, a note, and no part in the audit."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from moving_frames import digitize, memory_video
from vfm_sdm.core.datasets import Status, make_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.outputs.results.notes import subset_notes
from vfm_sdm.stages.audit import AuditInputs
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.subset_design import design_subsets
from vfm_sdm.stages.tracking.template import TemplateTracker
from vfm_sdm.stages.tracking.views import track_views

POSITION = np.array([[40.0, 70.0], [110.0, 70.0]])
NAMES = ["flat", "rough"]


@pytest.fixture(scope="module")
def video():
    """The left half of the surface has no texture."""
    rng = np.random.default_rng(0)
    surface = 128 + 300 * gaussian_filter(rng.normal(0, 1, (140, 150)), 1.6)
    surface[:, :75] = 128.0
    return memory_video([digitize(shift(surface, (0, 0.3 * np.sin(k)), mode="nearest"), rng, 1.0) for k in range(8)])


@pytest.fixture(scope="module")
def tracks(video):
    subsets = dict(zip(NAMES, design_subsets(video, POSITION, NAMES, subset_px=31), strict=True))
    return track_views({"left": video}, places(), IcgnTracker(), subsets={"left": subsets})


def places():
    position = POSITION[None]
    return make_points(["left"], NAMES, position=position, position_std=0 * position, status=[["ok", "ok"]])


def test_a_refused_point_has_no_track_and_says_why(tracks):
    flat, rough = (tracks["left"].sel(point=name) for name in NAMES)
    assert (flat["status"] == Status.LOST).all()
    assert np.isnan(flat["position"]).all()
    assert flat["subset_status"].item() == PointStatus.NO_TEXTURE
    assert (rough["status"] == Status.OK).all()
    assert rough["subset_status"].item() == PointStatus.OK


def test_a_note_names_the_point_and_a_place_that_would_do(tracks):
    u, v = tracks["left"]["nearest_texture"].sel(point="flat").values
    assert subset_notes(tracks) == [
        f"point 'flat' in view 'left': not tracked: no texture to follow; name another: ({u:.0f}, {v:.0f}) would do"
    ]
    assert 60 < u < 110


def test_the_audit_leaves_it_out(tracks):
    points = [SimpleNamespace(name=name, static=False) for name in NAMES]
    session = SimpleNamespace(point=points, view=[SimpleNamespace(name="left")])
    assert AuditInputs(session=session, tracks=tracks).moving == ["rough"]
    assert AuditInputs(session=session, tracks={}).moving == NAMES


def test_trackers_that_compare_no_designed_subsets_are_left_as_they_are(video):
    subsets = dict(zip(NAMES, design_subsets(video, POSITION, NAMES, subset_px=31), strict=True))
    found = track_views({"left": video}, places(), TemplateTracker(subset_px=31), subsets={"left": subsets})["left"]
    assert "warp" not in found
    assert found.attrs["tracker"] == "template"
