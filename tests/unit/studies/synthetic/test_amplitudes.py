import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from vfm_sdm.errors import DatasetError
from vfm_sdm.studies.synthetic.amplitudes import PeakToPeak, compute_peak_to_peak, scale_to_amplitudes
from vfm_sdm.studies.synthetic.excitation import BendingMode, ForcedMotion
from vfm_sdm.studies.synthetic.pedestrians import Pedestrian

MODES = (
    BendingMode("vertical", 2.3, 14e3, end_restraint=0.2),
    BendingMode("vertical", 6.9, 14e3, half_waves=2, end_restraint=0.2),
    BendingMode("lateral", 1.6, 12e3),
)


@pytest.fixture(scope="module")
def motion():
    people = (
        Pedestrian("running", 75, 2.6, 1.0, 0.2, speed_m_s=2.8, seed=1),
        Pedestrian("jumping", 70, 2.2, 1.5, 0.3, seed=2),
    )
    return ForcedMotion(MODES, people, support_m=0.0, span_m=30.0, duration_s=13.0)


def vertical_targets(quarter_mm, middle_mm):
    return PeakToPeak("vertical", 0.25, quarter_mm), PeakToPeak("vertical", 0.5, middle_mm)


def test_two_cross_sections_swing_as_far_as_asked(motion):
    scaled = scale_to_amplitudes(motion, vertical_targets(7.5, 10.0), duration_s=10.0)
    for station, amplitude in ((0.25, 7.5), (0.5, 10.0)):
        found = compute_peak_to_peak(scaled, axis="vertical", station=station, duration_s=10.0)
        assert found == pytest.approx(amplitude, rel=1e-6)
        # By a filter of one's own over a longer series.
        time_s = np.arange(-4, 13, 1 / 200)
        raw = 1e3 * scaled.displacement(time_s, [[0, 0, 30 * station]])[:, 0, 1]
        swing = sosfiltfilt(butter(4, (1, 10), btype="bandpass", fs=200, output="sos"), raw)
        assert np.ptp(swing[(time_s >= 0) & (time_s < 10)]) == pytest.approx(amplitude, rel=5e-3)


def test_the_other_axis_and_everything_but_gains_stay_as_they_were(motion):
    scaled = scale_to_amplitudes(motion, vertical_targets(7.5, 10.0), duration_s=10.0)
    assert scaled.modes[2] == motion.modes[2]
    assert scaled.people == motion.people
    assert scaled.modes[0].gain != 1
    assert scaled.modes[1].gain != scaled.modes[0].gain


def test_scaling_does_not_depend_on_the_gains_it_starts_from(motion):
    once = scale_to_amplitudes(motion, vertical_targets(7.5, 10.0), duration_s=10.0)
    twice = scale_to_amplitudes(once, vertical_targets(7.5, 10.0), duration_s=10.0)
    assert once.modes == twice.modes


def test_targets_that_cannot_be_met_are_refused(motion):
    with pytest.raises(DatasetError, match="targets: expected amplitudes that the modes can have"):
        scale_to_amplitudes(motion, vertical_targets(1.0, 10.0), duration_s=10.0)
    mixed = PeakToPeak("vertical", 0.25, 5.0), PeakToPeak("lateral", 0.5, 5.0)
    with pytest.raises(DatasetError, match="targets: expected one axis"):
        scale_to_amplitudes(motion, mixed, duration_s=10.0)
