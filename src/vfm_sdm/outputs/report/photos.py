"""Frames in which points are named, with subsets and axes drawn in; without recordings, the figures of the run."""

from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO

import numpy as np
import numpy.typing as npt
from PIL import Image

from vfm_sdm.core.arrays import FloatArray, LumaArray, mean_of_known
from vfm_sdm.core.datasets import frames_of_points
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.geometry.camera import Camera
from vfm_sdm.inputs.session import Session, View, open_views
from vfm_sdm.inputs.session.hashes import InputHashes
from vfm_sdm.outputs.plots import file_stem
from vfm_sdm.outputs.plots.drawing import AXIS_COLOURS, GREY, ORANGE
from vfm_sdm.outputs.report.drawing import WIDTH, Drawing, shorten
from vfm_sdm.outputs.report.inputs import MANY_POINTS, ReportInputs
from vfm_sdm.outputs.report.language import Language
from vfm_sdm.outputs.report.site_plan import point_positions

__all__ = ["Photo", "draw_photo", "find_photos"]

_ALL_BYTES = 1_100_000
"""Bytes of all pictures together before they are written as text; a report has to stay below 5 MB."""
_WIDEST_PX = 1600
_QUALITIES = (85, 75, 60, 45, 30)
_ROSETTE = 50.0
"""Length of the longest axis that is drawn."""
_ROSETTE_ROOM = (142.0, 76.0)
"""How far its middle lies from the edges, so that the axes' names fit."""
_SHORTEST = 6.0
"""Length up to which an axis is drawn as seen from its end."""


@dataclass(frozen=True, eq=False)
class Photo:
    """A frame of a view in which points are named.

    Parameters
    ----------
    view
        Name of the view.
    frame
        The frame, shape (H, W) or (H, W, 3); ``None`` where it cannot be had.
    reason
        Why not; empty where it is there. Key of a text.
    figure
        JPEG of the figure that the run drew in its place; empty where there is none.
    number
        Number of the frame.
    """

    view: str
    frame: LumaArray | None
    reason: str = ""
    figure: bytes = b""
    number: int = 0


def find_photos(inputs: ReportInputs) -> list[Photo]:
    """First frames of all views and later ones in which points are named, of recordings as they were measured.

    Parameters
    ----------
    inputs
        Files of the run.
    """
    return [photo for view in inputs.session.view for photo in _find_photos(inputs, view)]


def _find_photos(inputs: ReportInputs, view: View) -> list[Photo]:
    alone = inputs.session.model_copy(update={"view": (view,)})
    later = sorted({number for _, _, number in _find_places(inputs, view.name)} - {0})
    try:
        if _is_measured(inputs, alone):
            video = open_views(alone)[view.name]
            return [Photo(view.name, video.single(one).frame(one).luma, number=one) for one in (0, *later)]
        reason = "recording changed"
    except (VfmSdmError, OSError):
        reason = "recording gone"
    file = inputs.folder / "figures" / f"points_{file_stem(view.name)}.png"
    try:
        with Image.open(file) as drawn:
            figure = _compress(np.asarray(drawn.convert("RGB")), _room(inputs))
    except (OSError, ValueError, SyntaxError):  # absent, or damaged
        figure = b""
    return [Photo(view.name, None, reason, figure)]


def _room(inputs: ReportInputs) -> int:
    """Bytes that one picture may take."""
    frames = {(view.name, number) for view in inputs.session.view for _, _, number in _find_places(inputs, view.name)}
    return _ALL_BYTES // max(len(frames | {(view.name, 0) for view in inputs.session.view}), 1)


def _is_measured(inputs: ReportInputs, session: Session) -> bool:
    """Whether the recordings of a session of one view are those that were measured."""
    measured = {str(value) for value in inputs.summary["input_hashes"].values()}
    whole = not any(one.startswith("sampled-") for one in measured)
    narrowed = session.narrowed(("view.name", "view.video", "view.images"))
    return set(InputHashes(whole_files=whole).of(narrowed).values()) <= measured


def draw_photo(inputs: ReportInputs, photo: Photo, language: Language) -> str:
    """A frame with points, subsets and axes, or the figure that stands for it, as SVG; empty without either.

    Parameters
    ----------
    inputs
        Files of the run.
    photo
        The frame.
    language
        Language of the texts.
    """
    key = "figure photo later label" if photo.number else "figure photo label"
    label = language.say(key, view=photo.view, frame=photo.number)
    if photo.frame is None:
        if not photo.figure:
            return ""
        with Image.open(BytesIO(photo.figure)) as drawn:
            height = WIDTH * drawn.height / drawn.width
        drawing = Drawing(height, label)
        drawing.picture(_address(photo.figure), 0, 0, WIDTH, height)
        return drawing.svg()
    tall, wide = photo.frame.shape[:2]
    scale = WIDTH / wide
    drawing = Drawing(tall * scale, label)
    drawing.picture(_address(_compress(_to_eight_bit(photo.frame), _room(inputs))), 0, 0, WIDTH, tall * scale)
    _draw_points(drawing, inputs, photo, scale)
    taken = [position for _, position, number in _find_places(inputs, photo.view) if number == photo.number]
    rig = inputs.cameras.rig
    if rig is not None and photo.view in rig.names:
        _draw_rosette(drawing, inputs, (rig.camera(photo.view), taken), language)
    return drawing.svg()


