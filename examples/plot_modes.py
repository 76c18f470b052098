"""Modes of a structure from a minute of its displacement: frequency, damping and shape, beside the truth.

The displacement is simulated, not filmed: six points of a bridge's girder, one lateral and two vertical bending modes,
driven by the wind, with the noise of a good measurement. `vfm-sdm modes RUN` does the same with a run folder.

    python examples/plot_modes.py [FOLDER]
"""

import numpy as np
import xarray as xr
from gallery import INK, finish, headline, new_figure, save
from scipy.signal import lfilter

from vfm_sdm.analysis.modal import identify_modes

RATE_HZ, SECONDS, NOISE_MM = 30.0, 60.0, 0.02
TRUE = (("lateral", 1.57, 0.010, 1), ("vertical", 2.31, 0.011, 1), ("vertical", 6.9, 0.013, 2))
AXES = ("lateral", "vertical", "longitudinal")
rng = np.random.default_rng(7)
count, station = round(RATE_HZ * SECONDS), np.linspace(0.1, 0.9, 6)

values = NOISE_MM * rng.normal(size=(count, len(station), 3))
for axis, hertz, damping, waves in TRUE:
    pole = np.exp(2 * np.pi * hertz * (1j - damping) / RATE_HZ)
    wind = np.sqrt(1 - abs(pole) ** 2) * (rng.normal(size=count) + 1j * rng.normal(size=count))
    modal = lfilter([1], [1, -pole], wind).real / hertz
    values[:, :, AXES.index(axis)] += np.outer(modal, np.sin(waves * np.pi * station))
place = np.zeros(values.shape)
place[:, :, 2] = 28.8 * station
displacement = xr.Dataset(
    {
        "displacement": (("time", "point", "axis"), values, {"units": "mm"}),
        "displacement_std": (("time", "point", "axis"), np.full(values.shape, NOISE_MM), {"units": "mm"}),
        "position": (("time", "point", "axis"), place, {"units": "m"}),
        "status": (("time", "point"), np.zeros(values.shape[:2], np.int8)),
    },
    {"time": np.arange(count) / RATE_HZ, "point": [f"p{i}" for i in range(6)], "axis": list(AXES)},
)
modes = identify_modes(displacement)

figure = new_figure(10, 6.0)
grid = figure.add_gridspec(3, 2, width_ratios=(1.3, 1))
spectrum = figure.add_subplot(grid[:, 0], xlabel="frequency [Hz]", ylabel="order of the model")
of_mode = modes["pole_mode"].values >= 0
for which, colour, label in ((~of_mode, "#BBBBBB", "pole"), (of_mode, "#D55E00", "pole of a mode")):
    hertz, order = modes["pole_frequency"].values[which], modes["pole_order"].values[which]
    spectrum.plot(hertz, order, ".", color=colour, label=label)
power = spectrum.twinx()
power.semilogy(modes["line_frequency"], modes["singular_value"].isel(rank=0), color="#0072B2", linewidth=0.9)
power.set_yticks([])
spectrum.set(xlim=(0, 12), ylim=(0, 44))
spectrum.legend(fontsize=8, frameon=False, loc="lower right")
finish(spectrum, "singular value of the spectra (line), and poles by order")

for row, (axis, hertz, damping, waves) in enumerate(TRUE):
    panel = figure.add_subplot(grid[row, 1])
    one = modes.isel(mode=int(np.abs(modes["frequency"].values - hertz).argmin()))
    true = np.sin(waves * np.pi * station)
    shape = one["shape"].sel(axis=axis).values.real
    shape *= np.sign(shape @ true)
    panel.plot(28.8 * station, true / np.abs(true).max(), color=INK, linestyle=":", label="true")
    panel.plot(28.8 * station, shape, "o-", color="#0072B2", label="found")
    told = ["{:.3f} ({:.3f} to {:.3f}) Hz", "{:.1f} ({:.1f} to {:.1f}) %"]
    for number, (name, factor) in enumerate((("frequency", 1), ("damping_ratio", 100))):
        told[number] = told[number].format(*(factor * float(one[name + end]) for end in ("", "_low", "_high")))
    finish(panel, f"{axis}: {told[0]}, true {hertz}\ndamping {told[1]}, true {100 * damping:.1f}")
    panel.tick_params(labelbottom=row == 2)
panel.set_xlabel("along the structure [m]")
panel.legend(fontsize=8, frameon=False)

headline(figure, f"{SECONDS:.0f} s of displacement: {modes.sizes['mode']} modes, with 95 % intervals")
save(figure, __file__)
