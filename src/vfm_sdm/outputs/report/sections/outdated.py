"""A word where a result is older than the displacement in the same folder."""

import xarray as xr

from vfm_sdm.outputs.report.content import Paragraph
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language

__all__ = ["warn_outdated"]


def warn_outdated(inputs: ReportInputs, result: xr.Dataset, command: str, language: Language) -> tuple[Paragraph, ...]:
    """A paragraph where a result was made of another displacement than the one in the folder; else nothing.

    Parameters
    ----------
    inputs
        Files of the run.
    result
        Dataset that names what it was made of in ``displacement_key``.
    command
        Command that makes it.
    language
        Language of the texts.
    """
    made_of, here = result.attrs.get("displacement_key", ""), inputs.displacement.attrs.get("key", "")
    return (Paragraph(language.say("outdated", command=command), "care"),) if made_of and made_of != here else ()
