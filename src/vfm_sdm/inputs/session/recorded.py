"""The first products of a session: its recordings, their first frames, and the frames in which points are named."""

from vfm_sdm.core.products import product
from vfm_sdm.inputs.session.chain import SessionChain
from vfm_sdm.inputs.session.model import Session
from vfm_sdm.inputs.session.recordings import RECORDED, FirstFrames, open_views
from vfm_sdm.inputs.session.reference_frames import find_reference_frames
from vfm_sdm.inputs.video import Video

__all__ = ["RecordedChain"]


class RecordedChain(SessionChain):
    """Products of one session, from what was filmed on."""

    @product(reads=RECORDED)
    def recordings(self, session: Session) -> dict[str, Video]:
        """The recordings of all views by name, open."""
        return open_views(session)

    @product(needs=("recordings",))
    def frames(self, session: Session) -> FirstFrames:
        """First frame of every view."""
        return FirstFrames(self.recordings)

    @product(
        reads=(
            *("view.name", "view.time_offset_s", "view.start", "view.use_s"),
            *("point.name", "point.view", "point.frame", "point.time_s"),
        ),
        needs=("recordings",),
        # Other offsets must not cost anything where the frames stay as they are, or all are the first ones.
        identity=lambda numbers: numbers,
    )
    def reference_frames(self, session: Session) -> dict[str, dict[str, int]]:
        """Numbers of the frames in which points are named that come into view later, by view and point."""
        late = any(point.comes_later for point in session.point)
        return find_reference_frames(session, self.recordings) if late else {}
