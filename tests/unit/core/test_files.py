import hashlib

import pytest

from vfm_sdm.core.files import file_hash, replace_file


def test_replace_file_leaves_the_earlier_file_when_writing_fails(tmp_path):
    target = tmp_path / "result.csv"
    target.write_text("earlier")

    def write_half():
        with replace_file(target) as temporary:
            temporary.write_text("hal")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert target.read_text() == "earlier"
    assert [path.name for path in tmp_path.iterdir()] == ["result.csv"]


def test_replace_file_shows_the_file_only_when_it_is_whole(tmp_path):
    target = tmp_path / "new" / "result.csv"
    with replace_file(target) as temporary:
        temporary.write_text("whole")
        assert not target.exists()
        assert temporary.parent == target.parent
        assert temporary.suffix == ".csv"
    assert target.read_text() == "whole"
    assert len(list(target.parent.iterdir())) == 1


def test_replace_file_fails_where_no_folder_can_be(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"), replace_file(tmp_path / "file" / "x.csv"):
        pass


def test_file_hash_is_sha256_of_the_content_across_blocks(tmp_path):
    content = bytes(range(256)) * 5000  # longer than one block
    (tmp_path / "video.mp4").write_bytes(content)
    assert file_hash(tmp_path / "video.mp4") == hashlib.sha256(content).hexdigest()
    with pytest.raises(FileNotFoundError):
        file_hash(tmp_path / "none.mp4")
