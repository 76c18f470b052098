"""Weights: where they lie, how they are fetched, and what is said when they cannot be."""

import hashlib
import io
import re
import shutil
import threading
import tomllib
import urllib.error
from dataclasses import replace
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import platformdirs.windows
import pytest
from platformdirs.macos import MacOS
from platformdirs.unix import Unix
from platformdirs.windows import Windows

from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks import checkpoints, download, weights
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import (
    fetch_weights,
    find_weights,
    is_licence_accepted,
    local_weights,
    weights_folder,
    weights_id,
)

CONTENT = bytes(range(256)) * 40


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    """An empty folder of weights, whose registry entries are as small as the test's content."""
    place = tmp_path / "weights"
    monkeypatch.setenv("VFM_SDM_WEIGHTS", str(place))
    for name, one in CHECKPOINTS.items():
        monkeypatch.setitem(checkpoints.CHECKPOINTS, name, replace(one, size_bytes=len(CONTENT)))
    return place


class Response(io.BytesIO):
    """What urlopen returns."""

    def __init__(self, content: bytes, length: int | None):
        super().__init__(content)
        self.headers = {} if length is None else {"Content-Length": str(length)}


@pytest.fixture
def address(monkeypatch):
    """Answers of plain addresses; the list holds what was asked for."""
    asked: list[str] = []

    def answer(content: bytes = CONTENT, length: int | None = len(CONTENT), error: Exception | None = None):
        def urlopen(url, timeout):
            asked.append(url)
            assert timeout > 0
            if error is not None:
                raise error
            return Response(content, length)

        monkeypatch.setattr(download.urllib.request, "urlopen", urlopen)
        return asked

    return answer


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} if folder.exists() else set()


def test_the_registry_states_size_licence_and_source_of_every_checkpoint(monkeypatch):
    monkeypatch.undo()
    assert {one.network for one in CHECKPOINTS.values()} == {
        *("vggt", "tapir", "posediffusion", "aliked", "lightglue", "xfeat")
    }
    for name, one in CHECKPOINTS.items():
        assert one.name == name
        assert one.size_bytes > 1e6
        assert one.licence
        assert one.licence_url.startswith("https://")
        assert one.page.startswith("https://")
        assert Path(one.file_name).suffix in {".safetensors", ".pt", ".pth"}
    assert [name for name, one in CHECKPOINTS.items() if one.gated] == ["vggt-1b-commercial"]
    assert {CHECKPOINTS[n].licence for n in ("bootstapir", "bootstapir-causal", "tapir-panning")} == {"Apache-2.0"}
    assert CHECKPOINTS["vggt-1b"].licence == "CC-BY-NC-4.0"
    assert CHECKPOINTS["vggt-1b"].size == "5.03 GB"
    assert CHECKPOINTS["bootstapir"].size == "219 MB"
    assert CHECKPOINTS["bootstapir"].page.endswith("/dm-tapnet/bootstap/bootstapir_checkpoint_v2.pt")


@pytest.fixture
def home(monkeypatch, tmp_path):
    """A user's empty home; without variables that would point elsewhere."""
    for name in ("VFM_SDM_WEIGHTS", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(platformdirs.windows, "get_win_folder", lambda name: f"{tmp_path}/AppData/{name}")
    return tmp_path


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        (Unix, {"VFM_SDM_WEIGHTS": "/data/w"}, "/data/w"),
        (Unix, {"VFM_SDM_WEIGHTS": "~/w"}, "w"),
        (Unix, {}, ".cache/vfm-sdm/weights"),
        (Unix, {"XDG_CACHE_HOME": "/cache"}, "/cache/vfm-sdm/weights"),
        (Unix, {"XDG_CACHE_HOME": "not/absolute"}, ".cache/vfm-sdm/weights"),
        (MacOS, {}, "Library/Caches/vfm-sdm/weights"),
        (Windows, {}, "AppData/CSIDL_LOCAL_APPDATA/vfm-sdm/weights"),
    ],
)
def test_weights_lie_in_the_users_cache_or_where_the_variable_says(monkeypatch, home, platform, variables, expected):
    monkeypatch.setattr(platformdirs, "PlatformDirs", platform)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert weights_folder() == home / expected


