"""Films of a relief that moves by known parts of a pixel while the light turns."""

from collections.abc import Callable

import cv2
import numpy as np

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.inputs.video import open_images
from vfm_sdm.stages.registration.designs import SubsetDesign
from vfm_sdm.stages.tracking.subset_design import SubsetChoice
from vfm_sdm.studies.synthetic.relief import Relief

SIZE = (200, 150)
FPS = 1 / 3
POINTS = np.array([[50.3, 45.2], [100.0, 75.4], [150.6, 100.7]])
NAMES = ("a", "b", "c")


class LitFilm:
    """A film whose frames show the relief in light from given sides.

    Parameters
    ----------
    folder
        Where the images are written.
    azimuth_deg
        Side of the light in each frame, shape (T,) [deg]; NaN is night.
    change
        What else happens to a frame, by its number.
    """

    def __init__(
        self,
        folder,
        azimuth_deg: FloatArray,
        *,
        seed: int = 0,
        coarsest_px: float = 20.0,
        contrast: float = 160.0,
        change: Callable[[int, LumaArray], None] | None = None,
    ) -> None:
        relief, rng = Relief(seed, SIZE, coarsest_px=coarsest_px), np.random.default_rng(seed + 100)
        frames = np.arange(len(azimuth_deg))
        moved = np.column_stack([2.3 * np.sin(0.195 * frames), 1.1 * np.sin(0.295 * frames + 1)])
        self.moved = moved - moved[0]
        folder.mkdir(exist_ok=True)
        for number, azimuth in enumerate(azimuth_deg.tolist()):
            light = relief.picture(tuple(self.moved[number]), azimuth) if np.isfinite(azimuth) else np.zeros(SIZE[::-1])
            gray = 110 + contrast * (light - light.mean()) + rng.normal(0, 1.5, light.shape)
            picture = np.clip(gray, 0, 255).round().astype(np.uint8)
            if change is not None:
                change(number, picture)
            cv2.imwrite(str(folder / f"{number:05}.png"), picture)
        self.video = open_images(folder / "*.png", fps=FPS)

    def error(self, tracks):
        """Of the positions in tracks, shape (T, P, 2) [px]."""
        return tracks["position"].values - POINTS - self.moved[:, None]


def points_of_view():
    """The points as a dataset, and the subset of each."""
    unknown = np.full(2, np.nan)
    points = make_points(["left"], NAMES, position=POINTS[None], position_std=0 * POINTS[None], status=[["ok"] * 3])
    choice = SubsetChoice(SubsetDesign(41), unknown, unknown, 1.0, PointStatus.OK, unknown)
    return points, {"left": dict.fromkeys(NAMES, choice)}
