import numpy as np
import pytest

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.motion import ModalMotion, Mode, modal_displacement

SPAN = {"support_m": 2.0, "span_m": 10.0}
MIDDLE = [[5.0, 0.3, 7.0]]


def test_structure_is_exactly_at_rest_during_the_still_interval():
    motion = ModalMotion((Mode("vertical", 2.2, 4.0), Mode("longitudinal", 3.0, 1.0, half_waves=0)), **SPAN)
    time_s = np.linspace(0, 1.0, 101)
    moved = modal_displacement(time_s, MIDDLE, motion=motion)
    assert np.all(moved[time_s <= 0.4] == 0)
    assert np.abs(moved[time_s > 0.45]).max() > 1e-5


def test_displacement_is_the_damped_sine_once_the_onset_is_over():
    motion = ModalMotion((Mode("vertical", 2.2, 4.0, damping_ratio=0.02),), **SPAN)
    time_s = np.linspace(0.9, 5, 400)
    moved = modal_displacement(time_s, MIDDLE, motion=motion)
    elapsed, omega = time_s - 0.4, 2 * np.pi * 2.2
    expected = 4e-3 * np.exp(-0.02 * omega * elapsed) * np.sin(omega * np.sqrt(1 - 0.02**2) * elapsed)
    np.testing.assert_allclose(moved[:, 0, 1], expected, atol=1e-15)
    assert np.all(moved[:, 0, [0, 2]] == 0)


def test_modes_of_every_axis_add_up_along_their_own_axis():
    modes = (
        Mode("lateral", 1.4, 2.0),
        Mode("vertical", 2.2, 4.0),
        Mode("vertical", 5.0, 1.0),
        Mode("longitudinal", 3.0, 0.5),
    )
    time_s = np.linspace(0, 3, 91)
    points = [[5.0, 0.0, 4.0], [5.0, 0.0, 8.0]]
    together = modal_displacement(time_s, points, motion=ModalMotion(modes, **SPAN))
    alone = [modal_displacement(time_s, points, motion=ModalMotion((mode,), **SPAN)) for mode in modes]
    np.testing.assert_allclose(together, np.sum(alone, axis=0), atol=1e-15)
    for mode, axis in zip(modes, (0, 1, 1, 2), strict=True):
        assert np.ptp(together[:, 0, axis]) > 0.2e-3, mode


@pytest.mark.parametrize(
    ("axis", "half_waves", "expected"),
    [
        ("vertical", 1, [0, np.sqrt(0.5), 1, 0, 0, 0]),
        ("lateral", 2, [0, 1, 0, 0, 0, 0]),
        ("longitudinal", 0, [1, 1, 1, 1, 1, 1]),
        ("longitudinal", 1, [1, np.sqrt(0.5), 0, -1, 1, -1]),
    ],
)
def test_shapes_are_those_of_a_simple_span(axis, half_waves, expected):
    stations = np.array([2.0, 4.5, 7.0, 12.0, 0.0, 15.0])  # the last two lie beyond the supports
    points = np.column_stack([np.zeros((6, 2)), stations])
    mode = Mode(axis, 2.0, 3.0, half_waves=half_waves)
    moved = modal_displacement([1.63], points, motion=ModalMotion((mode,), **SPAN))[0]
    column = ("lateral", "vertical", "longitudinal").index(axis)
    reference = modal_displacement(
        [1.63], [[0, 0, 7.0]], motion=ModalMotion((Mode(axis, 2.0, 3.0, half_waves=0 if column == 2 else 1),), **SPAN)
    )[0, 0, column]
    np.testing.assert_allclose(moved[:, column] / reference, expected, atol=1e-12)


def test_onset_has_no_step_in_velocity_or_acceleration():
    motion = ModalMotion((Mode("vertical", 2.2, 4.0, damping_ratio=0.0),), **SPAN)
    step = 1e-3
    time_s = np.arange(0.3, 1.2, step)
    moved = modal_displacement(time_s, MIDDLE, motion=motion)[:, 0, 1]
    acceleration = np.diff(moved, 2) / step**2
    jump = np.abs(np.diff(acceleration)).max()
    assert jump < 0.02 * np.abs(acceleration).max()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": "sideways"}, "mode: expected an axis of"),
        ({"frequency_hz": 0.0}, "mode: expected frequency > 0"),
        ({"damping_ratio": 1.0}, "mode: expected frequency > 0, damping in"),
        ({"half_waves": -1}, "mode: expected frequency > 0, damping in"),
    ],
)
def test_mode_refuses_numbers_out_of_range(changes, message):
    with pytest.raises(DatasetError, match=message):
        Mode(**{"axis": "vertical", "frequency_hz": 2.0, "amplitude_mm": 1.0, **changes})


@pytest.mark.parametrize("changes", [{"span_m": 0.0}, {"onset_s": 0.0}, {"still_s": -0.1}, {"span_m": np.nan}])
def test_motion_refuses_numbers_out_of_range(changes):
    with pytest.raises(DatasetError, match="motion: expected span > 0 m"):
        ModalMotion(**{"modes": (), **SPAN, **changes})


def test_displacement_refuses_arrays_of_other_shapes():
    motion = ModalMotion((), **SPAN)
    with pytest.raises(DatasetError, match="positions: expected shape"):
        modal_displacement([0.0], [1.0, 2.0, 3.0], motion=motion)
    with pytest.raises(DatasetError, match="time_s: expected shape"):
        modal_displacement(0.0, MIDDLE, motion=motion)
