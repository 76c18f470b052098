"""What is stated of the cameras themselves: beside the adjusted values, and as claims that may be wrong."""

from collections.abc import Iterator

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Rig
from vfm_sdm.stages.cameras.culprits import Claim
from vfm_sdm.stages.cameras.site_values import AdjustedValue

__all__ = ["ALL_FOCALS", "DISTANCE", "list_distances", "list_focal_claims", "list_intrinsics"]

ALL_FOCALS = "focal lengths of all views"
DISTANCE = "distance"
"""First word of the names of the distances from the reference camera to the third and further cameras."""


def list_intrinsics(start: Rig, rig: Rig) -> Iterator[AdjustedValue]:
    """Focal lengths, principal points and distortion that were free to change.

    Parameters
    ----------
    start
        Cameras with the covariance of their prior.
    rig
        Adjusted cameras.
    """
    covariance = np.asarray(start.covariance)
    for index, (name, camera) in enumerate(zip(rig.names, rig.cameras, strict=True)):
        prior = start.cameras[index]
        std = np.sqrt(np.diag(covariance))[len(CAMERA_PARAMETERS) * index :][:4]
        stretch = camera.focal_px / prior.focal_px
        rows = (
            ("focal", "px", prior.focal_px, std[0] * prior.focal_px, camera.focal_px),
            ("principal point u", "px", prior.K[0, 2], std[1], camera.K[0, 2]),
            ("principal point v", "px", prior.K[1, 2], std[2], camera.K[1, 2]),
            ("distortion k1", "1", prior.distortion[0], std[3] * stretch**2, camera.distortion[0]),
        )
        yield from (AdjustedValue(f"{what} {name}", unit, p, s, v) for what, unit, p, s, v in rows if s > 0)


def list_distances(start: Rig, rig: Rig) -> Iterator[AdjustedValue]:
    """Distances of the third and further cameras from the reference camera; that of the second is the baseline.

    Parameters
    ----------
    start
        Cameras with the covariance of their prior [m].
    rig
        Adjusted cameras [m].
    """
    size = len(CAMERA_PARAMETERS)
    for index in range(2, len(rig)):
        distance = start.baseline(0, index)
        along = start.cameras[index].translation / distance
        last = slice(size * index + 7, size * (index + 1))
        std = float(np.sqrt(along @ np.asarray(start.covariance)[last, last] @ along))
        if std > 0:
            name = f"{DISTANCE} {rig.names[0]} to {rig.names[index]}"
            yield AdjustedValue(name, "m", distance, std, rig.baseline(0, index))


def list_focal_claims(start: Rig, factor: FloatArray, count: int) -> list[Claim]:
    """The focal length of every view that is not held fixed, and all of them together.

    Parameters
    ----------
    start
        Cameras with the covariance of their prior.
    factor
        Factor of that covariance, from whitened parameters to those of the rig, shape (10 V, size).
    count
        Number of all residuals, of which the first are the whitened parameters.
    """
    inner = np.linalg.pinv(factor)
    size, focal = len(CAMERA_PARAMETERS), []
    for index, (name, camera) in enumerate(zip(start.names, start.cameras, strict=True)):
        row = np.zeros(len(factor))
        row[size * index] = std = float(np.linalg.norm(factor[size * index]))
        if std > 0:
            rows = np.pad(inner @ row, (0, count - factor.shape[1]))[:, None]
            focal.append(Claim(f"focal {name}", "px", camera.focal_px, std, rows, logarithmic=True))
    if len(focal) < 2:
        return focal
    std = float(np.mean([one.std for one in focal]))
    together = np.sum([std / one.std * one.rows for one in focal], axis=0)
    mean = float(np.exp(np.mean([np.log(one.stated) for one in focal])))
    return [*focal, Claim(ALL_FOCALS, "px", mean, std, together, logarithmic=True)]
