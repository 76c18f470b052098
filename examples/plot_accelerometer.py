"""Displacement from a simulated accelerometer by the paper's recipe, with both rules of integration, beside the truth.

The motion is that of the virtual field test ``data-2`` at mid-span. Everything is compared at 1 to 10 Hz, and while the
videos run: the filter rings at the end of a recording, so the sensor records two seconds more.

    python examples/plot_accelerometer.py [FOLDER]
"""

import tempfile
from pathlib import Path

from gallery import BLUE, INK, VERMILION, finish, headline, new_figure, save

from vfm_sdm.analysis.evaluation import read_sensors
from vfm_sdm.analysis.evaluation.metrics import gain, nrmse_range
from vfm_sdm.inputs.sensors.accelerometer import Integration, RecipeSettings
from vfm_sdm.signals.filters import band_pass
from vfm_sdm.studies.synthetic.presets import preset
from vfm_sdm.studies.synthetic.sensors import write_acceleration

BAND_HZ = (1.0, 10.0)
MARGIN_S = 2.0
RULES: dict[Integration, str] = {"trapezoid": BLUE, "spline": VERMILION}

# What the sensor records: columns time [s], lateral, vertical, longitudinal [g], on its own clock.
plan = preset("data-2", "small")
mounted = plan.accelerometers[1]
position = [point.position for point in plan.points if point.name == mounted.point]
with tempfile.TemporaryDirectory() as folder:
    recording = write_acceleration(
        Path(folder) / "acceleration.csv",
        mounted.sensor,
        lambda time_s: plan.motion.acceleration(time_s, position)[:, 0],
        duration_s=plan.duration_s + MARGIN_S - mounted.sensor.clock_offset_s,
        seed=1,
    )
    references = {rule: read_sensors([recording], settings=RecipeSettings(integration=rule)) for rule in RULES}

figure = new_figure(10, 5.0)
both, errors = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1))
for rule, reference in references.items():
    known = reference.dropna("time")
    rate_hz = float(reference.attrs["sampling_rate_hz"])
    measured_mm = known["displacement"].sel(axis="vertical").values[:, 0]
    true_time_s = mounted.sensor.true_time(known["time"].values)
    truth_mm = 1e3 * plan.motion.displacement(true_time_s, position)[:, 0, 1]
    filmed = true_time_s <= plan.duration_s
    measured, truth = (band_pass(mm, rate_hz, BAND_HZ)[filmed] for mm in (measured_mm, truth_mm))
    time_s = true_time_s[filmed]
    both.plot(time_s, measured, color=RULES[rule], linewidth=1.5, label=f"{rule}")
    label = f"{rule}: gain {gain(measured, truth)[0]:.4f}, NRMSE {nrmse_range(measured, truth):.4f}"
    errors.plot(time_s, measured - truth, color=RULES[rule], linewidth=1.2, label=label)
both.plot(time_s, truth, color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label="truth")
both.set_ylabel("vertical, positive down [mm]")
both.legend(fontsize=8, frameon=False, loc="upper left")
finish(both, f"{mounted.point}, sensor {mounted.sensor.name}, {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz")
errors.set(xlabel="time of the video [s]", ylabel="less the truth [mm]", xlim=(time_s[0], time_s[-1]))
errors.legend(fontsize=8, frameon=False, loc="upper left")
finish(errors, "what is left")
figure.align_ylabels([both, errors])

headline(figure, "Displacement from an accelerometer, and what the rule of integration does to it")
save(figure, __file__)