def _draw_points(drawing: Drawing, inputs: ReportInputs, photo: Photo, scale: float) -> None:
    """Points of a view's frame, each with the square that is compared."""
    subsets = inputs.summary.get("subsets", {}).get(photo.view, {})
    many = len(inputs.point_names) > MANY_POINTS
    for name, position, number in _find_places(inputs, photo.view):
        if number != photo.number:
            continue
        x, y = (position + 0.5) * scale
        colour = GREY if name in inputs.static else ORANGE
        side = subsets.get(name, {}).get("subset_px") or inputs.session.method.subset_px or 0
        half = side / 2 * scale
        for edge, width in (("#000000", 2.6), (colour if name not in inputs.static else "#ffffff", 1.2)):
            square = [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]
            drawing.line([*square, square[0]], edge, width=width)
        drawing.dot((x, y), 1.6, ORANGE)
        late = x > 0.8 * drawing.width
        size = 9.0 if many else 11.5
        shown = shorten(name, 90 if many else 180, size)
        # Above the square, or below it at the upper edge.
        above = y - half - 4 > size
        drawing.text(
            float(x + (half if late else -half)),
            float(y - half - 4 if above else y + half + size + 1),
            shown,
            anchor="end" if late else "start",
            size=size,
            colour="white",
            halo="black",
        )


def _find_places(inputs: ReportInputs, view: str) -> Iterator[tuple[str, FloatArray, int]]:
    """Points that were found in a view, their places (2,) [px], and the numbers of their frames."""
    if view not in inputs.points["view"].values:
        return
    of_view = inputs.points.sel(view=view)
    for name, number in zip(of_view["point"].values, frames_of_points(of_view).tolist(), strict=True):
        position = of_view["position"].sel(point=name).values
        if np.isfinite(position).all():
            yield str(name), position, number


def _draw_rosette(
    drawing: Drawing, inputs: ReportInputs, seen: tuple[Camera, list[FloatArray]], language: Language
) -> None:
    """The axes' positive directions as a camera shows them amid the points, in a corner that these leave free."""
    camera, taken = seen
    middle = mean_of_known(point_positions(inputs))
    if not np.isfinite(middle).all():
        return
    frame = inputs.cameras.frame
    rotation = np.eye(3) if frame is None else frame.rotation
    step_m = 0.02 * float(np.linalg.norm(middle))
    ends = np.array([middle, *(middle + step_m * np.eye(3))]) @ rotation
    pixels = camera.project(ends)
    arrows = pixels[1:] - pixels[0]
    lengths = np.linalg.norm(arrows, axis=1)
    if not np.isfinite(lengths).all() or lengths.max() == 0:
        return
    arrows *= _ROSETTE / lengths.max()
    corner = _find_free_corner(drawing, [(place + 0.5) * drawing.width / camera.image_size[0] for place in taken])
    for number, (axis, arrow) in enumerate(zip(inputs.axis_names, arrows, strict=True)):
        colour = AXIS_COLOURS[number % len(AXIS_COLOURS)]
        end = corner + arrow
        if np.linalg.norm(arrow) < _SHORTEST:
            end = corner + np.array([0.0, -12.0])
            _draw_end_on(drawing, corner, colour, away=float((ends[number + 1] - ends[0]) @ camera.rotation[2]) > 0)
        else:
            drawing.arrow(corner, end, "#ffffff", width=5.5)
            drawing.arrow(corner, end, colour, width=2.2)
        flat = abs(arrow[0]) > abs(arrow[1])
        drawing.text(
            float(end[0] + (np.sign(arrow[0]) * 5 if flat else 0)),
            float(end[1] + (4 if flat else 14 if arrow[1] > 0 else -5)),
            f"+ {language.word('axis', axis)}",
            anchor=("start" if arrow[0] > 0 else "end") if flat else "middle",
            size=11,
            colour=colour,
            bold=True,
            halo="white",
        )


def _find_free_corner(drawing: Drawing, taken: list[FloatArray]) -> FloatArray:
    """The place near a corner of a drawing that lies farthest from places (2,) that are taken."""
    across, down = _ROSETTE_ROOM
    corners = [np.array([x, y]) for x in (across, drawing.width - across) for y in (drawing.height - down, down)]
    if not taken:
        return corners[0]
    return max(corners, key=lambda corner: min(float(np.linalg.norm(corner - place)) for place in taken))


def _draw_end_on(drawing: Drawing, at: FloatArray, colour: str, *, away: bool) -> None:
    """An arrow along the line of sight: its feathers where it points away, its tip where it points here."""
    drawing.dot(at, 7, colour, filled=False)
    if away:
        for side in (-5.0, 5.0):
            stroke = np.array([5.0, side])
            drawing.line([at - stroke, at + stroke], colour)
    else:
        drawing.dot(at, 2, colour)


def _to_eight_bit(frame: npt.NDArray[np.generic]) -> npt.NDArray[np.uint8]:
    """A frame of any depth in the 256 steps of a JPEG, by its own lowest and highest value where it has more."""
    if frame.dtype == np.uint8:
        return frame.astype(np.uint8)
    values = frame.astype(np.float64)
    low, high = float(values.min()), float(values.max())
    return np.asarray(255 * (values - low) / max(high - low, 1e-12)).astype(np.uint8)


def _compress(picture: npt.NDArray[np.uint8], room: int) -> bytes:
    """JPEG of a picture that is no larger than paper shows and fits a room in bytes."""
    image = Image.fromarray(picture)
    widest = _WIDEST_PX
    while True:
        small = image
        if image.width > widest:
            small = image.resize((widest, max(round(image.height * widest / image.width), 1)), Image.Resampling.LANCZOS)
        for quality in _QUALITIES:
            stream = BytesIO()
            small.save(stream, format="JPEG", quality=quality, optimize=True)
            if stream.tell() <= room:
                return stream.getvalue()
        widest = widest * 2 // 3


def _address(jpeg: bytes) -> str:
    return f"data:image/jpeg;base64,{b64encode(jpeg).decode('ascii')}"
