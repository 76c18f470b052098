"""Every status of the package: the reason why there is no result or why it should not be trusted, else ``ok``.

Each is text as in files and summaries; the codes of samples in arrays are `vfm_sdm.core.datasets.Status`.
"""

from enum import StrEnum

__all__ = [
    "BoardStatus",
    "CameraMotionStatus",
    "CameraStatus",
    "ClockStatus",
    "ClockUse",
    "FusedStatus",
    "FusionStatus",
    "InjectionStatus",
    "LensStatus",
    "ModeStatus",
    "Outcome",
    "PassageStatus",
    "PointStatus",
    "ReadingStatus",
    "RecordingStatus",
    "RefinementStatus",
    "RevisitStatus",
    "SampleStatus",
    "SessionOutcome",
    "Verdict",
]


class SampleStatus(StrEnum):
    """Status of a sample of a track or of a displacement; the members are in the order of the codes."""

    OK = "ok"
    """Found and trusted."""
    LOST = "lost"
    """Not found again; NaN."""
    OUTSIDE = "outside"
    """Left the image; NaN."""
    UNRELIABLE = "unreliable"
    """Found, but with low correlation or large uncertainty; the value is kept, to be used with care."""
    BEHIND = "behind_camera"
    """Triangulated behind a camera: the rays do not meet in front of both; NaN. In displacement only."""


class ReadingStatus(StrEnum):
    """Status of a sample of a sensor's recording; the members are in the order of the codes."""

    OK = "ok"
    MISSING = "missing"
    """Not recorded; NaN."""
    CLIPPED = "clipped"
    """At the end of the sensor's range: the structure went further."""
    STUCK = "stuck"
    """The last value again, while the structure moved."""


class RecordingStatus(StrEnum):
    """Status of a pass over a recording at its end."""

    OK = "ok"
    """All requested frames were read."""
    TRUNCATED = "truncated"
    """The file ends early."""
    CORRUPT = "corrupt"
    """Data or time stamps are damaged."""
    NOT_READ = "not read"
    """There was no pass."""


class PointStatus(StrEnum):
    """Status of a named point's position in a view."""

    OK = "ok"
    NOT_LOOKED_FOR = "not looked for"
    """The session gives no pixel there, and no search was made."""
    NOT_FOUND = "not found in the other view"
    AMBIGUOUS = "several places look alike"
    NOT_RETURNED = "the way back ends elsewhere"
    NO_TEXTURE = "no texture to follow"
    """What moves with the point has no texture, across no edge either: it cannot be tracked."""


class LensStatus(StrEnum):
    """Status of a lens that was found from a pan clip."""

    OK = "ok"
    STILL = "the camera hardly turns"
    """Too few frames show another part of the scene."""
    FEW_PLACES = "too few places seen again"
    NOT_DETERMINED = "the turns do not determine the focal length"
    MOVED = "something else than turns moves the picture"
    """The camera was carried about, the scene moves, or stabilisation shifts the picture."""
    CHANGING = "the focal length changes"
    """The lens zooms, or its focus hunts."""
    NEARER = "the scene is nearer, or the lever longer, than stated"
    """Parallax that what was stated of scene and tripod does not allow."""


class CameraStatus(StrEnum):
    """Status of estimated cameras; estimators of other packages may have further ones."""

    OK = "ok"
    ONE_VIEW = "one view: motion in the image plane only"
    TOO_FEW_MATCHES = "too few matches between the views"
    NOT_CLEAR = "no cameras stand out from chance"
    """Matches agree with a pose no better than unrelated ones would, as with what repeats."""
    NO_LENGTH = "no length is known"
    """None was measured, and the sensor that was to tell one does not see the motion."""
    NO_COMMON_SCALE = "too few points seen in three views"
    CONTRADICTION = "focal lengths contradict what is known of the lenses"
    BASELINES_DISAGREE = "chessboard and measured baseline disagree"
    NOT_A_CAMERA = "the network gave no field of view or no rotation"
    ONE_PLACE = "the network put the first two cameras in one place"
    NOT_RECONSTRUCTED = "structure from motion did not converge"
    DISAGREE = "priors and images disagree"
    """A quantity differs from its prior or measured value by more than three standard deviations."""
    NOT_IDENTIFIABLE = "focal length not determined"
    """No focal prior and nothing measured on site that fixes the focal length: displacement has no usable scale."""
    UNKNOWN_DISTANCE = "distance of a further camera not determined"
    """Too few points are seen in three views, and nothing was measured, to determine the distance of a third camera."""
    SEVERAL = "several cameras agree with everything known"
    """The uncertainty spans them; a note names the reading that would decide."""
    NOT_CONVERGED = "site adjustment did not converge"
    BEHIND = "the scene lies behind the cameras"
    """Most matches of two views do not meet in front of both: the baseline is reversed, or a camera turned about."""
    TURNED = "a camera is turned far from where it was estimated"
    """By more than five of the standard deviations that its estimator states: one of them is wrong."""


