"""What all steps of a page share: the folder, the session's draft, the films' pictures, the running measurement."""

import json
from contextlib import suppress
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any

from vfm_sdm.core.threads import thread_pool
from vfm_sdm.errors import SessionError, VfmSdmError
from vfm_sdm.inputs.session import RECORDED, Session, Site
from vfm_sdm.page.draft import Draft
from vfm_sdm.page.folder import Project
from vfm_sdm.page.pictures import Pictures, provisional
from vfm_sdm.page.process import MeasureProcess

if TYPE_CHECKING:
    from vfm_sdm.page.sight import Sight

__all__ = ["PageState"]


class PageState:
    """State of a page; what lasts is in the folder's files.

    Parameters
    ----------
    project
        The folder.
    """

    def __init__(self, project: Project) -> None:
        self.project, self.draft = project, Draft(project.session)
        self.process: MeasureProcess | None = None
        self._pictures: dict[str, Pictures] = {}
        self._sight: tuple[str, Sight] | None = None
        self._lock = Lock()
        self._begun: Thread | None = None

    def begin(self) -> None:
        """Begins to make the first pictures of all views, while the page is built."""
        self._begun = Thread(target=self._make_first, daemon=True)
        self._begun.start()

    def wait(self) -> None:
        """Waits until the first pictures that were begun are there."""
        if self._begun is not None:
            self._begun.join()

    def _make_first(self) -> None:
        with suppress(VfmSdmError):  # whoever asks for a picture is told
            pictures = self.pictures()
            with thread_pool(len(pictures.recordings)) as executor:
                list(executor.map(pictures.picture, pictures.recordings))

    @property
    def fields(self) -> dict[str, Any]:
        """The session's fields as the file holds them now."""
        return self.draft.fields

    def session(self) -> Session:
        """The session as far as it is stated: with its site where that is complete, else of the films alone.

        Raises
        ------
        SessionError
            The films or points cannot be used.
        """
        found, _ = self.draft.session()
        if found is not None:
            return found
        return provisional(self.fields).model_copy(update={"folder": self.project.folder})

    def site(self) -> tuple[Site, str]:
        """The site as stated, and what is wrong with it; nothing where it is right."""
        try:
            return Site(**self.fields.get("site", {})), ""
        except ValueError as error:
            return Site(), str(error)

    @property
    def version(self) -> str:
        """A word that changes with the session's file."""
        path = self.draft.path
        return f"{path.stat().st_mtime_ns:x}" if path.exists() else "0"

    def pictures(self, *, whole: bool = False) -> Pictures:
        """Pictures of the films; opened anew where the session names others.

        Parameters
        ----------
        whole
            Of the whole recordings, instead of the part that is used.

        Raises
        ------
        SessionError
            No film is chosen, or the session names a film outside the folder.
        VideoError
            A film cannot be used.
        """
        session = self._films()
        if whole:
            views = tuple(view.model_copy(update={"use_s": None}) for view in session.view)
            session = session.model_copy(update={"view": views})
        key = json.dumps(session.narrowed(RECORDED).as_fields(), sort_keys=True, default=str)
        with self._lock:
            if key not in self._pictures:
                # The part that is used and the whole are asked for by turns.
                self._pictures = dict([*self._pictures.items()][-1:]) | {key: Pictures(session)}
            return self._pictures[key]

    def sight(self) -> "Sight":
        """What the films show; looked at anew where the session names others, or tells more of their cameras.

        Raises
        ------
        SessionError, VideoError
            As of `pictures`.
        """
        # It brings all that measures, and pictures need not wait for that.
        from vfm_sdm.page.sight import Sight  # noqa: PLC0415

        session, recordings = self._films(), self.pictures().recordings
        key = json.dumps(session.as_fields(), sort_keys=True, default=str)
        with self._lock:
            if self._sight is None or self._sight[0] != key:
                self._sight = key, Sight(session, recordings)
            return self._sight[1]

    def _films(self) -> Session:
        """The session without points, whose films lie in the folder."""
        session = self.session()
        for view in session.view:
            for one in view.video if isinstance(view.video, tuple) else (view.video or view.images,):
                self.project.inside(str(one))
        return session.model_copy(update={"point": ()})

    def measure(self) -> None:
        """Begins to measure, or goes on where an earlier run was stopped.

        Raises
        ------
        SessionError
            Something is missing or wrong in the session, or it measures already.
        """
        if self.measuring:
            raise SessionError("measure: expected one run at a time, got one that works; stop it first")
        found, faults = self.draft.session()
        if found is None:
            raise SessionError("; ".join(faults))
        found.check_points()
        self.process = MeasureProcess(self.project.session, self.project.run)

    @property
    def measuring(self) -> bool:
        """Whether a measurement works."""
        return self.process is not None and self.process.status is None
