"""Where points are for a camera that moves far, how well that is known, and what its own motion adds to it."""

from dataclasses import dataclass

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS, Camera, Rig
from vfm_sdm.geometry.propagation import step_parameters, triangulation_jacobian
from vfm_sdm.geometry.triangulation import triangulate
from vfm_sdm.stages.camera_motion.estimation import jacobian_in_camera
from vfm_sdm.stages.camera_motion.poses import Poses, StaticView, look_from

__all__ = ["LENS", "Places", "compute_place_slopes", "locate", "refine_places"]

LENS = CAMERA_PARAMETERS.index("rx")
"""Parameters of the lens that carry uncertainty: the first of a camera's."""
_LENS_STEP = np.array([1e-5, 0.01, 0.01, 1e-4])
_LEAST_PLACE_PX = 0.05
"""Standard deviation of a place at least: registrations of every frame share the error of the reference frame [px]."""


@dataclass(frozen=True, eq=False)
class Places:
    """A camera's lens and the P points in its axes at rest, with what is known of both.

    Parameters
    ----------
    camera
        The lens.
    X
        Shape (P, 3) [m]; NaN where unknown.
    covariance
        Of the four parameters of the lens that carry uncertainty (`vfm_sdm.geometry.camera.CAMERA_PARAMETERS`), then of
        all points' coordinates, shape (4 + 3 P, 4 + 3 P); zero for points that are not known.
    """

    camera: Camera
    X: FloatArray
    covariance: FloatArray

    def chosen(self, points: list[int]) -> FloatArray:
        """Numbers of the parameters of the lens and of some points, shape (4 + 3 S,)."""
        return np.concatenate([np.arange(LENS), *(LENS + 3 * p + np.arange(3) for p in points)]).astype(np.int64)


def locate(rest: FloatArray, rig: Rig, place_std: FloatArray | None = None) -> list[Places]:
    """Lens and points for each camera of a rig, as the rig knows them.

    Parameters
    ----------
    rest
        Pixels with all cameras at rest, shape (V, P, 2) [px]; NaN where unknown.
    rig
        Metric cameras at rest, with their covariance where it is known.
    place_std
        How well the same place was found in every view, shape (V, P, 2) [px]; taken as 0.05 px where it is less or not
        known.

    Returns
    -------
    places
        One for each view. Their covariance is that of the rig and of the places, through the triangulation: errors that
        all points share, as of the baseline, are seen as such.
    """
    world = triangulate(rest, rig)
    known, count = np.asarray(np.isfinite(world).all(axis=-1)), rest.shape[1]
    by_rig = np.zeros((0, len(rig), count, 3))
    if rig.covariance is not None:
        steps = step_parameters(rig)
        by_rig = np.stack([_change(rest, ahead, back) / (2 * step) for step, ahead, back in steps])
    std = np.fmax(np.full(rest.shape, _LEAST_PLACE_PX) if place_std is None else place_std, _LEAST_PLACE_PX)
    variance = np.where(np.isfinite(rest), std, 0.0) ** 2
    slope = np.nan_to_num(triangulation_jacobian(rest, rig))
    own = np.einsum("pivk,vpk,pjvk->pij", slope, variance, slope)
    found = []
    for view, camera in enumerate(rig.cameras):
        size = LENS + 3 * count
        covariance = np.zeros((size, size))
        if rig.covariance is not None:
            D = np.zeros((len(by_rig), size))
            first = view * len(CAMERA_PARAMETERS)
            D[first : first + LENS, :LENS] = np.eye(LENS)
            D[:, LENS:] = np.where(known[:, None], by_rig[:, view], 0.0).reshape(len(by_rig), -1)
            covariance = D.T @ rig.covariance @ D
        for point in np.flatnonzero(known).tolist():
            block = slice(LENS + 3 * point, LENS + 3 * point + 3)
            covariance[block, block] += camera.rotation @ own[point] @ camera.rotation.T
        found.append(Places(camera, world @ camera.rotation.T + camera.translation, covariance))
    return found


def _change(rest: FloatArray, ahead: Rig, back: Rig) -> FloatArray:
    """How points at pixels (V, P, 2) [px] differ between two rigs in the axes of every camera, (V, P, 3) [m]."""
    of_each = []
    for rig in (ahead, back):
        world = triangulate(rest, rig)
        of_each.append(np.stack([world @ one.rotation.T + one.translation for one in rig.cameras]))
    return np.asarray(of_each[0] - of_each[1])


