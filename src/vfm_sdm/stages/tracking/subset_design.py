"""What each point's subset compares, chosen before the run, and how well it should then measure."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vfm_sdm.core.arrays import FloatArray, LumaArray
from vfm_sdm.core.datasets import frames_of_points
from vfm_sdm.core.grids import grid_points
from vfm_sdm.core.statuses import PointStatus
from vfm_sdm.inputs.video import Video
from vfm_sdm.stages.registration.designs import USUAL_SUBSET_PX, SubsetDesign, check_subset_px
from vfm_sdm.stages.tracking.design.choice import MARGIN_PX, SIZES_PX, SubsetChoice, choose_subset
from vfm_sdm.stages.tracking.design.samples import find_covered, find_hidden, sample_windows
from vfm_sdm.stages.tracking.inputs import check_points

__all__ = ["SubsetChoice", "SubsetDesigns", "describe_subsets", "design_subsets"]

_REACH_PX = 100
"""How far around a refused point a place that would do is looked for [px]."""
_FEWEST_FRAMES = 2


def design_subsets(
    video: Video,
    points2d: FloatArray,
    names: Sequence[str],
    *,
    subset_px: int | None = None,
    reference_frame: int = 0,
) -> list[SubsetChoice]:
    """The subset of every point, with what it should measure, from a few frames spread over the recording.

    Parameters
    ----------
    video
        The view.
    points2d
        Positions in the reference frame, shape (P, 2) [px], full-image pixels.
    names
        Point names, length P.
    subset_px
        Side of the squares, odd [px]; chosen for each point when ``None``.
    reference_frame
        Index of the frame in which ``points2d`` are given.

    Raises
    ------
    DatasetError
        Points lie outside the image, names are not distinct, or there is no such reference frame.
    SessionError
        The size is even or too small.

    Notes
    -----
    **What is believed.** Pixels around the point vote whether they move with it; see
    `vfm_sdm.stages.tracking.design.belief.find_belief`. The rest is masked: background through a railing, a wall beside
    a deck, leaves, moving shadows.

    **Warp.** Translation, similarity and affine warp are registered to the sample frames; the covariance of each holds
    the noise and, as a bias, rotation and strain that the warp leaves out (`omitted_std` of the design). The least mean
    square error is chosen. Where the texture shows one direction only, it is an edge, tracked across.

    **Light.** Shadows that move over the point change its brightness by a smooth surface, which is taken out where it
    leaves half the variance at most (`shading` of the design). Of an edge only what lies near it is compared
    where the rest disturbs.

    **Refused** are points that no direction of which would be measured to 0.1 px in a frame.

    Frames in which something passes before a point are left out, see
    `vfm_sdm.stages.tracking.design.samples.find_covered`; of a point that is named in another frame than the first, all
    that do not resemble that frame (`vfm_sdm.stages.tracking.design.samples.find_hidden`): it may be hidden in most.

    Of a camera that moves far, such as a drone, the sample frames are turned back to where the picture on the whole was
    (`vfm_sdm.stages.tracking.design.whole_picture.PictureMotion`), and warps are affine.

    Where less than two other frames can be read, or the square leaves the picture, nothing is known of a point: it gets
    a whole square and an affine warp.

    Examples
    --------
    >>> import cv2
    >>> from tempfile import TemporaryDirectory
    >>> from scipy.ndimage import gaussian_filter, shift
    >>> from vfm_sdm.inputs.video import open_images
    >>> rng = np.random.default_rng(0)
    >>> texture = 128 + 200 * gaussian_filter(rng.normal(0, 1, (140, 140)), 1.5)
    >>> with TemporaryDirectory() as folder:
    ...     for number in range(6):
    ...         moved = shift(texture, (0, 0.2 * number), mode="reflect") + rng.normal(0, 1, texture.shape)
    ...         _ = cv2.imwrite(f"{folder}/{number}.png", np.clip(moved, 0, 255).round().astype(np.uint8))
    ...     video = open_images(f"{folder}/*.png", fps=10)
    ...     choice = design_subsets(video, np.array([[70.0, 70.0]]), ["mid"], subset_px=41)[0]
    >>> str(choice.status), choice.believed, bool(choice.std_px.max() < 0.01)
    ('ok', 1.0, True)
    """
    points = check_points(points2d, names, video)
    if subset_px is not None:
        check_subset_px(subset_px, "subset_px")
    sizes = SIZES_PX if subset_px is None else (subset_px,)
    half = max(sizes) // 2 + _REACH_PX
    sampled = sample_windows(video, points, half_px=half, reference_frame=reference_frame)
    limit = np.array([video.info.width - 1, video.info.height - 1])
    room = np.minimum(sampled.centers, limit - sampled.centers).min(axis=1)

    def choose(row: int) -> SubsetChoice:
        fitting = [size for size in sizes if size // 2 <= room[row]]
        if not fitting or len(sampled.windows[row]) <= _FEWEST_FRAMES:
            return _unknown(subset_px)
        offset, frames = points[row] - sampled.centers[row], sampled.windows[row]
        if reference_frame:
            frames = frames[np.append(True, ~find_hidden(frames, min(fitting)))]
            if len(frames) <= _FEWEST_FRAMES:
                return _unknown(subset_px)
        seen = np.append(True, ~find_covered(_middle(frames, max(fitting) + 2 * MARGIN_PX)))
        choice = choose_subset(frames[seen], offset, fitting, turning=sampled.turning)
        return replace(choice, nearest=_place_inside(choice.nearest + points[row], limit))

    with ThreadPoolExecutor() as executor:
        return list(executor.map(choose, range(len(points))))


class SubsetDesigns:
    """Subsets of points of recordings, each looked at once.

    Parameters
    ----------
    say
        Called with what is being done.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._known: dict[tuple[Any, ...], SubsetChoice] = {}

    def choose(
        self,
        video: Video,
        view: str,
        places: Mapping[str, FloatArray],
        numbers: Mapping[str, int],
        subset_px: int | None,
    ) -> dict[str, SubsetChoice]:
        """Subsets of points, by name, as of `design_subsets`.

        Parameters
        ----------
        video, view
            The recording, and the name of its view.
        places
            Pixels (2,) by name of the point [px].
        numbers
            Numbers of the frames in which points are there, by name; the first of those that are not named.
        subset_px
            Side of the squares [px]; chosen for each point when ``None``.
        """
        keys = {name: (view, numbers.get(name, 0), *place.tolist(), subset_px) for name, place in places.items()}
        missing = [name for name, key in keys.items() if key not in self._known]
        if missing:
            self._say(f"subsets {view}")
        for frame in sorted({numbers.get(name, 0) for name in missing}):
            together = [name for name in missing if numbers.get(name, 0) == frame]
            points2d = np.array([places[name] for name in together])
            found = design_subsets(video, points2d, together, subset_px=subset_px, reference_frame=frame)
            self._known |= {keys[name]: choice for name, choice in zip(together, found, strict=True)}
        return {name: self._known[key] for name, key in keys.items()}

    def choose_all(
        self, recordings: Mapping[str, Video], points: xr.Dataset, subset_px: int | None
    ) -> dict[str, dict[str, SubsetChoice]]:
        """Subsets of all points that have a place, by view and name.

        Parameters
        ----------
        recordings
            The recordings by view.
        points
            Points dataset, shape (V, P, 2) [px].
        subset_px
            Side of the squares [px]; chosen for each point when ``None``.

        Notes
        -----
        Points of a grid get whole squares: what looking at each would tell of hundreds, their neighbours tell together.
        """
        found: dict[str, dict[str, SubsetChoice]] = {}
        for view in points["view"].values.tolist():
            of_view = points.sel(view=view)
            place = of_view["position"].transpose("point", "pixel").values
            names, many = of_view["point"].values.tolist(), set(grid_points(points))
            known = {name: at for name, at in zip(names, place, strict=True) if np.isfinite(at).all()}
            numbers = dict(zip(names, frames_of_points(of_view).tolist(), strict=True))
            named = {name: at for name, at in known.items() if name not in many}
            found[view] = self.choose(recordings[view], view, named, numbers, subset_px)
            found[view] |= {name: _unknown(subset_px) for name in known if name in many}
        return found