def test_weights_that_an_earlier_version_fetched_are_still_found(monkeypatch, home):
    monkeypatch.setattr(platformdirs, "PlatformDirs", MacOS)
    monkeypatch.setenv("XDG_CACHE_HOME", str(home / "xdg"))
    earlier = home / "Library" / "Caches" / "vfm-sdm" / "weights"
    earlier.mkdir(parents=True)
    assert weights_folder() == home / "xdg" / "vfm-sdm" / "weights"
    (earlier / "vggt-1b.safetensors").touch()
    assert weights_folder() == earlier
    (home / "xdg" / "vfm-sdm" / "weights").mkdir(parents=True)
    assert weights_folder() == home / "xdg" / "vfm-sdm" / "weights"


def test_a_name_that_is_not_here_says_which_command_brings_it(folder):
    with pytest.raises(BackendUnavailableError, match=r"run `vfm-sdm weights fetch vggt-1b`$") as error:
        find_weights("vggt-1b")
    assert "\n" not in str(error.value)
    assert str(folder) in str(error.value)


def test_a_local_file_needs_neither_registry_nor_network(tmp_path):
    for suffix in (".safetensors", ".pt", ".pth"):
        file = tmp_path / f"mine{suffix}"
        file.write_bytes(b"x")
        assert find_weights(file) == find_weights(str(file)) == file


def test_other_words_and_absent_files_are_refused(tmp_path):
    with pytest.raises(BackendUnavailableError, match=r"expected one of \['aliked-lightglue'.*got 'vgg'.*weights list"):
        find_weights("vgg")
    with pytest.raises(BackendUnavailableError, match="which is none; correct the path"):
        find_weights(tmp_path / "absent.pt")
    with pytest.raises(BackendUnavailableError, match="got 'vgg'; choose one"):
        fetch_weights("vgg")


def test_the_licence_comes_first_and_is_asked_for_once(folder, address):
    asked = address()
    with pytest.raises(BackendUnavailableError, match=r"Apache-2\.0, https://.*fetch bootstapir --accept-licence"):
        fetch_weights("bootstapir")
    assert asked == []
    assert files(folder) == set()
    assert not is_licence_accepted("bootstapir")

    file = fetch_weights("bootstapir", accept_licence=True)
    assert file.read_bytes() == CONTENT
    assert asked == [CHECKPOINTS["bootstapir"].page]
    assert is_licence_accepted("bootstapir")
    assert not is_licence_accepted("bootstapir-causal")
    assert tomllib.loads((folder / "licences.toml").read_text())["bootstapir"]["licence"] == "Apache-2.0"

    file.unlink()
    assert fetch_weights("bootstapir") == file
    assert find_weights("bootstapir") == file
    assert len(asked) == 2
    fetch_weights("bootstapir")
    assert len(asked) == 2
    assert files(folder) == {"bootstapir.pt", "licences.toml"}


def test_a_changed_licence_is_asked_for_again(monkeypatch, address):
    address()
    fetch_weights("bootstapir", accept_licence=True).unlink()
    changed = replace(CHECKPOINTS["bootstapir"], licence="Another-1.0")
    monkeypatch.setitem(checkpoints.CHECKPOINTS, "bootstapir", changed)
    with pytest.raises(BackendUnavailableError, match=r"Another-1\.0"):
        fetch_weights("bootstapir")


def test_progress_counts_up_to_the_whole_file(address, monkeypatch):
    address()
    monkeypatch.setattr(download, "_BLOCK_BYTES", 4000)
    seen = []
    fetch_weights("tapir-panning", accept_licence=True, progress=lambda *step: seen.append(step))
    assert seen == [("tapir-panning", done, len(CONTENT)) for done in (4000, 8000, len(CONTENT))]


def test_a_download_that_fails_leaves_nothing(folder, address):
    not_found = urllib.error.HTTPError("https://x", 404, "Not Found", Message(), None)
    cases = [
        ({"content": CONTENT[:-1]}, f"expected {len(CONTENT)} bytes, got {len(CONTENT) - 1}; .*cut short"),
        ({"content": CONTENT[:999], "length": 999}, "expected about 10240 bytes, got 999; fetch it again"),
        ({"content": CONTENT[:999], "length": None}, "expected about 10240 bytes, got 999"),
        ({"error": urllib.error.URLError("no route to host")}, "got: .*no route to host.*check the network"),
        ({"error": TimeoutError("timed out")}, "timed out; check the network"),
        ({"error": ConnectionResetError()}, "ConnectionResetError; check the network"),
        ({"error": not_found}, "404: Not Found"),
    ]
    for answer, message in cases:
        address(**answer)
        with pytest.raises(BackendUnavailableError, match=message) as error:
            fetch_weights("bootstapir", accept_licence=True)
        assert "\n" not in str(error.value)
        assert files(folder) == {"licences.toml"}


