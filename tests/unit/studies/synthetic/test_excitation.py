from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.excitation import BendingMode, ForcedMotion, integrate_modes
from vfm_sdm.studies.synthetic.motion import ModalMotion, Mode, Motion
from vfm_sdm.studies.synthetic.pedestrians import Pedestrian

SPAN = {"support_m": 2.0, "span_m": 30.0, "duration_s": 8.0}
MODES = (
    BendingMode("vertical", 2.3, 14e3, damping_ratio=0.01),
    BendingMode("vertical", 7.1, 14e3, damping_ratio=0.012, half_waves=2),
    BendingMode("lateral", 1.6, 12e3, damping_ratio=0.01),
)
PEOPLE = (
    Pedestrian("running", 75, 2.6, 1.0, 0.2, speed_m_s=2.8, seed=1),
    Pedestrian("jumping", 70, 2.2, 1.5, 0.6, seed=2),
)
POINTS = np.array([[9.8, 0.0, 9.5], [9.8, 0.3, 17.0], [9.6, -0.4, 26.0]])


@pytest.fixture(scope="module")
def motion():
    return ForcedMotion(MODES, PEOPLE, **SPAN)


def test_modal_response_is_that_of_an_independent_solver():
    mode = BendingMode("vertical", 2.3, 14e3, damping_ratio=0.02, gain=1.5)
    step_s = 1e-3
    time_s = np.arange(4001) * step_s
    corners = np.array([0.0, 0.3, 0.5, 0.9, 1.7, 4.0])
    forces = np.array([300.0, 800.0, 800.0, 0.0, 400.0, 400.0])  # not from zero: rest must still be the start
    force = np.interp(time_s, corners, forces)
    q, rate, change = integrate_modes(force[:, None], (mode,), step_s=step_s)[:, :, 0]
    omega = 2 * np.pi * 2.3

    def equation(t, x):
        load = 1.5 * np.interp(t, corners, forces) / 14e3
        return [x[1], load - 2 * 0.02 * omega * x[1] - omega**2 * x[0]]

    exact = solve_ivp(equation, (0, 4), [0, 0], t_eval=time_s, rtol=1e-10, atol=1e-13, max_step=0.01).y
    np.testing.assert_allclose(q, exact[0], atol=1e-9 * 1e3 * np.abs(exact[0]).max())
    np.testing.assert_allclose(rate, exact[1], atol=1e-6 * np.abs(exact[1]).max())
    np.testing.assert_allclose(change, np.gradient(rate, step_s), atol=2e-3)


def test_free_decay_has_the_stated_frequency_and_damping():
    mode = BendingMode("lateral", 1.6, 10e3, damping_ratio=0.015)
    step_s = 1e-3
    force = np.zeros((20001, 1))
    force[1:6] = 1e5
    q = integrate_modes(force, (mode,), step_s=step_s)[0, :, 0]
    upward = np.flatnonzero((q[100:-1] < 0) & (q[101:] >= 0)) + 100
    crossings = upward + q[upward] / (q[upward] - q[upward + 1])
    period_s = np.diff(crossings).mean() * step_s
    assert 1 / period_s == pytest.approx(1.6 * np.sqrt(1 - 0.015**2), rel=1e-6)
    peaks = np.array([q[a:b].max() for a, b in pairwise(upward)])
    decrement = 2 * np.pi * 0.015 / np.sqrt(1 - 0.015**2)
    np.testing.assert_allclose(np.log(peaks[:-1] / peaks[1:]), decrement, rtol=1e-4)


def test_a_static_load_bends_the_span_as_the_beam_formula_says():
    # Pinned beam, load F at s: w(x) = 2 F L^3 / (pi^4 EI) sum sin(n pi s) sin(n pi x) / n^4.
    length, stiffness, mass_per_m, load = 30.0, 2.1e9, 900.0, 1000.0
    modes = tuple(
        BendingMode(
            "vertical",
            n**2 * np.pi / 2 * np.sqrt(stiffness / (mass_per_m * length**4)),
            mass_per_m * length / 2,
            damping_ratio=0.6,
            half_waves=n,
        )
        for n in range(1, 14)
    )
    at = 0.3
    force = load * np.array([mode.shape(np.asarray(at)) for mode in modes])
    q = integrate_modes(np.tile(force, (8000, 1)), modes, step_s=1e-3)[0, -1]
    x = np.array([0.3, 0.5, 0.8])
    bent = sum(q[i] * mode.shape(x) for i, mode in enumerate(modes))
    left, right = at * length, (1 - at) * length
    # Euler-Bernoulli, right of the load: F a (L - x) (2 L x - x^2 - a^2) / (6 L EI).
    place = x * length
    beam = load * left * (length - place) * (2 * length * place - place**2 - left**2) / (6 * length * stiffness)
    np.testing.assert_allclose(bent, beam, rtol=2e-4)
    assert beam[0] == pytest.approx(load * left**2 * right**2 / (3 * length * stiffness))


def test_the_structure_rests_until_the_first_person_starts(motion):
    assert motion.still_s == 1.0
    time_s = np.linspace(-1, 1.0, 300)
    for part in (motion.displacement, motion.velocity, motion.acceleration):
        assert np.all(part(time_s, POINTS) == 0)
    assert np.abs(motion.displacement([1.4], POINTS)).max() > 1e-4


