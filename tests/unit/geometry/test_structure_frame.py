import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.structure_frame import StructureFrame, compute_view_angle, structure_from_cam1
from vfm_sdm.outputs.plots import positive_direction
from vfm_sdm.outputs.report import find_language


def test_the_angle_is_that_of_the_right_triangle():
    assert compute_view_angle(9.8, 22.4) == pytest.approx(np.arctan(9.8 / 22.4))
    assert compute_view_angle(5.0, 0.0) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(("across", "along"), [(0.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (float("nan"), 1.0)])
def test_impossible_distances_are_refused(across, along):
    with pytest.raises(CameraError, match="expected perpendicular > 0 and longitudinal >= 0"):
        compute_view_angle(across, along)


@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_axes_of_a_level_camera(side, sign):
    angle = 0.4
    lateral, vertical, longitudinal = structure_from_cam1(angle, side=side)
    # The optical axis runs away from the camera towards the face by sin(angle) on either side.
    assert lateral @ [0, 0, 1] == pytest.approx(np.sin(angle))
    assert lateral @ [1, 0, 0] == pytest.approx(sign * np.cos(angle))
    np.testing.assert_allclose(vertical, [0, 1, 0])
    assert abs(longitudinal @ [0, 0, 1]) == pytest.approx(np.cos(angle))
    np.testing.assert_allclose(np.cross(lateral, vertical), longitudinal, atol=1e-12)


@pytest.mark.parametrize("side", ["right", "left"])
def test_longitudinal_is_to_the_left_for_one_who_faces_the_structure(side):
    """As figures and reports say, on whichever side of the camera the structure lies."""
    lateral, vertical, longitudinal = structure_from_cam1(0.7, side=side, pitch_rad=0.1, roll_rad=-0.05)
    right_of_observer = np.cross(vertical, lateral)  # down and ahead, as x is of y and z in a picture
    np.testing.assert_allclose(longitudinal, -right_of_observer, atol=1e-12)
    assert "to the left" in positive_direction("structure", "longitudinal")
    for code, words in (("en", "to the left"), ("de", "nach links")):
        assert words in find_language(code).word("direction", "longitudinal")


def test_upward_pitch_lifts_the_optical_axis():
    vertical = structure_from_cam1(0.3, pitch_rad=0.1)[1]
    assert vertical @ [0, 0, 1] == pytest.approx(-np.sin(0.1))


def test_clockwise_roll_lowers_the_right_side():
    vertical = structure_from_cam1(0.3, roll_rad=0.1)[1]
    assert vertical @ [1, 0, 0] == pytest.approx(np.sin(0.1))


@given(*[st.floats(-1.5, 1.5)] * 3)
def test_always_a_rotation(angle, pitch, roll):
    for side in ("right", "left"):
        R = structure_from_cam1(angle, pitch_rad=pitch, roll_rad=roll, side=side)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)


def test_a_reflection_is_refused():
    with pytest.raises(CameraError, match="expected a rotation matrix"):
        StructureFrame(np.diag([1.0, 1.0, -1.0]))
