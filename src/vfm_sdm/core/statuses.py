"""Every status of the package: why there is no result, or why it should not be trusted; ``ok`` says that it can be.

Each is text, as files and summaries hold it; the codes of samples that arrays hold are `vfm_sdm.core.datasets.Status`.
"""

from enum import StrEnum

__all__ = [
    "BoardStatus",
    "CameraMotionStatus",
    "CameraStatus",
    "ClockStatus",
    "Outcome",
    "PointStatus",
    "RecordingStatus",
    "RefinementStatus",
    "SampleStatus",
    "Verdict",
]


class SampleStatus(StrEnum):
    """What a sample of a track or of a displacement is worth; their order is that of the codes."""

    OK = "ok"
    """Found and trusted."""
    LOST = "lost"
    """Not found again; NaN."""
    OUTSIDE = "outside"
    """Left the image; NaN."""
    UNRELIABLE = "unreliable"
    """Found, but with poor resemblance or uncertainty; the value stands, use with care."""
    BEHIND = "behind_camera"
    """Triangulated behind a camera: the rays do not meet in front of both; NaN. In displacement only."""


class RecordingStatus(StrEnum):
    """How a pass over a recording ended."""

    OK = "ok"
    """All that was asked for was read."""
    TRUNCATED = "truncated"
    """The file ends early."""
    CORRUPT = "corrupt"
    """Data or time stamps are damaged."""
    NOT_READ = "not read"
    """There was no pass."""


class PointStatus(StrEnum):
    """Where a named point is in a view."""

    OK = "ok"
    NOT_LOOKED_FOR = "not looked for"
    """Nobody named it there, and no search was made."""
    NOT_FOUND = "not found in the other view"
    AMBIGUOUS = "several places look alike"
    NOT_RETURNED = "the way back ends elsewhere"


class CameraStatus(StrEnum):
    """What cameras are worth; other packages' estimators may have others."""

    OK = "ok"
    ONE_VIEW = "one view: motion in the image plane only"
    TOO_FEW_MATCHES = "too few matches between the views"
    NO_COMMON_SCALE = "too few points seen in three views"
    CONTRADICTION = "focal lengths contradict what is known of the lenses"
    BASELINES_DISAGREE = "chessboard and measured baseline disagree"
    NOT_A_CAMERA = "VGGT gave no field of view or no rotation"
    ONE_PLACE = "VGGT put the first two cameras in one place"
    NOT_RECONSTRUCTED = "structure from motion did not converge"
    DISAGREE = "priors and images disagree"
    """Some quantity left its prior or its measured value by more than three standard deviations."""
    NOT_IDENTIFIABLE = "focal length not determined"
    """No focal prior and nothing measured on site that fixes the focal length: displacement has no usable scale."""
    UNKNOWN_DISTANCE = "distance of a further camera not determined"
    """Too few points that three views see, and nothing measured, tell how far a third camera stands."""
    NOT_CONVERGED = "site adjustment did not converge"


class BoardStatus(StrEnum):
    """Why a pair of pictures of a chessboard is left out."""

    AMBIGUOUS_ORDER = "order of the corners ambiguous: the board may be turned in one view"
    INCONSISTENT_POSE = "board pose disagrees with the other pairs in every order of the corners"


class CameraMotionStatus(StrEnum):
    """What became of a view in which static points show the camera's motion; the first two change its tracks."""

    OK = "ok"
    """Static points, each predicted by the others, scatter less."""
    ONE_POINT = "one static point"
    """The motion was removed, but nothing shows that the point did not move itself."""
    STILL = "still"
    """The static points shift no more than their noise, or each for itself."""
    NO_GAIN = "no gain"
    """They shift together, but not as a moving camera would make them."""
    NO_POINTS = "no static points"
    """None has a known depth."""


class ClockStatus(StrEnum):
    """What a lag between two clocks is worth; with every status but `OK` and `STATED` there is none."""

    OK = "ok"
    STATED = "as stated"
    """The session's offset was taken, because nobody asked the motion."""
    NOT_UNIQUE = "peak not unique"
    """Other lags explain the recordings as well within the noise, as with periodic motion."""
    NO_MOTION = "no common motion"
    """At no lag of the search are the recordings more alike than unrelated noise is: still, or another motion."""
    TOO_SHORT = "too short"
    """No lag of the search leaves enough common samples."""
    TOO_SLOW = "too few samples a second for the band"
    """Sampling shows no motion of the band: pictures taken one by one, for example."""
    AT_EDGE = "peak at the edge of the search"
    """The best lag may lie outside the search."""
    NOT_CONVERGED = "not converged"
    """No lag near the best of the search is better than its neighbours on both sides."""


class RefinementStatus(StrEnum):
    """What became of a point in the refinement; with every status but `OK` its tracks are as they were."""

    OK = "ok"
    BOTH_POOR = "both views poor"
    """No view tracks it well enough to serve as the reference."""
    UNKNOWN = "uncertainty unknown"
    """Its covariances do not tell which view is the poorer; name one."""
    TOO_FEW_FRAMES = "too few frames"
    """Fewer than three are triangulated."""
    NO_STILL_FRAMES = "no still frames"
    """None of them lies in the still interval."""
    NOT_CONVERGED = "not converged"
    """The iteration found no minimum."""


class Outcome(StrEnum):
    """How a check of the audit ended."""

    PASS = "pass"
    CAUTION = "caution"
    FAIL = "fail"
    NOT_POSSIBLE = "not possible"
    """Something that it needs was not measured or not filmed; the sentence says what."""


class Verdict(StrEnum):
    """What the checks of the audit add up to."""

    FIT = "fit to use"
    CARE = "use with care"
    REFUSED = "do not use"