def test_a_full_disk_is_noticed_before_the_download(address, monkeypatch):
    asked = address()
    usage = shutil.disk_usage("/")._replace(free=len(CONTENT) - 1)
    monkeypatch.setattr(weights.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(BackendUnavailableError, match=r"expected 0 MB free in .*, got 0\.00 GB; make room"):
        fetch_weights("bootstapir", accept_licence=True)
    assert asked == []


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch, address):
    address()
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("VFM_SDM_WEIGHTS", str(tmp_path / "file" / "weights"))
    with pytest.raises(BackendUnavailableError, match=r"expected to write .*; set VFM_SDM_WEIGHTS to a folder"):
        fetch_weights("bootstapir", accept_licence=True)


def test_a_disk_that_fails_while_writing_is_no_network_error(address, monkeypatch):
    address(error=OSError(28, "No space left on device"))
    with pytest.raises(BackendUnavailableError, match=r"expected to write to .*No space left"):
        fetch_weights("bootstapir", accept_licence=True)


def test_a_damaged_record_is_named(folder):
    folder.mkdir()
    (folder / "licences.toml").write_text("= not TOML")
    with pytest.raises(BackendUnavailableError, match=r"expected TOML in .*licences\.toml.*delete this file"):
        is_licence_accepted("bootstapir")


# -- Hugging Face: the real client against a server on this machine --


class Hub(BaseHTTPRequestHandler):
    """Answers as Hugging Face does to the client's requests for one file."""

    refusal: tuple[int, str] | None = None
    tokens: list[str | None]

    def do_HEAD(self):
        self.answer(b"")

    def do_GET(self):
        self.answer(CONTENT)

    def answer(self, body: bytes) -> None:
        self.tokens.append(self.headers.get("Authorization"))
        if self.refusal is not None:
            self.send_response(self.refusal[0])
            self.send_header("X-Error-Code", self.refusal[1])
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.send_response(200)
        self.send_header("ETag", f'"{hashlib.sha256(CONTENT).hexdigest()}"')
        self.send_header("X-Repo-Commit", "0" * 40)
        self.send_header("Content-Length", str(len(CONTENT)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def hub(monkeypatch):
    """A stand-in of Hugging Face; its attributes say how it answers."""
    huggingface_hub = pytest.importorskip("huggingface_hub")
    handler = type("OneHub", (Hub,), {"tokens": []})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    url = f"http://127.0.0.1:{server.server_port}"
    real = huggingface_hub.hf_hub_download
    monkeypatch.setattr(huggingface_hub, "hf_hub_download", lambda *a, **k: real(*a, endpoint=url, **k))
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy", "HF_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    yield handler
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_checkpoint_comes_from_hugging_face(folder, hub):
    seen = []
    file = fetch_weights("vggt-1b", accept_licence=True, progress=lambda *step: seen.append(step))
    assert file == local_weights("vggt-1b") == folder / "vggt-1b.safetensors"
    assert file.read_bytes() == CONTENT
    assert not file.is_symlink()
    assert files(folder) == {"vggt-1b.safetensors", "licences.toml"}
    assert seen[-1] == ("vggt-1b", len(CONTENT), len(CONTENT))


def test_a_checkpoint_that_only_a_person_can_fetch_says_where_and_under_which_name(folder):
    with pytest.raises(BackendUnavailableError) as error:
        fetch_weights("posediffusion-co3d", accept_licence=True)
    said = str(error.value)
    assert "follow the link on https://github.com/facebookresearch/PoseDiffusion (CC-BY-NC-4.0)" in said
    assert str(folder / "posediffusion-co3d.pth") in said
    assert "\n" not in said
    assert files(folder) == set()


def test_the_token_is_passed_on(hub):
    fetch_weights("vggt-1b-commercial", accept_licence=True, token="hf_mine")
    assert set(hub.tokens) == {"Bearer hf_mine"}


def test_a_gated_checkpoint_says_what_to_do(folder, hub):
    hub.refusal = (403, "GatedRepo")
    with pytest.raises(BackendUnavailableError, match=r"accept the terms .*`hf auth login` or set HF_TOKEN") as error:
        fetch_weights("vggt-1b-commercial", accept_licence=True)
    assert "https://huggingface.co/facebook/VGGT-1B-Commercial" in str(error.value)
    assert "\n" not in str(error.value)
    assert files(folder) == {"licences.toml"}


def test_a_file_that_was_renamed_there_says_so(folder, hub):
    hub.refusal = (404, "EntryNotFound")
    with pytest.raises(BackendUnavailableError, match=r"expected model\.safetensors in .*download .* by hand"):
        fetch_weights("vggt-1b", accept_licence=True)
    assert files(folder) == {"licences.toml"}


def test_a_server_that_fails_or_is_not_there_is_one_line(folder, hub, monkeypatch):
    hub.refusal = (400, "BadRequest")
    with pytest.raises(BackendUnavailableError, match="check the network, or download the file elsewhere") as error:
        fetch_weights("vggt-1b", accept_licence=True)
    assert "\n" not in str(error.value)
    hub.refusal = None
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    with pytest.raises(BackendUnavailableError, match="check the network, or download the file elsewhere") as error:
        fetch_weights("vggt-1b", accept_licence=True)
    assert "\n" not in str(error.value)
    assert files(folder) == {"licences.toml"}


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            OSError("Consistency check failed: file should be of size 5\nbut has size 4"),
            "of size 5 but.*check the network",
        ),
        (OSError(28, "No space left on device"), "expected to write to .*No space left"),
    ],
)
def test_a_broken_transfer_and_a_full_disk_differ(folder, monkeypatch, error, message):
    def fail(*_, local_dir, **__):
        (Path(local_dir) / "half").write_bytes(b"half")
        raise error

    monkeypatch.setattr(pytest.importorskip("huggingface_hub"), "hf_hub_download", fail)
    with pytest.raises(BackendUnavailableError, match=message) as caught:
        fetch_weights("vggt-1b", accept_licence=True)
    assert "\n" not in str(caught.value)
    assert files(folder) == {"licences.toml"}


