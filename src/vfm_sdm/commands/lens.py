"""The command ``lens``: the lens of a camera from a pan clip."""

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from rich.table import Table

from vfm_sdm.commands.terminal import ERR, OUT, fail, note, plain_table, say
from vfm_sdm.core.files import write_file
from vfm_sdm.core.threads import small_algebra
from vfm_sdm.inputs.video import Video, open_video
from vfm_sdm.outputs.plots.pan_clip import draw_lens
from vfm_sdm.stages.lens.adjustment import AdjustedClip
from vfm_sdm.stages.lens.clip import LensEstimate, estimate_lens
from vfm_sdm.stages.lens.file import KnownLens, write_lens
from vfm_sdm.stages.lens.scene import PanScene

__all__ = ["lens"]

_SCENE = PanScene()


def lens(
    clip: Annotated[Path, Parameter(help="Video in which the camera pans, tilts and rolls; docs/lens.md says how.")],
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="File to write, such as lens.toml.")],
    nearest: Annotated[float, Parameter(help="Distance of the nearest part of the scene in m.")] = _SCENE.nearest_m,
    farthest: Annotated[float, Parameter(help="Distance of the farthest part in m.")] = _SCENE.farthest_m,
    lever: Annotated[
        float, Parameter(help="How far the lens may lie beside the axes of the tripod's head in m, along each axis.")
    ] = _SCENE.lever_std_m,
    figure: Annotated[bool, Parameter(help="Draw tracks, coverage and residuals beside the file.")] = True,
) -> None:
    """Focal length, principal point and distortion from a pan clip: writes a file for a session's `lens`."""
    scene = PanScene(nearest, farthest, lever)
    video = open_video(clip)
    with small_algebra():
        estimate = estimate_lens(video, scene)
    if not estimate.usable or estimate.camera is None:
        note(estimate.notes, ERR)
        fail(f"no lens: {estimate.status}")
    known = KnownLens(estimate.camera, estimate.covariance)
    settings = {"nearest_m": nearest, "farthest_m": farthest, "lever_std_m": lever}
    notes = [*estimate.notes, *estimate.advice]
    path = write_lens(output, known, clip=clip, settings=settings, found={"notes": notes})
    OUT.print(_tabulate(known, estimate))
    note(notes)
    written = [path]
    if figure and estimate.adjusted is not None:
        written.append(_draw(video, estimate.adjusted, path.with_suffix(".png")))
    for one in written:
        say(f"written: {one}")


def _draw(video: Video, adjusted: AdjustedClip, path: Path) -> Path:
    first = next(iter(video.frames()))
    return write_file(path, draw_lens(adjusted, first.luma))


def _tabulate(known: KnownLens, estimate: LensEstimate) -> Table:
    """What was found of a lens, each with its standard deviation."""
    camera, std = known.camera, np.sqrt(np.diag(known.covariance))
    (width, height), K = camera.image_size, camera.K
    corner = camera.normalize([[0.0, 0.0]])[0]
    straight = K[:2, :2] @ corner + K[:2, 2]
    table = plain_table(f"Lens of {width} x {height} px")
    for name in ("", "value", "std"):
        table.add_column(name, justify="left" if not name else "right")
    table.add_row("focal length", f"{camera.focal_px:.1f} px", f"{std[0] * camera.focal_px:.1f} px = {std[0]:.2%}")
    table.add_row("principal point u", f"{K[0, 2]:.1f} px", f"{std[1]:.1f} px")
    table.add_row("principal point v", f"{K[1, 2]:.1f} px", f"{std[2]:.1f} px")
    table.add_row("distortion k1", f"{camera.distortion[0]:.5f}", f"{std[3]:.5f}")
    table.add_row("distortion k2", f"{camera.distortion[1]:.5f}", "in k1")
    table.add_row("distortion of a corner", f"{np.linalg.norm(straight):.1f} px", "")
    fields = [np.degrees(np.arctan(extent / 2 / focal) * 2) for extent, focal in ((width, K[0, 0]), (height, K[1, 1]))]
    table.add_row("field of view", f"{fields[0]:.1f} x {fields[1]:.1f} deg", "")
    if estimate.course is not None:
        course = estimate.course
        table.add_row("change of focal length", f"{course.drift:+.3%}", f"{course.drift_std:.3%}")
    # Two cameras that look at one spot pay a focal length twice: by the rays, and by the distance that they give.
    table.add_row("displacement's scale, no length known", "", f"about {2 * std[0]:.2%}")
    return table
