"""Which files are one sequence, and where numbers are missing."""

from pathlib import Path

import numpy as np
import pytest

from vfm_sdm.inputs.video.numbering import read_numbering


def names(*numbers: int, form: str = "img{:04d}.png") -> list[Path]:
    return [Path(form.format(number)) for number in numbers]


def test_a_whole_sequence_is_evenly_apart():
    found = read_numbering(names(*range(5, 25)))
    np.testing.assert_array_equal(found.ticks, np.arange(20))
    assert found.remarks == ()


@pytest.mark.parametrize("step", [1, 2, 10])
def test_missing_numbers_are_gaps_in_time(step):
    numbers = [step * n for n in range(30) if n not in (7, 8, 20)]
    found = read_numbering(names(*numbers))
    np.testing.assert_array_equal(found.ticks, [n for n in range(30) if n not in (7, 8, 20)])
    assert len(found.remarks) == 1
    assert "3 numbers are missing in the sequence, the first after" in found.remarks[0]


def test_foreign_files_are_left_out_and_named():
    found = read_numbering([*names(*range(20)), Path("board.png"), Path("overview_2.png")])
    assert len(found.files) == 20
    assert "2 files whose names do not belong to the sequence are left out: board.png, overview_2.png" in found.remarks


@pytest.mark.parametrize(
    "files",
    [
        [Path(f"IMG_20261127_10{minute:02d}{second:02d}.jpg") for minute in range(3) for second in (1, 17, 40)],
        [Path(f"{name}.png") for name in "abcdefgh"],
        [Path(f"{folder}/img{number}.png") for folder in ("100", "101") for number in range(5)],
        names(3),
    ],
    ids=["stamps", "letters", "two numbers", "one file"],
)
def test_names_that_are_no_counter_are_a_constant_time_apart(files):
    found = read_numbering(files)
    np.testing.assert_array_equal(found.ticks, np.arange(len(files)))
    assert list(found.files) == files
