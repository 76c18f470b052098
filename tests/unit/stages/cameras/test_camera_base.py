"""What estimators return, and finding them by name."""

import sys
import types

import numpy as np
import pytest

from vfm_sdm.core.parts import BUILT_IN, Part
from vfm_sdm.errors import BackendUnavailableError, CameraError, DatasetError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Method
from vfm_sdm.stages.cameras.base import CameraEstimate, estimator_of, find_estimator
from vfm_sdm.stages.matching.matches import Matches

POINTS = np.arange(10.0).reshape(5, 2)


class TestFindEstimator:
    @pytest.mark.parametrize("name", ["file", "chessboard", "two-view"])  # the others need more than the core
    def test_finds_by_name(self, name):
        estimator = find_estimator(name)
        assert estimator.name == name
        assert callable(estimator.estimate)

    def test_passes_options_on(self):
        assert find_estimator("chessboard", fix_k3=False).fix_k3 is False

    def test_unknown_name_is_refused(self):
        with pytest.raises(
            BackendUnavailableError, match=r"expected one of \['chessboard', 'file', .*'sfm', .*'vggt'\], got 'colmap'"
        ):
            find_estimator("colmap")

    def test_takes_the_settings_that_it_names_from_the_session(self, monkeypatch):
        module = types.ModuleType("vfm_sdm_test_estimator")
        module.Mine = type("Mine", (), {"__init__": lambda self, **settings: setattr(self, "settings", settings)})
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setitem(BUILT_IN["cameras"], "mine", Part(f"{module.__name__}:Mine", ("sfm", "network")))
        method = Method(cameras="mine", matching="superpoint+superglue", sfm={"model": "folder"})
        assert estimator_of(method).settings == {"sfm": method.sfm, "network": method.network}
        assert estimator_of(Method(cameras="two-view")).name == "two-view"

    def test_imports_only_what_is_asked_for(self, monkeypatch):
        module = types.ModuleType("vfm_sdm_test_estimator")
        module.Mine = type("Mine", (), {"name": "mine"})
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setitem(BUILT_IN["cameras"], "mine", Part(f"{module.__name__}:Mine"))
        monkeypatch.setitem(BUILT_IN["cameras"], "broken", Part("vfm_sdm.no_such_module:Nothing"))
        assert find_estimator("mine").name == "mine"
        with pytest.raises(ModuleNotFoundError):
            find_estimator("broken")


class TestMatches:
    def test_holds_copies_that_cannot_be_changed(self):
        mine = POINTS.copy()
        matches = Matches(0, 1, mine, POINTS + 1)
        mine[0] = -1
        assert len(matches) == 5
        np.testing.assert_array_equal(matches.points_first, POINTS)
        with pytest.raises(ValueError, match="read-only"):
            matches.points_second[0] = 0

    @pytest.mark.parametrize(("first", "second"), [(1, 1), (-1, 0)])
    def test_views_must_differ(self, first, second):
        with pytest.raises(CameraError, match="matches: expected two different views"):
            Matches(first, second, POINTS, POINTS)

    def test_lengths_must_agree(self):
        with pytest.raises(CameraError, match="matches: expected as many points in both views, got 5 and 4"):
            Matches(0, 1, POINTS, POINTS[:4])

    def test_shape_is_checked(self):
        with pytest.raises(DatasetError, match="points_second: expected shape"):
            Matches(0, 1, POINTS, POINTS[:, :1])


def test_estimate_is_ok_unless_said_otherwise():
    rig = Rig(("a",), (Camera(np.diag([100.0, 100, 1]), (64, 48)),))
    estimate = CameraEstimate(rig)
    assert (estimate.status, estimate.matches, estimate.notes) == ("ok", (), ())
