"""Displacement from video and accelerometer together: what the frames miss, and a gap that is bridged.

Records are simulated: 30 frames a second with slow errors and a second without values, and a sensor of 200 Hz whose
clock, gain and axes are not those of the video. Five modes up to 38 Hz move the point, which no video at 30 frames a
second can show.

    python examples/plot_fusion.py [FOLDER]
"""

import numpy as np
from gallery import BLUE, INK, ORANGE, PALE, SKY, VERMILION, finish, headline, new_figure, rms, save

from vfm_sdm.analysis.fusion import fuse
from vfm_sdm.signals.spectrum import amplitude_spectrum
from vfm_sdm.studies.synthetic.sensed_point import STATIC, SensedPoint, record_point

AXIS, GAP_S = "vertical", (12.0, 13.0)

displacement, acceleration, truth = record_point(SensedPoint(duration_s=30.0, gap_s=GAP_S), seed=1)
fused = fuse(displacement, acceleration, "mid", axes=[AXIS], static=STATIC).sel(axis=AXIS)

frames_s, time_s, true_s = (one["time"].values for one in (displacement, fused, truth))
video = displacement["displacement"].sel(point="mid", axis=AXIS).values
values, std = fused["displacement"].values, fused["displacement_std"].values
exact = truth["displacement"].sel(axis=AXIS).values
error_mm = values - np.interp(time_s, true_s, exact)
video_error_mm = video - np.interp(frames_s, true_s, exact)

figure = new_figure(10, 6.4)
grid = figure.add_gridspec(2, 2, height_ratios=(1.15, 1))
near, gap, spectra = (figure.add_subplot(place) for place in (grid[0, :], grid[1, 0], grid[1, 1]))

window = (14.0, 15.0)
chosen, seen, known = ((t >= window[0]) & (t <= window[1]) for t in (time_s, frames_s, true_s))
near.fill_between(
    time_s[chosen], *(values[chosen] + k * std[chosen] for k in (-2, 2)), color=SKY, alpha=0.5, linewidth=0
)
near.plot(time_s[chosen], values[chosen], color=BLUE, linewidth=1.4, label="fused, with 95 %")
near.plot(true_s[known], exact[known], color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label="truth")
near.plot(frames_s[seen], video[seen], "o", color=ORANGE, markersize=4, label="video")
near.set(xlabel="time [s]", ylabel="vertical [mm]", xlim=window)
near.legend(fontsize=8, frameon=False, loc="upper right", ncols=3)
finish(
    near, f"a second of it: error {1e3 * rms(error_mm):.0f} um fused, {1e3 * rms(video_error_mm):.0f} um of the video"
)

chosen = (time_s > GAP_S[0] - 1) & (time_s < GAP_S[1] + 1)
gap.axvspan(*GAP_S, color=PALE)
gap.fill_between(time_s[chosen], -1960 * std[chosen], 1960 * std[chosen], color=SKY, alpha=0.5, linewidth=0)
gap.plot(time_s[chosen], 1e3 * error_mm[chosen], color=BLUE, linewidth=1.0)
gap.set(xlabel="time [s]", ylabel="error [um]", xlim=(GAP_S[0] - 1, GAP_S[1] + 1))
finish(gap, "no video for a second: error and 95 % band")

for clock, series, color, label in (
    (frames_s, video, ORANGE, "video"),
    (time_s, values, BLUE, "fused"),
    (true_s, exact, VERMILION, "truth"),
):
    frequency_hz, amplitude_mm = amplitude_spectrum(clock, series)
    style = (0, (2, 2)) if label == "truth" else "solid"
    spectra.loglog(frequency_hz, amplitude_mm, color=color, linewidth=1.0, linestyle=style, label=label)
spectra.set(xlabel="frequency [Hz]", ylabel="amplitude [mm]", xlim=(0.2, 60), ylim=(1e-4, 2))
spectra.legend(fontsize=8, frameon=False, loc="lower left")
finish(spectra, "the video ends at 15 Hz, the sensor goes on", grid="both")

gain, gain_std = float(fused["gain"]), float(fused["gain_std"])
headline(
    figure, f"Video and accelerometer together; gain {gain:.4f} +- {gain_std:.4f}, true {1 / SensedPoint().gain:.4f}"
)
save(figure, __file__)
