"""Least-squares adjustment of fixed cameras to pictures of one flat board, and the covariance of the result."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vfm_sdm.core.arrays import BoolArray, FloatArray, IntArray
from vfm_sdm.errors import CameraError
from vfm_sdm.geometry.camera import CAMERA_PARAMETERS
from vfm_sdm.stages.cameras.chessboard.scene import CAMERA_SIZE, INTRINSICS, BoardScene, linearize

__all__ = ["AdjustedBoards", "adjust_boards"]

_MAX_ITERATIONS = 100
_CONVERGED = 1e-12
_MAX_DAMPING = 1e12
_SINGULAR = (
    "chessboard: expected poses that determine all cameras, got a singular adjustment; "
    "add pairs with the board tilted and in other parts of the image"
)
_SIGNIFICANT = 3.0
"""Standard deviations by which the poses must scatter more than independent errors before that is believed."""


@dataclass(frozen=True, eq=False)
class AdjustedBoards:
    """Result of `adjust_boards`.

    Parameters
    ----------
    scene
        Cameras and poses of the board at the least-squares solution.
    residuals
        Seen minus predicted pixels, shape (P, V, N, 2) [px]; NaN where a view did not see the board.
    covariance
        Covariance of the cameras' uncertain parameters, shape (10 V, 10 V), in the order and units of
        `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`.
    pose_scatter
        Ratio of the scatter of the poses' contributions to the solution over the scatter that independent corner errors
        of the size of the residuals would give [1]; used in ``covariance`` where it is significantly above 1, else 1.
    """

    scene: BoardScene
    residuals: FloatArray
    covariance: FloatArray
    pose_scatter: float


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """Sums of the linearised problem: cameras (V * 15), boards (P, 6) and their coupling."""

    cameras: FloatArray  # (P, V*15, V*15), one term a pose
    coupling: FloatArray  # (P, V*15, 6)
    boards: FloatArray  # (P, 6, 6)
    camera_gradient: FloatArray  # (P, V*15)
    board_gradient: FloatArray  # (P, 6)
    cost: float


def adjust_boards(start: BoardScene, points2d: FloatArray, *, free_intrinsics: IntArray) -> AdjustedBoards:
    """Scene that reproduces the seen corners best, with the covariance of its cameras.

    Parameters
    ----------
    start
        Approximate scene; V cameras, P poses of the board, N corners.
    points2d
        Seen corners, shape (P, V, N, 2) [px]; NaN for all corners of a view that did not see the board.
    free_intrinsics
        Indices into `INTRINSICS` of the parameters that are adjusted; the others keep their value and count as known.

    Returns
    -------
    adjusted
        Scene at the least-squares solution, its residuals [px] and the covariance of its cameras.

    Raises
    ------
    CameraError
        The adjustment does not converge, or the poses of the board do not determine the cameras.

    Notes
    -----
    The Levenberg-Marquardt method minimises the sum of the squared reprojection errors. With A and C the derivatives
    of the pixels by the cameras and by the poses of the board, the poses are eliminated by the Schur complement, so
    that the remaining normal matrix S = A'A - A'C (C'C)^-1 C'A is that of the cameras alone.

    The covariance s^2 S^-1, with s^2 the residual variance, would be right for independent corner errors. Real errors
    are alike within a picture: the board is not flat, the lens has more terms than the model, the detector has a bias.
    Between random halves of real calibrations the result differs by 2 to 6 of those standard deviations. Where the
    poses' contributions scatter significantly more than independent errors would, their scatter replaces the residual
    variance in every direction in which it is larger: a sandwich estimate [1]_ with one cluster a pose, bounded from
    below.

    References
    ----------
    .. [1] K.-Y. Liang and S. L. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73(1),
       13-22, 1986.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> tilts = Rotation.from_euler("xyz", [[25, 0, 0], [0, 30, 0], [15, -25, 40], [-25, 15, -30]], degrees=True)
    >>> poses = np.concatenate([tilts.as_matrix(), np.full((4, 3, 1), [[0.0], [0.0], [2.0]])], axis=-1)
    >>> board = np.array([[x, y, 0.0] for y in range(4) for x in range(5)]) * 0.1
    >>> true = BoardScene(np.array([[1000.0, 1000, 320, 240, 0, 0, 0, 0, 0]]), np.eye(3, 4)[None], poses, board)
    >>> start = replace(true, intrinsics=true.intrinsics * 1.02)
    >>> adjusted = adjust_boards(start, linearize(true)[0], free_intrinsics=np.arange(4))
    >>> [round(float(value), 3) for value in adjusted.scene.intrinsics[0, :4]]
    [1000.0, 1000.0, 320.0, 240.0]
    """
    free = _mark_free(len(start.intrinsics), free_intrinsics)
    try:
        scene, equations = _minimize_cost(start, points2d, free)
        covariance, scatter = _estimate_covariance(equations, int(np.isfinite(points2d).sum()))
    except np.linalg.LinAlgError as error:
        raise CameraError(_SINGULAR) from error
    expanded = np.zeros((free.size, free.size))
    expanded[np.ix_(free, free)] = covariance
    mapping = _map_to_camera_parameters(scene, points2d)
    residuals = points2d - linearize(scene)[0]
    return AdjustedBoards(scene, residuals, mapping @ expanded @ mapping.T, scatter)


def _minimize_cost(start: BoardScene, points2d: FloatArray, free: BoolArray) -> tuple[BoardScene, _NormalEquations]:
    """Scene of least cost, and the problem linearised there."""
    scene, equations = start, _build_equations(start, points2d, free)
    if not np.isfinite(equations.cost):
        raise CameraError("chessboard: expected the board in front of all cameras, got a start behind one; add pairs")
    damping = 1e-4
    for _ in range(_MAX_ITERATIONS):
        camera_step, board_steps = _solve_step(equations, damping)
        trial = _apply_steps(scene, camera_step, board_steps, free)
        trial_equations = _build_equations(trial, points2d, free)
        if trial_equations.cost <= equations.cost:
            gain = equations.cost - trial_equations.cost
            scene, equations, damping = trial, trial_equations, damping / 10
            if gain <= _CONVERGED * equations.cost + 1e-18:
                return scene, equations
        elif (damping := damping * 10) > _MAX_DAMPING:
            return scene, equations  # rounding alone keeps the cost from falling: this is the minimum
    raise CameraError(
        f"chessboard: expected convergence in {_MAX_ITERATIONS} steps, got none; "
        "add pairs with the board tilted and in other parts of the image"
    )


def _mark_free(views: int, free_intrinsics: IntArray) -> BoolArray:
    """Camera parameters that are adjusted, shape (15 V,)."""
    mask = np.zeros((views, CAMERA_SIZE), dtype=bool)
    mask[:, free_intrinsics] = True
    mask[1:, len(INTRINSICS) :] = True  # the first camera is the origin
    return mask.ravel()


def _build_equations(scene: BoardScene, points2d: FloatArray, free: BoolArray) -> _NormalEquations:
    """Normal equations of the scene for the seen corners, shape (P, V, N, 2) [px]."""
    predicted, by_camera, by_board = linearize(scene)
    seen = np.isfinite(points2d)
    residual = np.where(seen, points2d - predicted, 0.0)
    poses, views = points2d.shape[:2]
    A = np.where(seen[..., None], by_camera, 0.0).reshape(poses, views, -1, CAMERA_SIZE)
    C = np.where(seen[..., None], by_board, 0.0).reshape(poses, views, -1, 6)
    r = residual.reshape(poses, views, -1)
    At = A.swapaxes(-1, -2)
    cameras = np.zeros((poses, views, CAMERA_SIZE, views, CAMERA_SIZE))
    cameras[:, np.arange(views), :, np.arange(views)] = (At @ A).swapaxes(0, 1)
    size = views * CAMERA_SIZE
    kept = free.nonzero()[0]
    return _NormalEquations(
        cameras.reshape(poses, size, size)[:, kept[:, None], kept],
        (At @ C).reshape(poses, size, 6)[:, kept],
        (C.swapaxes(-1, -2) @ C).sum(axis=1),
        (At @ r[..., None]).reshape(poses, size)[:, kept],
        (C.swapaxes(-1, -2) @ r[..., None])[..., 0].sum(axis=1),
        float((residual**2).sum()),
    )


def _solve_step(equations: _NormalEquations, damping: float) -> tuple[FloatArray, FloatArray]:
    """Damped Gauss-Newton step of the cameras, shape (M,), and of the boards, shape (P, 6)."""
    boards = equations.boards * (1 + damping * np.eye(6))
    cameras = equations.cameras.sum(axis=0)
    cameras = cameras + damping * np.diag(np.diag(cameras))
    pulled = np.linalg.solve(boards, equations.coupling.swapaxes(-1, -2))  # (P, 6, M)
    offset = np.linalg.solve(boards, equations.board_gradient[..., None])[..., 0]
    reduced = cameras - (equations.coupling @ pulled).sum(axis=0)
    gradient = equations.camera_gradient.sum(axis=0) - np.einsum("pmi,pi->m", equations.coupling, offset)
    scale = _scale_diagonal(reduced)
    step = np.linalg.solve(reduced * np.outer(scale, scale), gradient * scale) * scale
    return step, offset - pulled @ step


def _scale_diagonal(matrix: FloatArray) -> FloatArray:
    """Factors, shape (M,), that scale a positive definite matrix, shape (M, M), to a diagonal of ones."""
    diagonal = np.diag(matrix)
    if not (np.isfinite(diagonal).all() and (diagonal > 0).all()):
        raise CameraError(_SINGULAR)
    return np.asarray(1 / np.sqrt(diagonal))


def _apply_steps(scene: BoardScene, camera_step: FloatArray, board_steps: FloatArray, free: BoolArray) -> BoardScene:
    """Scene after a step of the free camera parameters, shape (M,), and of the boards, shape (P, 6)."""
    steps = np.zeros(free.size)
    steps[free] = camera_step
    by_view = steps.reshape(-1, CAMERA_SIZE)
    count = len(INTRINSICS)
    return replace(
        scene,
        intrinsics=scene.intrinsics + by_view[:, :count],
        cam_from_first=_turn_poses(scene.cam_from_first, by_view[:, count:]),
        first_from_board=_turn_poses(scene.first_from_board, board_steps),
    )


def _turn_poses(poses: FloatArray, steps: FloatArray) -> FloatArray:
    """Poses, shape (N, 3, 4), after steps of rotation vector [rad] and translation [m], shape (N, 6)."""
    R = Rotation.from_rotvec(steps[:, :3]).as_matrix() @ poses[:, :, :3]
    return np.concatenate([R, (poses[:, :, 3] + steps[:, 3:])[..., None]], axis=-1)


def _estimate_covariance(equations: _NormalEquations, observations: int) -> tuple[FloatArray, float]:
    """Covariance of the free camera parameters, shape (M, M), and the scatter of the poses over the expected one."""
    poses, size = equations.camera_gradient.shape
    spare = observations - size - 6 * poses
    pulled = np.linalg.solve(equations.boards, equations.coupling.swapaxes(-1, -2))
    information = equations.cameras - equations.coupling @ pulled  # of each pose, (P, M, M)
    scores = equations.camera_gradient - np.einsum("pim,pi->pm", pulled, equations.board_gradient)
    scale = _scale_diagonal(information.sum(axis=0))
    scaled = information * np.outer(scale, scale)
    eigenvalues, vectors = np.linalg.eigh(scaled.sum(axis=0))
    if spare <= 0 or eigenvalues[0] <= 1e-14 * eigenvalues[-1]:
        raise CameraError(
            f"chessboard: expected more observations than unknowns, got {spare} to spare or poses all alike; "
            "add pairs with the board tilted and in other parts of the image"
        )
    whitener = vectors / np.sqrt(eigenvalues)
    variance = equations.cost / spare
    # Whitened scores of the poses sum to zero at the solution; under independent errors their expected squares are
    # M - sum tr(H_p^2), with H_p the pose's share of the whitened information.
    shares = whitener.T @ scaled @ whitener
    whitened = (scores * scale) @ whitener
    between = whitened.T @ whitened * size / (size - float((shares**2).sum()))
    scatter = float(np.trace(between)) / (size * variance) if variance > 0 else 1.0
    middle = variance * np.eye(size)
    if scatter > 1 + _SIGNIFICANT * np.sqrt(2 / (size * (poses - 1))):
        levels, directions = np.linalg.eigh(between)
        middle = (directions * np.maximum(levels, variance)) @ directions.T
    else:
        scatter = 1.0
    return (whitener @ middle @ whitener.T) * np.outer(scale, scale), scatter


def _map_to_camera_parameters(scene: BoardScene, points2d: FloatArray) -> FloatArray:
    """Linear map from all parameters, V * 15, to those a rig's covariance has, shape (10 V, 15 V).

    One focal scale stands for fx and fy. The radial terms are replaced by the one k1 that shifts the seen corners, in
    the least-squares sense, as these terms do together; tangential terms are left out.
    """
    views, count = len(scene.intrinsics), len(CAMERA_PARAMETERS)
    mapping = np.zeros((views, count, views, CAMERA_SIZE))
    for index, intrinsics in enumerate(scene.intrinsics):
        seen = points2d[:, index].reshape(-1, 2)
        radius = np.linalg.norm((seen - intrinsics[2:4]) / intrinsics[:2], axis=-1)
        moment = {power: float(np.nansum(radius**power)) for power in (6, 8, 10)}
        block = mapping[index, :, index]
        block[0, :2] = 0.5 / intrinsics[:2]
        block[[1, 2], [2, 3]] = 1.0
        block[3, 4] = 1.0
        block[3, 5] = moment[8] / moment[6]
        block[3, 8] = moment[10] / moment[6]
        block[4:, len(INTRINSICS) :] = np.eye(6)
    return mapping.reshape(views * count, views * CAMERA_SIZE)
