"""A load test from a film of three minutes: levels beside vibration, what remains, and a truck that passes.

Cameras and budget are those of the demonstration; what its points do is a load test: a footbridge is loaded in steps,
each is left to stand while people walk by, and a vehicle crosses at the end. Steps are judged as
``vfm-sdm load-test`` does it, the crossing as ``vfm-sdm passages``.

    python examples/plot_load_test.py [FOLDER]
"""

import numpy as np
from gallery import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PALE,
    POINT,
    VERMILION,
    demo_session,
    finish,
    headline,
    new_figure,
    run_folder,
    save,
    simulated_tracks,
)  # fmt: skip

from vfm_sdm import Measurement
from vfm_sdm.analysis.load_test import LoadPlan, LoadStep, Passage, judge_load_test, judge_passages

LOADS_KN = np.array([0.0, 10.0, 20.0, 30.0, 0.0])
LEVELS_MM = np.array([0.0, 1.05, 2.1, 3.15, 0.12])
CALCULATED_MM = 0.11 * LOADS_KN
STAND_S, MOVE_S = 24.0, 6.0
PASSAGE = Passage(156.0, 160.0, 5.0)
DURATION_S, RATE_HZ, NOISE_PX = 170.0, 25.0, 0.03

demo = Measurement(demo_session(), run_folder())
cameras = demo.cameras
begin_s = np.arange(len(LOADS_KN)) * (STAND_S + MOVE_S)
time_s = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
edges = np.column_stack([begin_s, begin_s + STAND_S]).ravel()
share = np.clip((time_s - PASSAGE.begin_s) / (PASSAGE.end_s - PASSAGE.begin_s), 0, 1)
since = np.clip(time_s - PASSAGE.begin_s, 0, None)
vibration = 0.25 * np.sin(2 * np.pi * 2.3 * time_s) * (0.6 + 0.4 * np.sin(0.21 * time_s)) * (time_s < begin_s[-1])
crossing = 1.6 * np.sin(np.pi * share) + 0.12 * np.sin(2 * np.pi * 2.3 * since) * np.exp(-0.2 * since)
vertical_mm = np.interp(time_s, edges, np.repeat(LEVELS_MM, 2)) + vibration + crossing

# Every point on the structure moves as much as the one at mid-span did in the demonstration's truth, or stands still.
names = [point.name for point in demo.session.point]
moves = np.array([0.0 if point.static else 1.0 for point in demo.session.point])
rest = demo.displacement["position"].isel(time=0).values
motion = np.zeros((len(time_s), len(names), 3))
motion[..., 1] = 1e-3 * vertical_mm[:, None] * moves
places = (rest + motion) @ cameras.frame.rotation  # of the structure's axes in the reference camera's
tracks = {}
for number, (view, camera) in enumerate(zip(cameras.rig.names, cameras.rig.cameras, strict=True)):
    seen = simulated_tracks(time_s, places, camera, view, noise_px=NOISE_PX, seed=number)
    tracks[view] = seen.assign_coords(point=names)
found = Measurement(demo.session).given(cameras=cameras, tracks=tracks, frames={}).displacement

steps = zip(LOADS_KN, begin_s, CALCULATED_MM, strict=True)
plan = LoadPlan(
    tuple(LoadStep(load, at, at + STAND_S, {(POINT, "vertical"): value}) for load, at, value in steps), "kN"
)
judged = judge_load_test(found, plan).sel(point=POINT, axis="vertical")
crossed = judge_passages(found, [PASSAGE]).sel(point=POINT, axis="vertical").isel(passage=0)

figure = new_figure(10, 5.6)
grid = figure.add_gridspec(2, 2, width_ratios=(1.7, 1))
history = finish(figure.add_subplot(grid[0, :]), f"vertical displacement of {POINT}")
values = found["displacement"].sel(point=POINT, axis="vertical")
history.plot(time_s, values, color=GREY, linewidth=0.6)
for at, level in zip(begin_s, judged["deflection"].values, strict=True):
    history.axvspan(at, at + STAND_S, color=PALE, alpha=0.7, linewidth=0)
    history.plot([at, at + STAND_S], [level, level], color=VERMILION, linewidth=2)
history.set(xlabel="time [s]", ylabel="[mm]", xlim=(0, DURATION_S))

truck = finish(figure.add_subplot(grid[1, 0]), "the passage, and its static part")
near = slice(PASSAGE.begin_s - 2, PASSAGE.end_s + 6)
truck.plot(time_s, values, color=GREY, linewidth=0.8)
seconds = np.linspace(PASSAGE.begin_s, PASSAGE.end_s, crossed.sizes["station"])
truck.plot(seconds, crossed["static"] + float(judged["residual"]), color=BLUE, linewidth=1.6)
truck.set(xlabel="time [s]", ylabel="[mm]", xlim=(near.start, near.stop), ylim=(-0.5, 2.4))
low, high = (float(crossed[f"amplification_{end}"]) for end in ("low", "high"))
truck.text(0.98, 0.9, f"amplification {float(crossed['amplification']):.2f} ({low:.2f} to {high:.2f})",
           transform=truck.transAxes, ha="right", fontsize=9, color=INK)  # fmt: skip

diagram = finish(figure.add_subplot(grid[1, 1]), "deflection against load", grid="both")
diagram.errorbar(LOADS_KN, judged["deflection"], yerr=judged["expanded_uncertainty"], color=BLUE, marker="o",
                 markersize=4, capsize=3, linewidth=0.8, label="measured, 95 %")  # fmt: skip
diagram.plot(LOADS_KN, CALCULATED_MM, color=ORANGE, marker="x", linestyle="none", label="calculated")
diagram.set(xlabel="load [kN]", ylabel="[mm]")
diagram.legend(fontsize=8, frameon=False)

residual, half = 100 * float(judged["residual_share"]), 50 * float(judged["share_high"] - judged["share_low"])
exceeded = float(judged["ratio_exceeded"].sel(step=4))
headline(
    figure,
    f"{residual:.1f} +- {half:.1f} % remain after unloading; it is stiffer than calculated with P = {1 - exceeded:.2f}",
)
save(figure, __file__)
