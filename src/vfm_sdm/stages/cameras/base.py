"""Interface of camera estimators, their result, and the look-up of one by name; `vfm_sdm.core.parts` lists them."""

from dataclasses import dataclass
from typing import Any, Protocol

from vfm_sdm.core.registry import find, make
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.inputs.session import FirstFrames, Method, Session
from vfm_sdm.stages.matching.matches import Matches

__all__ = ["CameraEstimate", "CameraEstimator", "Hypothesis", "estimator_of", "find_estimator"]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Cameras that the images allow beside others, see `CameraEstimate`.

    Parameters
    ----------
    rig
        Cameras of all views with their prior covariance.
    matches
        Matches that agree with them.
    halves
        The same from either half of all matches, for a few ways of halving them; empty where the cameras do not follow
        from matches alone.
    """

    rig: Rig
    matches: tuple[Matches, ...]
    halves: tuple[tuple["Hypothesis", "Hypothesis"], ...] = ()


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """Cameras of all views as an estimator found them.

    Parameters
    ----------
    rig
        Cameras in the order of the session's views; the first one is the reference camera. ``rig.covariance`` is
        ordered as `vfm_sdm.geometry.camera.CAMERA_PARAMETERS`, ten parameters a camera. ``None`` where the images did
        not allow an estimate; the status says why.
    matches
        Matches between pairs of views, for the adjustment to the site; empty where the estimator matched nothing.
    status
        ``"ok"``, or the name of what makes the estimate doubtful or impossible.
    notes
        Sentences for the summary and the audit.
    others
        Further cameras that the images allow; the adjustment to the site decides.
    halves
        See `Hypothesis`.
    """

    rig: Rig | None
    matches: tuple[Matches, ...] = ()
    status: str = CameraStatus.OK
    notes: tuple[str, ...] = ()
    others: tuple[Hypothesis, ...] = ()
    halves: tuple[tuple[Hypothesis, Hypothesis], ...] = ()


class CameraEstimator(Protocol):
    """Part that finds the cameras of a session's views."""

    name: str

    def estimate(self, session: Session, frames: FirstFrames) -> CameraEstimate:
        """Cameras of all views.

        Parameters
        ----------
        session
            Measurement session.
        frames
            First frame of each view by view name, in the session's order; a mapping of brightness, shape (H, W) each,
            that also gives the colours.

        Returns
        -------
        estimate
            Cameras, their matches, and a status.

        Raises
        ------
        CameraError
            The input does not suffice for an estimate.
        """
        ...


def estimator_of(method: Method) -> CameraEstimator:
    """Camera estimator that a session asks for, with the session's settings.

    Parameters
    ----------
    method
        Section ``[method]`` of the session.

    Returns
    -------
    estimator
        Estimator of the name ``method.cameras``.

    Raises
    ------
    BackendUnavailableError
        No estimator has this name, or it cannot run here.
    """
    estimator: CameraEstimator = make("cameras", method)
    return estimator


def find_estimator(name: str, **options: Any) -> CameraEstimator:
    """Camera estimator of this name, made with the given options.

    Parameters
    ----------
    name
        Name of the estimator.
    options
        Keyword arguments of the estimator's class.

    Returns
    -------
    estimator
        Estimator with these options.

    Raises
    ------
    BackendUnavailableError
        No estimator has this name, or it cannot run here.

    Examples
    --------
    >>> find_estimator("chessboard", refine_px=5).name
    'chessboard'
    """
    estimator: CameraEstimator = find("cameras", name).make(**options)
    return estimator
