"""Commands that write results into a run folder: one at a time, and whoever comes second is told."""

from pathlib import Path

import pytest

from vfm_sdm.commands.app import main
from vfm_sdm.commands.runs import alone_in_run
from vfm_sdm.core.one_writer import held_alone
from vfm_sdm.errors import ResultsError


@pytest.mark.parametrize(
    "words",
    [
        ["modes", "{run}"],
        ["field", "{run}"],
        ["fuse", "{run}", "--sensor", "phone"],
        ["load-test", "{run}", "steps.csv"],
        ["passages", "{run}", "--axis", "vertical", "passages.csv"],
    ],
)
def test_a_second_command_is_told_who_writes(words, tmp_path, capsys):
    typed = [word.format(run=tmp_path) for word in words]
    with held_alone(tmp_path, "analysis", expected="x", advice="y"), pytest.raises(SystemExit) as left:
        main(typed)
    assert left.value.code == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "expected a run folder to which no other command writes results, got one in use by process" in said
    # Alone, what they lack is files.
    with pytest.raises(SystemExit):
        main(typed)
    assert "no such file" in " ".join(capsys.readouterr().err.split()).casefold()


def test_the_folder_is_free_again_whatever_happened(tmp_path):
    def interrupted(run: Path, *, how: type[BaseException]) -> None:
        with pytest.raises(ResultsError, match="expected a run folder to which no other command writes"):
            alone_in_run(interrupted)(run, how=how)
        raise how

    for how in (KeyboardInterrupt, ResultsError):
        with pytest.raises(how):
            alone_in_run(interrupted)(tmp_path, how=how)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_not_made(tmp_path):
    with pytest.raises(SystemExit):
        main(["modes", str(tmp_path / "nowhere")])
    assert not (tmp_path / "nowhere").exists()
