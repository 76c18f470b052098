"""Both visits adjusted together: one world, in which static points stay and all others may have moved."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from vfm_sdm.core.arrays import BoolArray, FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.triangulation import triangulate

__all__ = ["Adjusted", "Sightings", "adjust_visits"]

_MOST_STEPS = 50
_LEAST_STD_PX = 1e-3
"""No pixel is known better."""
_RANK = 1e-10
"""Share of the largest variance below which a direction of the cameras' parameters does not vary."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """What both visits see.

    Parameters
    ----------
    rigs
        Cameras of the earlier and the later visit, V views in the same order, metric.
    pixels
        Where points rest, shape (2, V, P, 2) [px]; NaN where a view does not see one in both visits.
    covariance
        Their covariance, of which nothing is shared by the visits, shape (2, V, P, 2, 2) [px2].
    place_std
        Standard deviation of how far beside the point a view's place lies, the same at both visits, shape (V, P, 2)
        [px].
    static
        Which points stay where they are, shape (P,).
    """

    rigs: tuple[Rig, Rig]
    pixels: FloatArray
    covariance: FloatArray
    place_std: FloatArray
    static: BoolArray

    def chosen(self, keep: BoolArray) -> "Sightings":
        """The same of some of the points, by a mask of shape (P,)."""
        return Sightings(
            self.rigs,
            self.pixels[:, :, keep],
            self.covariance[:, :, keep],
            self.place_std[:, keep],
            self.static[keep],
        )


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Result of the adjustment of M moving points.

    Parameters
    ----------
    change
        Change of position from the earlier to the later visit, in the frame of the earlier reference camera, shape
        (M, 3) [m].
    covariance
        Its covariance, shape (M, 3, 3) [m2].
    log_scale, log_scale_std
        Logarithm of the later visit's scale over the earlier one's, where it was free [1]; else 0.
    chance
        Probability with which residuals are as large as these if all is as stated [1].
    converged
        Whether the solver found a minimum.
    """

    change: FloatArray
    covariance: FloatArray
    log_scale: float
    log_scale_std: float
    chance: float
    converged: bool


def adjust_visits(seen: Sightings, *, free_scale: bool = False) -> Adjusted:
    """Change of the positions of moving points, by least squares over everything that both visits saw and know.

    Parameters
    ----------
    seen
        Points that at least two views see; three of them static, or more.
    free_scale
        Whether lengths of the two visits may differ by a factor, to see whether they do.

    Notes
    -----
    Unknown are the cameras of both visits, about what each visit's own adjustment says of them and with its covariance;
    the pose of the later visit's world in the earlier one; one position of each static point and two of each other; and
    how far each view's place lies beside the point, which is the same at both visits because the earlier place is found
    again in the later picture. Errors of the cameras that both visits see alike therefore hardly count, although each
    visit knows its positions to centimetres only.
    """
    problem = _Problem(seen, free_scale)
    solved: OptimizeResult = least_squares(problem.residuals, problem.start, x_scale="jac", max_nfev=_MOST_STEPS)
    covariance = _invert(solved.jac)
    blocks = problem.unpack(np.arange(problem.size, dtype=np.float64))
    earlier, later = (blocks[name].astype(int) for name in ("moving", "moved"))
    step = np.zeros((len(earlier), 3, problem.size))
    for point, axis in np.ndindex(len(earlier), 3):
        step[point, axis, later[point, axis]], step[point, axis, earlier[point, axis]] = 1.0, -1.0
    values = problem.unpack(solved.x)
    log_scale = float(values["log_scale"].sum())
    at = blocks["log_scale"].astype(int)
    freedom = len(solved.fun) - problem.size
    return Adjusted(
        values["moved"] - values["moving"],
        np.einsum("pai,ij,pbj->pab", step, covariance, step, optimize=True),
        log_scale,
        float(np.sqrt(covariance[at, at].sum())),
        float(chi2.sf(2 * solved.cost, freedom)) if freedom > 0 else 1.0,
        bool(solved.success),
    )


