"""Axes of the structure from its edges alone, where nobody measured the two distances: a place to start from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vfm_sdm.core.arrays import FloatArray
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.inputs.session import Site
from vfm_sdm.stages.cameras.edge_groups import angles_to
from vfm_sdm.stages.matching.straight_edges import StraightEdges

__all__ = ["EdgeAxes", "find_edge_axes"]

_UPRIGHT = np.radians(35.0)
"""Angle to the camera's own vertical within which the structure's is looked for: a hand-held phone is that level."""
_WIDTH = np.radians(1.0)
_STEPS = np.radians(np.arange(0.0, 180.0, 0.5))
_PAIRS = 400
_LONGEST_PX = 200.0
_LEAST_SUPPORT = 4.0
"""Lengths of 200 px that an axis is seen by at least: four cells with an edge each."""
_SEED = 0


@dataclass(frozen=True)
class EdgeAxes:
    """Axes of the structure as edges show them.

    Parameters
    ----------
    pitch_rad, roll_rad
        Inclination of the reference camera against the structure's vertical edges [rad].
    angle_rad
        Horizontal angle between optical axis and longitudinal edges [rad].
    side
        Side of the reference camera on which the face lies, for an observer who looks along the structure.
    """

    pitch_rad: float
    roll_rad: float
    angle_rad: float
    side: Literal["right", "left"]

    @property
    def rotation(self) -> FloatArray:
        """Lateral, vertical and longitudinal axis in the reference camera's frame, shape (3, 3) [1]."""
        return structure_from_cam1(self.angle_rad, pitch_rad=self.pitch_rad, roll_rad=self.roll_rad, side=self.side)


def find_edge_axes(edges: Sequence[StraightEdges], rig: Rig, site: Site) -> EdgeAxes | None:
    """Vertical, lateral and longitudinal axis in which most edges run; ``None`` where edges do not tell them.

    Parameters
    ----------
    edges
        Edges of each view.
    rig
        Cameras as they are known before.
    site
        Level of the reference camera, and the side of the structure where it was stated.

    Notes
    -----
    Two edges of one direction give it as the intersection of their planes through the optical centre; of many pairs of
    nearly upright ones the direction is taken that most edges of all views support. About it the angle is searched in
    which edges support two horizontal directions at a right angle [1]_. The longitudinal one of these is that on the
    stated side; where none was stated, the one with more support.

    References
    ----------
    .. [1] Coughlan, J. M., Yuille, A. L. (1999). Manhattan world: compass direction from a single image by Bayesian
       inference. Proc. ICCV, 941-947.
    """
    level = site.reference_camera_level
    if level is not None:
        pitch, roll = np.radians([level.pitch, level.roll])
    else:
        down = _find_vertical(edges, rig)
        if down is None:
            return None
        pitch, roll = -np.arcsin(np.clip(down[2], -1, 1)), np.arctan2(down[0], down[1])
    # Rows of the frame at an angle of 90 degrees: forward, down, leftward.
    forward, down, leftward = structure_from_cam1(np.pi / 2, pitch_rad=float(pitch), roll_rad=float(roll))
    across = [one.chosen(np.abs(angles_to(one, rig, down)) > 2 * _WIDTH) for one in edges]
    support = np.array([_support(across, rig, np.sin(a) * leftward + np.cos(a) * forward) for a in _STEPS])
    quarter = len(_STEPS) // 2
    together = support[:quarter] + support[quarter:]
    best = int(together.argmax())
    if "structure_side" in site.model_fields_set:
        on_right = site.structure_side == "right"
    else:
        on_right = bool(support[best] >= support[best + quarter])
    chosen = support[best] if on_right else support[best + quarter]
    if chosen < _LEAST_SUPPORT:
        return None
    # On the left it runs forward to the right, at 90 degrees less the angle from what is seen on the right.
    angle = _STEPS[best] if on_right else np.pi / 2 - _STEPS[best]
    return EdgeAxes(float(pitch), float(roll), float(angle), "right" if on_right else "left")


def _find_vertical(edges: Sequence[StraightEdges], rig: Rig) -> FloatArray | None:
    """Direction of most nearly upright edges, down, shape (3,) [1]."""
    upright, normals, lengths = [], [np.empty((0, 3))], [np.empty(0)]
    for one in edges:
        camera = rig.cameras[one.view]
        along = one.places[:, 2] - one.places[:, 0]
        near = one.chosen(np.abs(np.arctan2(along[:, 0], np.abs(along[:, 1]))) < _UPRIGHT)
        upright.append(near)
        ends = np.dstack([camera.normalize(near.places[:, ::2]), np.ones((len(near), 2))])
        normal = np.cross(ends[:, 0], ends[:, 1]) @ camera.rotation
        normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True))
        lengths.append(np.minimum(near.length_px, _LONGEST_PX))
    normal, length = np.concatenate(normals), np.concatenate(lengths)
    if len(normal) < 2:
        return None
    rng = np.random.default_rng(_SEED)
    pairs = rng.choice(len(normal), (_PAIRS, 2), p=length / length.sum())
    candidates = np.cross(normal[pairs[:, 0]], normal[pairs[:, 1]])
    size = np.linalg.norm(candidates, axis=1)
    candidates = candidates[size > np.sin(_WIDTH)] / size[size > np.sin(_WIDTH), None]
    # Edges that are parallel in the picture tell their common direction by it alone.
    candidates = np.concatenate([candidates, [[0.0, 1.0, 0.0]]])
    candidates = candidates * np.sign(candidates[:, 1:2])
    candidates = candidates[candidates[:, 1] > np.cos(_UPRIGHT)]
    found = [_support(upright, rig, one) for one in candidates]
    best = int(np.argmax(found))
    return np.asarray(candidates[best]) if found[best] >= _LEAST_SUPPORT else None


def _support(edges: Sequence[StraightEdges], rig: Rig, direction: FloatArray) -> float:
    """Lengths of the edges that run in a direction, each up to 200 px, less the more they differ from it [200 px]."""
    total = 0.0
    for one in edges:
        angle = angles_to(one, rig, direction)
        weight = np.maximum(1 - (angle / _WIDTH) ** 2, 0.0)
        total += float(np.minimum(one.length_px, _LONGEST_PX) @ weight) / _LONGEST_PX
    return total
