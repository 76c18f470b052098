"""Pieces of a product in the making: found again, never taken for others, and removed without anything else."""

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.core.pieces import Pieces
from vfm_sdm.errors import ResultsError


def piece(value=1.0):
    return xr.Dataset(
        {
            "position": (("time", "pixel"), np.array([[value, np.nan], [0.1, -0.0]])),
            "status": ("time", np.array([0, 3], np.int8)),
            "same": ("time", np.array([True, False])),
            "rows": (("edge", "row"), np.zeros((2, 0), np.float32)),
            "nothing": ("sample", np.zeros(0)),
        },
        coords={"time": ("time", [0.0, 0.1], {"units": "s"})},
        attrs={"digests": ["a", "b"], "detail": "", "none": None},
    )


def test_a_piece_comes_back_to_the_last_bit(tmp_path):
    Pieces(tmp_path / "tracks", "key").write(1, 12345, piece())
    found = Pieces(tmp_path / "tracks", "key").read(1, 12345)
    xr.testing.assert_identical(found, piece())
    for name, variable in piece().variables.items():
        assert found[name].dtype == variable.dtype
        assert found[name].values.tobytes() == variable.values.tobytes()


def test_pieces_of_others_are_not_taken(tmp_path):
    pieces = Pieces(tmp_path, "key")
    pieces.write(0, 0, piece())
    assert Pieces(tmp_path, "other").read(0, 0) is None
    assert pieces.read(0, 1) is None
    assert pieces.read(1, 0) is None
    Pieces(tmp_path, "other").write(0, 0, piece(2.0))
    assert pieces.read(0, 0) is None


@pytest.mark.parametrize("content", [b"", b"half", None])
def test_damaged_pieces_are_none(tmp_path, content):
    pieces = Pieces(tmp_path, "key")
    pieces.write(0, 0, piece())
    path = tmp_path / "0" / "0000.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[:100] + b"\0" * 50 + whole[150:] if content is None else content)
    assert pieces.read(0, 0) is None
    pieces.write(0, 0, piece())
    assert pieces.read(0, 0) is not None


def test_what_was_half_written_goes_and_pieces_stay(tmp_path):
    pieces = Pieces(tmp_path / "tracks", "key")
    pieces.tidy()
    pieces.write(0, 0, piece())
    half = tmp_path / "tracks" / "0" / ".0001-0123abcd.npz"
    half.write_bytes(b"half")
    pieces.tidy()
    assert not half.exists()
    assert pieces.read(0, 0) is not None


def test_only_pieces_are_removed(tmp_path):
    pieces = Pieces(tmp_path / "tracks", "key")
    pieces.clear()
    pieces.write(0, 0, piece())
    pieces.write(12, 10_000, piece())
    pieces.clear()
    assert list(tmp_path.iterdir()) == []
    kept = [tmp_path / "tracks" / name for name in ("mine.npz", "left/0001.npz", "0/film.mp4", "0/001.npz")]
    for path in kept:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"mine")
    pieces.write(0, 0, piece())
    pieces.clear()
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(kept)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "tracks").write_text("a file")
    with pytest.raises(ResultsError, match="expected to write it, got"):
        Pieces(tmp_path / "tracks", "key").write(0, 0, piece())