@pytest.mark.parametrize("kind", ["forced", "modal"])
def test_acceleration_is_the_second_derivative_of_displacement(motion, kind):
    moving: Motion = motion
    if kind == "modal":
        moving = ModalMotion((Mode("vertical", 2.2, 4.0), Mode("lateral", 1.4, 2.0)), support_m=2.0, span_m=30.0)
    step = 2e-4
    time_s = np.array([0.5123, 0.77, 1.0304, 1.2345, 3.21, 5.5551, 7.9])  # within the onset and after it
    after, now, before = (moving.displacement(time_s + shift, POINTS) for shift in (step, 0, -step))
    exact = moving.acceleration(time_s, POINTS)
    assert np.abs(exact).max() > 0.5
    np.testing.assert_allclose((after - 2 * now + before) / step**2, exact, atol=1e-4 * np.abs(exact).max())


def test_velocity_is_the_derivative_of_displacement(motion):
    time_s, step = np.array([1.2345, 3.21, 7.9]), 1e-4
    change = motion.displacement(time_s + step, POINTS) - motion.displacement(time_s - step, POINTS)
    np.testing.assert_allclose(change / (2 * step), motion.velocity(time_s, POINTS), atol=1e-6)


def test_times_between_the_steps_of_the_integration_are_as_exact_as_those_on_them(motion):
    # A smooth signal at 0.1 ms: no step of 1 ms may show in the third difference.
    time_s = 4 + np.arange(2000) * 1e-4
    jerk = np.diff(motion.displacement(time_s, POINTS)[:, 1, 1], 3) / 1e-12
    assert np.abs(jerk).max() < 3 * np.abs(np.diff(motion.acceleration(time_s, POINTS)[:, 1, 1]) / 1e-4).max() + 1


def test_somebody_who_crosses_presses_the_span_down_by_the_weight():
    still = {"rate_variation": 0.0, "force_variation": 0.0}
    runner = Pedestrian("running", 80, 3.2, 0.5, 0.0, speed_m_s=3.0, **still)
    mode = BendingMode("vertical", 2.3, 14e3, damping_ratio=0.3)
    crossing = ForcedMotion((mode,), (runner,), support_m=0.0, span_m=30.0, duration_s=9.0)
    time_s = 5.5 + np.arange(0, 8) / 3.2 / 8 + np.array([[-0.3125], [0], [0.3125]])  # whole steps about mid-span
    mean = crossing.displacement(time_s.ravel(), [[0, 0, 15.0]])[:, 0, 1].mean()
    assert mean == pytest.approx(80 * 9.81 / (14e3 * (2 * np.pi * 2.3) ** 2), rel=0.05)


def test_shapes_follow_the_span_and_stay_at_their_end_value_beyond_it(motion):
    beyond = motion.displacement([3.0], [[0, 0, 2.0], [0, 0, -5.0], [0, 0, 32.0], [0, 0, 90.0]])[0]
    np.testing.assert_allclose(beyond[:, :2], 0, atol=1e-16)
    assert np.ptp(beyond[:, 2]) == 0
    quarter, middle = (replace(MODES[0]).shape(np.asarray(s)) for s in (0.25, 0.5))
    assert (quarter, middle) == (pytest.approx(np.sqrt(0.5)), pytest.approx(1.0))
    held = BendingMode("vertical", 2.0, 1e4, half_waves=2, end_restraint=1.0)
    step = 1e-6
    assert held.shape(np.asarray(step)) / step == pytest.approx(held.end_slope, abs=1e-4)
    pinned = BendingMode("vertical", 2.0, 1e4, half_waves=2)
    assert pinned.shape(np.asarray(step)) / step == pytest.approx(pinned.end_slope, rel=1e-6)


def test_longitudinal_sliding_follows_the_end_rotation_and_is_small(motion):
    time_s = np.linspace(1, 8, 500)
    moved = motion.displacement(time_s, POINTS)
    step = 1e-3
    at_end = motion.displacement(time_s, [[0, 0, 2.0 + step]])[:, 0, 1] / step
    np.testing.assert_allclose(moved[:, 1, 2], 0.3 * at_end, atol=1e-4 * np.abs(0.3 * at_end).max())
    assert 0 < np.ptp(moved[:, 1, 2]) < 0.05 * np.ptp(moved[:, 1, 1])


def test_gain_scales_a_mode_and_forces_of_people_add_up(motion):
    time_s = np.linspace(1, 8, 200)
    doubled = ForcedMotion(tuple(replace(mode, gain=2.0) for mode in MODES), PEOPLE, **SPAN)
    np.testing.assert_allclose(doubled.displacement(time_s, POINTS), 2 * motion.displacement(time_s, POINTS))
    alone = [ForcedMotion(MODES, (person,), **SPAN).displacement(time_s, POINTS) for person in PEOPLE]
    np.testing.assert_allclose(np.sum(alone, axis=0), motion.displacement(time_s, POINTS), atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": "longitudinal"}, "mode: expected an axis of"),
        ({"frequency_hz": 0.0}, "mode: expected frequency and mass > 0"),
        ({"modal_mass_kg": -1.0}, "mode: expected frequency and mass > 0"),
        ({"half_waves": 0}, "half waves >= 1"),
        ({"damping_ratio": 1.0}, r"damping in \[0, 1\)"),
        ({"end_restraint": 1.5}, r"restraint in \[0, 1\]"),
    ],
)
def test_impossible_modes_are_refused(changes, message):
    with pytest.raises(DatasetError, match=message):
        replace(MODES[0], **changes)


def test_impossible_motions_and_times_are_refused(motion):
    with pytest.raises(DatasetError, match="motion: expected span > 0 m"):
        ForcedMotion(MODES, (), **SPAN)
    with pytest.raises(DatasetError, match=r"time_s: expected times up to 8\.0 s, got 8\.1"):
        motion.displacement([1.0, 8.1], POINTS)
    with pytest.raises(DatasetError, match="time_s: expected times up to"):
        motion.displacement([np.nan], POINTS)
    with pytest.raises(DatasetError, match="positions: expected shape"):
        motion.displacement([1.0], POINTS[0])