class _Problem:
    """Unknowns and residuals; all priors have mean zero and variance one."""

    def __init__(self, seen: Sightings, free_scale: bool) -> None:
        self.seen = seen
        self._known: dict[int, tuple[FloatArray, Rig]] = {}
        self.roots = [_root(rig.covariance, len(rig)) for rig in seen.rigs]
        self.visible = np.isfinite(seen.pixels).all(axis=(0, 3))
        variance = seen.covariance[:, self.visible] + _LEAST_STD_PX**2 * np.eye(2)
        self.whiten = np.linalg.inv(np.linalg.cholesky(variance))
        moving = int((~seen.static).sum())
        self.shapes = {
            "earlier": (self.roots[0].shape[1],),
            "later": (self.roots[1].shape[1],),
            "beside": (int(self.visible.sum()), 2),
            "turn": (3,),
            "shift": (3,),
            "log_scale": (int(free_scale),),
            "static": (int(seen.static.sum()), 3),
            "moving": (moving, 3),
            "moved": (moving, 3),
        }
        self.size = sum(int(np.prod(shape)) for shape in self.shapes.values())

    def unpack(self, x: FloatArray) -> dict[str, FloatArray]:
        """Unknowns by name."""
        sizes = [int(np.prod(shape)) for shape in self.shapes.values()]
        parts = np.split(x, np.cumsum(sizes)[:-1])
        return {name: part.reshape(shape) for (name, shape), part in zip(self.shapes.items(), parts, strict=True)}

    @cached_property
    def start(self) -> FloatArray:
        """Unknowns to begin with: cameras as each visit has them, worlds laid over each other by the static points."""
        static = self.seen.static
        earlier, later = (
            triangulate(pixels, rig) for pixels, rig in zip(self.seen.pixels, self.seen.rigs, strict=True)
        )
        middle, middle_later = earlier[static].mean(axis=0), later[static].mean(axis=0)
        turn, _ = Rotation.align_vectors(later[static] - middle_later, earlier[static] - middle)
        shift = middle_later - turn.apply(middle)
        known = {
            "turn": turn.as_rotvec(),
            "shift": shift,
            "static": earlier[static],
            "moving": earlier[~static],
            "moved": turn.inv().apply(later[~static] - shift),
        }
        return np.concatenate([np.ravel(known.get(name, np.zeros(shape))) for name, shape in self.shapes.items()])

    def residuals(self, x: FloatArray) -> FloatArray:
        """Pixels over their standard deviations, then what priors say."""
        of = self.unpack(x)
        return np.concatenate([*self._pixel_residuals(of), *(np.ravel(of[n]) for n in ("earlier", "later", "beside"))])

    def _pixel_residuals(self, of: dict[str, FloatArray]) -> Iterator[FloatArray]:
        seen = self.seen
        points3d = np.empty((2, len(seen.static), 3))
        points3d[:, seen.static] = of["static"]
        points3d[:, ~seen.static] = of["moving"], of["moved"]
        scale = np.exp(of["log_scale"].sum())
        points3d[1] = scale * (Rotation.from_rotvec(of["turn"]).apply(points3d[1]) + of["shift"])
        beside = of["beside"] * seen.place_std[self.visible]
        for visit, name in enumerate(("earlier", "later")):
            rig = self._rig(visit, of[name])
            predicted = np.stack([camera.project(points3d[visit]) for camera in rig.cameras])[self.visible] + beside
            apart = predicted - seen.pixels[visit][self.visible]
            yield np.ravel(np.einsum("nij,nj->ni", self.whiten[visit], apart))

    def _rig(self, visit: int, of_cameras: FloatArray) -> Rig:
        """Cameras of a visit; the last ones are kept, because most derivatives leave them as they are."""
        known = self._known.get(visit)
        if known is None or not np.array_equal(known[0], of_cameras):
            known = of_cameras.copy(), self.seen.rigs[visit].perturbed(self.roots[visit] @ of_cameras)
            self._known[visit] = known
        return known[1]


def _root(covariance: FloatArray | None, cameras: int) -> FloatArray:
    """Matrix L with L L' the covariance of V cameras' parameters, without directions that do not vary; (10 V, R)."""
    if covariance is None:
        return np.zeros((10 * cameras, 0))
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > _RANK * max(float(values[-1]), _RANK)
    return np.asarray(scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def _invert(jacobian: FloatArray) -> FloatArray:
    """Covariance of the unknowns; columns are brought to one length, because their units differ."""
    length = np.linalg.norm(jacobian, axis=0)
    length = np.where(length > 0, length, 1.0)
    normal = (jacobian / length).T @ (jacobian / length)
    return np.asarray(np.linalg.pinv(normal, hermitian=True) / np.outer(length, length))
