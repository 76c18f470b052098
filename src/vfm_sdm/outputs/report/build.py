"""The content of a report from the files of a run: every section that there is something to say in, in its order."""

from datetime import date
from importlib.metadata import version
from pathlib import Path

from vfm_sdm.core.registry import find, part_names
from vfm_sdm.errors import BackendUnavailableError, ResultsError, VfmSdmError
from vfm_sdm.outputs.report.content import Content, Paragraph, Section
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language

__all__ = ["build_content"]

_MADE_BY = {
    "field": ("field.nc", "field"),
    "comparison": ("evaluation.json", "evaluate"),
    "fusion": ("fused.nc", "fuse"),
    "modes": ("modes.nc", "modes"),
    "load-test": ("load_test.nc", "load-test"),
    "passages": ("passages.nc", "passages"),
    "repeatability": ("repeatability.nc", "repeat"),
}
"""File that a section is made from beside those of the measurement, and the command that writes it."""


def build_content(inputs: ReportInputs, language: Language, *, day: date | None = None) -> Content:
    """The report on a run.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    day
        Day of the report; today when ``None``.

    Raises
    ------
    ResultsError
        The files are not as a measurement of this version writes them.
    """
    try:
        found = [_build_section(name, inputs, language) for name in part_names("sections")]
        footer = language.say(
            "footer",
            name=inputs.session.name,
            hash=str(inputs.summary.get("session_hash", ""))[:8],
            version=version("vfm-sdm"),
            day=language.day(day or date.today()),
        )
    except VfmSdmError:
        raise
    except _OF_OTHER_FILES as error:
        raise _other_files(inputs.folder, "measure", error) from error
    sections = tuple(section for section in found if section is not None)
    return Content(language.code, language.say("report title"), inputs.session.name, sections, footer)


# Files that other versions wrote, or that somebody edited, may lack anything.
_OF_OTHER_FILES = (LookupError, TypeError, AttributeError, ValueError)


def _other_files(place: Path, command: str, error: Exception) -> ResultsError:
    return ResultsError(
        f"{place}: expected files as this version of vfm-sdm writes them, got others ({type(error).__name__}: "
        f"{error}); run `vfm-sdm {command}` again"
    )


def _build_section(name: str, inputs: ReportInputs, language: Language) -> Section | None:
    """A section; ``None`` where there is nothing to say. A failing section of another package says that it failed."""
    try:
        part = find("sections", name)
    except BackendUnavailableError as error:
        return Section(name, (Paragraph(" ".join(str(error).split()), "quiet", foreign=True),))
    if not part.distribution:
        try:
            section: Section | None = part.load()(inputs, language)
        except _OF_OTHER_FILES as error:
            # Errors of this package may be of these kinds, too, and say more.
            if isinstance(error, VfmSdmError) or name not in _MADE_BY:
                raise
            file, command = _MADE_BY[name]
            raise _other_files(inputs.folder / file, command, error) from error
        return section
    # As of checks: its faults must not cost its users their report.
    try:
        answer = part.load()(inputs, language)
        if answer is None or isinstance(answer, Section):
            return answer
        failed = f"expected the section of {part.distribution} to be a Section, got {answer!r:.60}"
    except Exception as error:  # noqa: BLE001
        failed = f"the section of {part.distribution} failed: {type(error).__name__}: {error}"
    return Section(name, (Paragraph(" ".join(failed.split()), "quiet", foreign=True),))