class BoardStatus(StrEnum):
    """Reason why a pair of pictures of a chessboard is left out."""

    AMBIGUOUS_ORDER = "order of the corners ambiguous: the board may be turned in one view"
    INCONSISTENT_POSE = "board pose disagrees with the other pairs in every order of the corners"


class CameraMotionStatus(StrEnum):
    """Result of the removal of camera motion in a view.

    With `OK`, `ONE_POINT`, `FOLLOWED` and `FOLLOWED_BY_THREE` its tracks are changed.
    """

    OK = "ok"
    """Static points, each predicted by the others, scatter less."""
    ONE_POINT = "one static point"
    """The motion was removed, but nothing shows that the point did not move itself."""
    STILL = "still"
    """The static points move no more than their noise, or not together."""
    NO_GAIN = "no gain"
    """The static points move together, but not as with a moving camera."""
    NO_POINTS = "no static points"
    """No static point has a known depth."""
    FOLLOWED = "followed"
    """The camera moves far; its pose was found in each frame, and the static points predict each other."""
    FOLLOWED_BY_THREE = "followed by three static points"
    """The same, but nothing shows that these points did not move themselves."""
    TOO_FEW = "too few static points"
    """The camera moves far, and fewer than three static points show how."""
    NOT_DETERMINED = "static points do not determine the pose"
    """The camera moves far, and the static points lie on one line, or too close together, or are seen too rarely."""


class ClockStatus(StrEnum):
    """Status of a lag between two clocks; with every status but `OK` and `STATED` there is no lag."""

    OK = "ok"
    STATED = "as stated"
    """The session's offset was used, because no estimate from the motion was requested."""
    NOT_UNIQUE = "peak not unique"
    """Other lags explain the recordings as well within the noise, as with periodic motion."""
    NO_MOTION = "no common motion"
    """At no lag of the search are the recordings more alike than unrelated noise: no motion, or different motion."""
    TOO_SHORT = "too short"
    """No lag of the search leaves enough common samples, or those about its centre do not."""
    TOO_SLOW = "too few samples a second for the band"
    """The sampling is too slow for motion in the band, for example with pictures taken one by one."""
    AT_EDGE = "peak at the edge of the search"
    """The best lag may lie outside the search."""
    NOT_CONVERGED = "not converged"
    """No lag near the best of the search is better than its neighbours on both sides."""


class ClockUse(StrEnum):
    """What became of a point when the lag between two clocks was estimated."""

    USED = "used"
    NOT_ASKED = "not asked"
    """A static point, or the offset was not estimated from the motion."""
    TOO_FEW = "too few common samples"
    NO_MOTION = "no common motion above its noise"
    DISAGREES = "moves otherwise than most"
    """Its own best lag is another one; it was left out."""


class FusionStatus(StrEnum):
    """Whether a point's displacement and a sensor's acceleration became one displacement."""

    OK = "ok"
    NO_MOTION = "the sensor does not see the motion"
    """At no lag are video and sensor more alike than noise: another place, another sign, or nothing moved."""
    AMBIGUOUS = "several lags agree"
    """As with periodic motion: state roughly when the sensor began."""
    AT_EDGE = "the lag lies outside the search"
    TOO_SHORT = "too short together"
    """Video and sensor have too few samples at the same time."""
    OTHER_SIZE = "video and sensor differ in size or sign"
    """By more than a sensor may: other units, or a reversed axis."""


