"""Displacement from a simulated accelerometer by the paper's recipe, with both rules of integration, beside the truth.

The motion is that of the virtual field test ``data-2`` at mid-span. Everything is compared at 1 to 10 Hz, and while the
videos run: the filter rings at the end of a recording, so the sensor records two seconds more.

    python examples/plot_accelerometer.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

from matplotlib.figure import Figure

from vfm_sdm.analysis.evaluation import read_sensors
from vfm_sdm.analysis.evaluation.metrics import gain, nrmse_range
from vfm_sdm.inputs.sensors.accelerometer import Integration, RecipeSettings
from vfm_sdm.signals.filters import band_pass
from vfm_sdm.studies.synthetic.presets import preset
from vfm_sdm.studies.synthetic.sensors import write_acceleration

MARGIN_S = 2.0
RULES: tuple[Integration, ...] = ("trapezoid", "spline")

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
folder.mkdir(parents=True, exist_ok=True)

# What the sensor records: columns time [s], lateral, vertical, longitudinal [g], on its own clock.
plan = preset("data-2", "small")
mounted = plan.accelerometers[1]
position = [point.position for point in plan.points if point.name == mounted.point]
recording = write_acceleration(
    folder / "acceleration.csv",
    mounted.sensor,
    lambda time_s: plan.motion.acceleration(time_s, position)[:, 0],
    duration_s=plan.duration_s + MARGIN_S - mounted.sensor.clock_offset_s,
    seed=1,
)

figure = Figure(figsize=(8, 4), layout="constrained")
axes = figure.add_subplot(xlabel="time of the video [s]", ylabel="vertical, positive down [mm]")
for rule in RULES:
    reference = read_sensors([recording], settings=RecipeSettings(integration=rule))
    known = reference.dropna("time")
    rate_hz = float(reference.attrs["sampling_rate_hz"])
    measured_mm = known["displacement"].sel(axis="vertical").values[:, 0]
    true_time_s = mounted.sensor.true_time(known["time"].values)
    truth_mm = 1e3 * plan.motion.displacement(true_time_s, position)[:, 0, 1]
    filmed = true_time_s <= plan.duration_s
    measured, truth = (band_pass(mm, rate_hz, (1.0, 10.0))[filmed] for mm in (measured_mm, truth_mm))
    label = f"{rule}: gain {gain(measured, truth)[0]:.4f}, NRMSE {nrmse_range(measured, truth):.4f}"
    axes.plot(true_time_s[filmed], measured, lw=0.9, label=label)
axes.plot(true_time_s[filmed], truth, "k--", lw=0.9, label="truth")
axes.set_title(f"{mounted.point}, {mounted.sensor.name}, 1 to 10 Hz")
axes.legend()
figure.savefig(folder / "accelerometer.png", dpi=120)
print(f"written: {folder / 'accelerometer.png'}")
