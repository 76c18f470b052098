"""A tracker by hand: one point of one recording, followed by two trackers.

Trackers are found by their names and take a recording and pixels in its first picture. ``template`` finds where the
square around the point fits best, in steps of a sixteenth of a pixel; ``icgn`` has no steps and lets the square stretch
and shear, and states an uncertainty that follows from the picture's noise.

    python examples/plot_tracker_by_hand.py [FOLDER]
"""

import numpy as np
from gallery import BLUE, INK, POINT, VERMILION, demo_session, finish, headline, new_figure, rms, save
from matplotlib.patches import Rectangle

from vfm_sdm import find_tracker, open_video

session = demo_session()
view = session.view[0]
pixel = next(point.pixel for point in session.point if point.name == POINT)
subset_px = session.method.subset_px
recording = open_video(session.resolve(view.video))
tracks = {
    name: find_tracker(name, subset_px=subset_px).track(recording, np.array([pixel]), names=[POINT])
    for name in ("icgn", "template")
}

figure = new_figure(10, 4.8)
grid = figure.add_gridspec(2, 2, width_ratios=(0.8, 1.4), height_ratios=(1.5, 1))

# What is followed: the square around the point, and where the point went, ten times as large as it is.
scale, margin = 10, 75
picture = figure.add_subplot(grid[:, 0])
picture.imshow(recording.first_frame().luma, cmap="gray", interpolation="nearest")
corner = np.round(pixel) - subset_px / 2
picture.add_patch(Rectangle(corner, subset_px, subset_px, fill=False, edgecolor="#FFD54F", linewidth=1.6))
moved = tracks["icgn"]["position"].values[:, 0] - pixel
picture.plot(*(np.array(pixel) + scale * moved).T, color="#FFD54F", linewidth=1.0)
picture.set_xlim(pixel[0] - margin, pixel[0] + margin)
picture.set_ylim(pixel[1] + margin, pixel[1] - margin)
picture.set(xticks=[], yticks=[])
picture.set_title(
    f"{subset_px} x {subset_px} px, and the path {scale} times as large", loc="left", fontsize=10, color=INK
)

path = figure.add_subplot(grid[0, 1], ylabel="[px]")
difference = figure.add_subplot(grid[1, 1], xlabel="time [s]", ylabel="[px]", sharex=path)
for column, (direction, colour) in enumerate({"u, to the right": BLUE, "v, down": VERMILION}.items()):
    both = {name: dataset["position"].values[:, 0, column] - pixel[column] for name, dataset in tracks.items()}
    time_s = tracks["icgn"]["time"].values
    path.plot(time_s, both["icgn"], color=colour, linewidth=1.5, label=f"{direction}: icgn")
    path.plot(time_s, both["template"], ".", color=colour, markersize=4, label=f"{direction}: template")
    apart = both["template"] - both["icgn"]
    std = np.sqrt(tracks["icgn"]["position_covariance"].values[:, 0, column, column])
    difference.fill_between(time_s, -2 * std, 2 * std, color=colour, alpha=0.2, linewidth=0)
    difference.plot(time_s, apart, color=colour, linewidth=1.0, label=f"{rms(apart):.4f} px RMS")
finish(path, "movement in the picture")
path.legend(fontsize=8, frameon=False, ncols=2, loc="upper left")
path.tick_params(labelbottom=False)
low, high = path.get_ylim()
path.set_ylim(low, high + 0.3 * (high - low))
path.set_xlim(time_s[0], time_s[-1])
finish(difference, "template less icgn: steps of 1/16 px; shaded, two standard deviations of icgn")
difference.legend(fontsize=8, frameon=False, ncols=2, loc="lower left")
low, high = difference.get_ylim()
difference.set_ylim(low - 0.35 * (high - low), high)
figure.align_ylabels([path, difference])

headline(figure, f"{POINT} in the left view, followed by two trackers: one path, and what tells them apart")
save(figure, __file__)