class FusedStatus(StrEnum):
    """Status of a sample of fused displacement; the members are in the order of the codes."""

    OK = "ok"
    BRIDGED = "bridged"
    """In a gap of the video: from the sensor alone, with the uncertainty that grows from both ends."""
    NO_SENSOR = "no_sensor"
    """The sensor recorded nothing, or was at the end of its range; NaN."""


class InjectionStatus(StrEnum):
    """Whether the gain and noise of a point were measured by motion injected into its recording."""

    OK = "ok"
    AS_OTHERS = "taken from other points of its grid"
    NOT_COMPRESSED = "the recording is neither H.264 nor HEVC"
    TOO_SHORT = "the recording is too short"
    NO_SUBSET = "the tracker compares no subsets"
    STILL = "the point does not move beyond its noise"
    LOST = "the point is lost in the recording, or in what was injected"
    NO_ENCODER = "no encoder of the recording's codec"
    """The installed PyAV cannot encode what it can decode."""


class RefinementStatus(StrEnum):
    """Result of the refinement of a point; with every status but `OK` its tracks are unchanged."""

    OK = "ok"
    EDGE = "measured across an edge only"
    """The point's depth comes from where it is measured; a correction along the picture's rows would be none."""
    BOTH_POOR = "both views poor"
    """No view tracks it well enough to serve as the reference."""
    UNKNOWN = "uncertainty unknown"
    """The point's covariances do not show which view is the poorer; name one."""
    TOO_FEW_FRAMES = "too few frames"
    """Fewer than three frames are triangulated."""
    NO_STILL_FRAMES = "no still frames"
    """No triangulated frame lies in the still interval."""
    NOT_CONVERGED = "not converged"
    """The iteration found no minimum."""


class Outcome(StrEnum):
    """Result of a check of the audit."""

    PASS = "pass"
    CAUTION = "caution"
    FAIL = "fail"
    NOT_POSSIBLE = "not possible"
    """A measurement or recording that the check needs is missing; the sentence names it."""


class Verdict(StrEnum):
    """Overall result of the audit's checks."""

    FIT = "fit to use"
    CARE = "use with care"
    NOT_JUDGED = "not judged"
    REFUSED = "do not use"


class SessionOutcome(StrEnum):
    """What became of one session of many."""

    MEASURED = "measured"
    """At least one sample is ok; the verdict says what it is worth."""
    NO_RESULT = "no result"
    """The input was right, the data did not allow a result."""
    FAILED = "failed"
    """The session or its files cannot be used."""


class RevisitStatus(StrEnum):
    """Whether the change of a point's rest position since an earlier visit is known."""

    OK = "ok"
    NOT_FOUND = "not found again in two views"
    """Its place of the earlier visit is not seen again, or one of the visits did not follow it."""
    LOOK_ALIKE = "several places look alike"
    """In a view the place that was found is not where the later session has the point."""
    FEW_STATIC = "fewer than three static points found again"
    NO_CAMERAS = "one of the visits has no metric cameras"
    SCALES_DISAGREE = "the scales of the visits disagree"
    """A length was measured wrong, or a focal length stated too well."""
    STATIC_MOVED = "static points moved against each other"
    NOT_CONVERGED = "not converged"


class PassageStatus(StrEnum):
    """Whether the amplification of a vehicle's passage is known at a point and along an axis."""

    OK = "ok"
    GAPS = "gaps"
    """Samples are missing in the passage, or in the second before it, or the recording ends with it."""
    NO_FREQUENCY = "no frequency"
    """The structure shows no clear oscillation, so that nothing says where the static part ends."""
    TOO_FAST = "too fast"
    """The passage is too short to tell its static part from the structure's oscillation."""
    IN_NOISE = "within noise"
    """The static part is not clear of it, or less than a tenth of the vibration beside it."""


class ModeStatus(StrEnum):
    """What is known of a mode, or why a candidate is none; only the first two are given a frequency."""

    OK = "ok"
    DAMPING_UNKNOWN = "record too short for damping"
    """The interval of the damping is as wide as the damping itself."""
    FREQUENCY_UNKNOWN = "frequency not known to 5 %"
    NO_SUPPORT = "not clear of noise"
    """The record is not far more probable with the mode than without it."""
    TWIN = "second half of one peak"
    """A mode of about the same shape and frequency is there."""
    DRIVEN = "driven at one frequency"
    """Damping below that of any structure: steps, machines."""
    TOO_MANY = "more modes than asked for"
