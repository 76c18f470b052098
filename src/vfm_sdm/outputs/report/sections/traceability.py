"""Where every number comes from: inputs, versions, settings, and hashes that anybody can compute again."""

from collections.abc import Iterator, Mapping
from typing import Any

from vfm_sdm.core.run_folder import SESSION
from vfm_sdm.outputs.report.content import Block, Cell, Facts, Paragraph, Section, Table
from vfm_sdm.outputs.report.inputs import ReportInputs
from vfm_sdm.outputs.report.language import Language

__all__ = ["describe_traceability"]


def describe_traceability(inputs: ReportInputs, language: Language) -> Section:
    """Hashes of session and inputs and how to compute them, versions, operating system, settings, time and notes.

    Parameters
    ----------
    inputs
        Files of the run.
    language
        Language of the texts.
    """
    summary = inputs.summary
    facts = [
        (language.say("session hash"), Cell(str(summary.get("session_hash", "")))),
        (language.say("session file", file=SESSION), Cell(str(summary.get("session_file", "")))),
        (language.say("result key"), Cell(str(inputs.displacement.attrs.get("key", "")))),
        (language.say("system"), Cell(_describe_system(summary.get("system"), language))),
        (language.say("versions"), Cell(", ".join(f"{name} {one}" for name, one in summary["versions"].items()))),
    ]
    blocks: list[Block] = [
        Facts(tuple(facts)),
        Paragraph(language.say("how to hash", file=SESSION)),
        Paragraph(
            'python -c "from vfm_sdm.inputs.session import read_session, session_hash; '
            "print(session_hash(read_session('session.toml')))\"",
            "code",
        ),
    ]
    files = tuple((Cell(str(name)), Cell(str(value))) for name, value in summary["input_hashes"].items())
    if files:
        columns = (language.say("file"), language.say("hash"))
        blocks.append(Table(language.say("table files"), columns, files, words=2))
    seconds = tuple((Cell(str(name)), language.cell(value, 1)) for name, value in summary["seconds"].items())
    blocks.append(Table(language.say("table seconds"), (language.say("step"), language.say("time s")), seconds))
    settings = tuple((Cell(name), Cell(value)) for name, value in _flatten(_method(inputs)))
    columns = (language.say("setting"), language.say("value"))
    blocks.append(Table(language.say("table settings"), columns, settings, words=2))
    notes = tuple(str(note) for note in summary.get("notes", []))
    if notes:
        blocks += [Paragraph(language.say("notes head")), *language.listed(map(language.tell, notes))]
    return Section(language.say("title traceability"), tuple(blocks))


def _describe_system(system: Mapping[str, Any] | None, language: Language) -> str:
    """Operating system and processors of the machine that measured."""
    if not system:
        return language.say("not recorded")
    return language.say(
        "system is", platform=system["platform"], processor=system["processor"], count=system["processors"]
    )


def _method(inputs: ReportInputs) -> dict[str, Any]:
    method: dict[str, Any] = inputs.session.as_fields()["method"]
    return method


def _flatten(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Keys with dots and values as text, of tables in tables; without those that say nothing."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", str(value)