def describe_subsets(names: Sequence[str], choices: Sequence[SubsetChoice]) -> xr.Dataset:
    """What is expected of the subsets of one view, as a dataset.

    Parameters
    ----------
    names
        Point names, length P.
    choices
        The subsets, length P.

    Returns
    -------
    subsets
        ``expected_std`` (point, direction: across, along) [px], ``across`` (point, pixel) [1], ``believed`` (point)
        [1], ``status`` (point), ``subset_px`` (point) [px], ``warp`` (point), ``shading`` (point): degree of the
        surfaces of brightness that are taken out, 0 for none, ``nearest`` (point, pixel) [px].

    Examples
    --------
    >>> describe_subsets([], []).sizes["point"]
    0
    """
    designs = [choice.design for choice in choices]
    return xr.Dataset(
        {
            "expected_std": (
                ("point", "direction"),
                np.array([c.std_px for c in choices]).reshape(-1, 2),
                {"units": "px"},
            ),
            "across": (("point", "pixel"), np.array([c.direction for c in choices]).reshape(-1, 2), {"units": "1"}),
            "believed": ("point", np.array([c.believed for c in choices]), {"units": "1"}),
            "status": ("point", np.array([str(c.status) for c in choices], dtype=object)),
            "subset_px": ("point", np.array([0 if d is None else d.subset_px for d in designs]), {"units": "px"}),
            "warp": ("point", np.array(["" if d is None else str(d.warp) for d in designs], dtype=object)),
            "shading": ("point", np.array([0 if d is None else d.shading for d in designs])),
            "nearest": (("point", "pixel"), np.array([c.nearest for c in choices]).reshape(-1, 2), {"units": "px"}),
        },
        coords={"point": list(names), "direction": ["across", "along"], "pixel": ["u", "v"]},
    )


def _middle(frames: LumaArray, side: int) -> LumaArray:
    """The middle of windows (K, R, R), of this side [px]."""
    cut = (frames.shape[1] - side) // 2
    inner: LumaArray = frames[:, cut : cut + side, cut : cut + side]
    return inner


def _unknown(subset_px: int | None) -> SubsetChoice:
    """The subset of a point of which the samples tell nothing."""
    nothing = np.full(2, np.nan)
    return SubsetChoice(SubsetDesign(subset_px or USUAL_SUBSET_PX), nothing, nothing, 1.0, PointStatus.OK, nothing)


def _place_inside(place: FloatArray, limit: FloatArray) -> FloatArray:
    """A place [px]; NaN where it lies outside the picture."""
    return np.where(((place >= 0) & (place <= limit)).all(), place, np.nan)
