"""Files that are longer than memory allows: written part by part, read where they are looked at, and sealed."""

import numpy as np
import pytest
import xarray as xr

from vfm_sdm.core import block_files, netcdf
from vfm_sdm.core.block_files import BlockFile
from vfm_sdm.core.datasets import make_tracks
from vfm_sdm.core.files import match_files
from vfm_sdm.core.netcdf import open_tracks, read_dataset, read_tracks, write_dataset, write_tracks
from vfm_sdm.errors import ResultsError


@pytest.fixture
def long(monkeypatch):
    """Every file is a long one."""
    monkeypatch.setattr(netcdf, "LONG_BYTES", 1)
    monkeypatch.setattr(block_files, "_BLOCK", 7)


def tracks_of(frames=20):
    rng = np.random.default_rng(0)
    position = rng.normal(size=(frames, 2, 2))
    covariance = np.tile(np.eye(2), (frames, 2, 1, 1))
    found = make_tracks(np.arange(frames) / 30, ["a", "b"], position, covariance, np.zeros((frames, 2)), attrs={})
    return found.assign(warp=("point", np.array(["affine", ""], dtype=object))).assign_attrs(
        recording={"gaps": [1, None]}
    )


def break_a_bit(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def test_parts_are_the_whole(long, tmp_path):
    tracks = tracks_of()
    path = write_dataset(tmp_path / "t.nc", tracks)
    xr.testing.assert_identical(read_dataset(path, lambda found: found, kind="tracks", command="make"), tracks)
    with xr.open_dataset(path, engine="h5netcdf") as plain:  # other programs read it as any netCDF
        assert plain.sizes == tracks.sizes


def test_tracks_are_read_where_they_are_looked_at(long, tmp_path):
    whole = {"left": tracks_of(), "right": tracks_of(30)}
    path = write_tracks(tmp_path, whole)
    found = open_tracks(path)
    assert list(found) == ["left", "right"]
    for view, one in found.items():
        assert not one["position"]._in_memory
        xr.testing.assert_identical(one.isel(time=slice(3, 9)).load(), whole[view].isel(time=slice(3, 9)))
        xr.testing.assert_identical(one.load(), read_tracks(path)[view])
        one.close()


def test_damage_is_seen(long, tmp_path):
    path = write_tracks(tmp_path, {"left": tracks_of(200)})
    break_a_bit(path)
    with pytest.raises(
        ResultsError, match=r"expected tracks, got a damaged file \(its content is not what was written"
    ):
        open_tracks(path)
    with pytest.raises(ResultsError, match="got no such file"):
        open_tracks(tmp_path / "none")


def test_blocks_hold_the_same_variables(tmp_path):
    file = BlockFile(tmp_path / "b.nc")
    file.append(tracks_of())
    with pytest.raises(ResultsError, match=r"expected the variables .* in every block, got"):
        file.append(tracks_of().drop_vars("status"))


def test_what_was_written_can_be_changed(tmp_path):
    file = BlockFile(tmp_path / "b.nc")
    file.append(tracks_of())
    file.change("status", slice(5, 8), lambda codes: codes + 2)
    with file.finish(xr.Dataset()) as found:
        assert found["status"].values[:, 0].tolist() == [0] * 5 + [2] * 3 + [0] * 12


def test_a_folder_that_is_a_file_is_named(tmp_path):
    (tmp_path / "in the way").touch()
    with pytest.raises((ResultsError, OSError), match="in the way"):
        BlockFile(tmp_path / "in the way" / "b.nc").append(tracks_of())


def test_patterns_take_folders_that_are_there_literally(tmp_path):
    (tmp_path / "visit [2]").mkdir()
    (tmp_path / "visit 2").mkdir()
    for folder in ("visit [2]", "visit 2"):
        (tmp_path / folder / "a.toml").touch()
    assert match_files(tmp_path / "visit [2]" / "*.toml") == [tmp_path / "visit [2]" / "a.toml"]
    assert match_files(tmp_path / "visit [2]" / "a.toml") == [tmp_path / "visit [2]" / "a.toml"]
    assert sorted(match_files(tmp_path / "*" / "a.toml")) == [
        tmp_path / one / "a.toml" for one in ("visit 2", "visit [2]")
    ]
    assert match_files(tmp_path / "none" / "*.toml") == []