def test_another_file_under_the_name_is_refused(folder, hub, monkeypatch):
    bigger = replace(CHECKPOINTS["vggt-1b"], size_bytes=2 * len(CONTENT))
    monkeypatch.setitem(checkpoints.CHECKPOINTS, "vggt-1b", bigger)
    with pytest.raises(BackendUnavailableError, match="now holds another file"):
        fetch_weights("vggt-1b", accept_licence=True)
    assert files(folder) == {"licences.toml"}


def test_without_the_client_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(download, "find_spec", lambda _: None)
    with pytest.raises(BackendUnavailableError, match=r"huggingface_hub, got none; pip install 'vfm-sdm\[vfm\]'"):
        fetch_weights("vggt-1b", accept_licence=True)


# -- identity --


def test_the_id_is_the_content_and_its_hash_is_remembered(folder, tmp_path, monkeypatch):
    file = tmp_path / "mine.pt"
    file.write_bytes(CONTENT)
    expected = f"mine-{hashlib.sha256(CONTENT).hexdigest()[:12]}"
    assert weights_id(file) == expected

    calls = []
    real = weights.file_hash
    monkeypatch.setattr(weights, "file_hash", lambda path: calls.append(path) or real(path))
    assert weights_id(str(file)) == expected
    assert calls == []
    file.write_bytes(CONTENT + b"!")
    assert re.fullmatch(r"mine-[0-9a-f]{12}", weights_id(file))
    assert weights_id(file) != expected
    assert len(calls) == 1
    assert files(folder) == {"hashes.toml"}


def test_the_id_needs_no_writable_folder_but_a_file(tmp_path, monkeypatch):
    file = tmp_path / "mine.pt"
    file.write_bytes(CONTENT)
    monkeypatch.setenv("VFM_SDM_WEIGHTS", str(file / "weights"))
    assert weights_id(file).startswith("mine-")
    with pytest.raises(BackendUnavailableError, match="expected a file that can be read"):
        weights_id(tmp_path / "absent.pt")
