"""The folder that a page works in: what is listed, and that nothing leads out of it."""

import os

import numpy as np
import pytest

from tagged_films import write_tagged
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.page.folder import Project


@pytest.mark.parametrize(
    "path", ["..", "../other.mp4", "films/../../x", "/etc/passwd", "link/secret.mp4", "link", "a\0b"]
)
def test_nothing_outside_the_folder_is_reached(tmp_path, path):
    folder, outside = tmp_path / "page", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    (outside / "secret.mp4").touch()
    (folder / "link").symlink_to(outside)
    with pytest.raises(SessionError, match="expected a path in the page's folder, got one outside"):
        Project(folder).inside(path)


def test_what_is_inside_is_found(tmp_path):
    (tmp_path / "films").mkdir()
    assert Project(tmp_path).inside("films/a.mp4") == tmp_path.resolve() / "films" / "a.mp4"
    assert Project(tmp_path).inside("films/../b.mp4") == tmp_path.resolve() / "b.mp4"


def test_a_folder_must_be_there(tmp_path):
    with pytest.raises(SessionError, match="expected a folder with films, got none"):
        Project(tmp_path / "nothing")


def test_films_are_listed_and_chapters_grouped(tmp_path):
    (tmp_path / "cam").mkdir()
    (tmp_path / "run").mkdir()
    for name in ("GX010012.MP4", "GX020012.MP4", "GX010013.MP4", "bank.mp4", "cam/right.mov", "run/not.mp4"):
        write_tagged(tmp_path / name, {})
    (tmp_path / "broken.mp4").write_bytes(b"no film")
    (tmp_path / "notes.txt").touch()
    films = Project(tmp_path).films()
    assert [film.files for film in films] == [
        ("GX010012.MP4", "GX020012.MP4"), ("GX010013.MP4",), ("bank.mp4",), ("broken.mp4",), ("cam/right.mov",),
    ]  # fmt: skip
    assert films[0].video == ["GX010012.MP4", "GX020012.MP4"]
    assert films[2].video == "bank.mp4"
    broken = films[3]
    assert broken.info is None
    assert np.isnan(broken.bits_per_pixel)
    assert "expected" in broken.warnings[0]
    assert all(film.info.width == 96 for film in films if film is not broken)


def test_bits_a_pixel_are_counted(tmp_path):
    path = write_tagged(tmp_path / "bank.mp4", {})
    [film] = Project(tmp_path).films()
    stated = film.bits_per_pixel * 96 * 72 * film.info.frame_count / 8
    assert 0 < stated <= path.stat().st_size


def test_one_page_works_in_a_folder_at_a_time(tmp_path):
    refusal = rf"expected a folder without a page, got one in use by process {os.getpid()} on"
    with Project(tmp_path).opened(), pytest.raises(ResultsError, match=refusal), Project(tmp_path).opened():
        pass
    with Project(tmp_path).opened():
        pass
    assert list(tmp_path.iterdir()) == []