def compute_place_slopes(places: Places, poses: Poses, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Change of the pixels of points with the lens and with their own place, as the moved camera sees them.

    Parameters
    ----------
    places
        The lens.
    poses
        Of the camera in T frames.
    points
        In the axes of the camera at rest, shape (P, 3) [m].

    Returns
    -------
    by_lens, by_place
        Shapes (T, P, 2, 4) [px per unit of the parameter] and (T, P, 2, 3) [px/m].
    """
    X = poses.moved(points)
    by_lens = np.empty((*X.shape[:2], 2, LENS))
    for index, step in enumerate(_LENS_STEP):
        delta = np.zeros(len(CAMERA_PARAMETERS))
        delta[index] = step
        ahead, back = (look_from(places.camera.perturbed(sign * delta), X) for sign in (1, -1))
        by_lens[..., index] = (ahead - back) / (2 * step)
    by_place = np.einsum("tpia,tab->tpib", jacobian_in_camera(places.camera, X)[..., 3:], poses.rotation)
    return by_lens, by_place


def refine_places(places: Places, static: list[int], view: StaticView, poses: Poses, prior: Places) -> Places:
    """Lens and points as the camera's own motion shows them: the parallax of its static points, over all frames.

    Parameters
    ----------
    places
        Lens and points so far, about which pixels are linear.
    static
        Numbers of the S static points.
    view
        Their pixels and weights; the lens and the points are those of ``places``.
    poses
        Of the camera with them.
    prior
        Lens and points as the rig knows them.

    Returns
    -------
    places
        One Gauss-Newton step, in which the poses of all frames are free as well. What static points tell of the lens
        and of errors that all points share helps the other points, too, by their common covariance.
    """
    size = LENS + 3 * len(static)
    by_lens, by_place = compute_place_slopes(places, poses, view.X)
    H = np.zeros((*by_lens.shape[:2], 2, size))
    H[..., :LENS] = by_lens
    for number in range(len(static)):
        H[:, number, :, LENS + 3 * number : LENS + 3 * number + 3] = by_place[:, number]
    X = poses.moved(view.X)
    residual = view.position - look_from(places.camera, X)
    used = np.asarray(np.isfinite(residual).all(axis=-1)) & poses.found[:, None]
    weight = np.where(used[..., None, None], view.weight, 0.0)
    residual = np.where(used[..., None], residual, 0.0)
    J = np.where(used[..., None, None], jacobian_in_camera(places.camera, X), 0.0)
    H = np.where(used[..., None, None], H, 0.0)
    HW = np.einsum("tpig,tpij->tpgj", H, weight)
    cross = np.einsum("tpgj,tpja->tga", HW, J)
    JW = np.einsum("tpia,tpij,tpj->ta", J, weight, residual, optimize=True)
    gain = cross @ poses.covariance
    normal = np.einsum("tpgj,tpjh->gh", HW, H) - np.einsum("tga,tha->gh", gain, cross)
    right = np.einsum("tpgj,tpj->g", HW, residual) - np.einsum("tga,ta->g", gain, JW)
    return _update(places, static, prior, normal, right)


def _update(places: Places, static: list[int], prior: Places, normal: FloatArray, right: FloatArray) -> Places:
    """The prior with what pixels say of lens and static points: normal matrix and right side about ``places``."""
    rows = prior.chosen(static)
    told = right + normal @ _parameters(places, prior)[rows]
    # (C^-1 + N)^-1 = C (1 + N C)^-1, which needs no inverse of what is exact.
    pull = prior.covariance[:, rows] @ np.linalg.inv(np.eye(len(rows)) + normal @ prior.covariance[np.ix_(rows, rows)])
    whole = pull @ told
    # In the form of Joseph, whose rounding leaves no negative variance.
    kept = np.eye(len(prior.covariance))
    kept[:, rows] -= pull @ normal
    covariance = kept @ prior.covariance @ kept.T + pull @ normal @ pull.T
    camera = prior.camera.perturbed(np.append(whole[:LENS], np.zeros(len(CAMERA_PARAMETERS) - LENS)))
    return Places(camera, prior.X + whole[LENS:].reshape(-1, 3), (covariance + covariance.T) / 2)


def _parameters(places: Places, prior: Places) -> FloatArray:
    """How far lens and points are from the prior, shape (4 + 3 P,); zero for points that are not known."""
    lens = np.concatenate(
        [
            [np.log(places.camera.K[0, 0] / prior.camera.K[0, 0])],
            places.camera.K[:2, 2] - prior.camera.K[:2, 2],
            places.camera.distortion[:1] - prior.camera.distortion[:1],
        ]
    )
    return np.concatenate([lens, np.nan_to_num(places.X - prior.X).ravel()])
