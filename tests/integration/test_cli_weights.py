"""`vfm-sdm weights` as a user would type it."""

import io
import re
from dataclasses import replace

import pytest

from vfm_sdm.commands.terminal import ERR
from vfm_sdm.networks import checkpoints, download
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import local_weights

CONTENT = b"weights" * 2_000_000


@pytest.fixture(autouse=True)
def empty_folder(monkeypatch, tmp_path):
    """Of weights."""
    monkeypatch.setenv("VFM_SDM_WEIGHTS", str(tmp_path / "weights"))


@pytest.fixture
def server(monkeypatch):
    """The address of `bootstapir` answers with a small file."""

    class Response(io.BytesIO):
        headers = {"Content-Length": str(len(CONTENT))}  # noqa: RUF012

    small = replace(CHECKPOINTS["bootstapir"], size_bytes=len(CONTENT))
    monkeypatch.setitem(checkpoints.CHECKPOINTS, "bootstapir", small)
    monkeypatch.setattr(download.urllib.request, "urlopen", lambda *_, **__: Response(CONTENT))


@pytest.fixture
def terminal(monkeypatch, command):
    """A person at a terminal who gives this answer; the list holds the questions."""

    def sit(answer: str) -> list[str]:
        asked = []

        class Terminal(io.StringIO):
            def isatty(self):
                return True

        monkeypatch.setattr("sys.stdin", Terminal())
        monkeypatch.setattr(ERR, "input", lambda prompt, **_: asked.append(str(prompt)) or answer)
        return asked

    return sit


def test_list_shows_size_licence_and_place(command, server, tmp_path):
    status, out, _ = command("weights", "list")
    assert status == 0
    for name, one in CHECKPOINTS.items():
        row = next(line for line in out.splitlines() if line.split()[:1] == [name])
        for expected in (one.network, one.size, one.licence, " no"):
            assert expected in row
    for gate in (r"vggt-1b-commercial .* VGGT License v1 +no \(gated\)", r"posediffusion-co3d .* no \(by hand\)"):
        assert re.search(gate, out), gate
    assert "vfm-sdm weights fetch NAME" in out
    assert out.splitlines()[0] == f"weights in {tmp_path / 'weights'}"

    assert command("weights", "fetch", "bootstapir", "--accept-licence")[0] == 0
    _, out, _ = command("weights", "list")
    row = next(line for line in out.splitlines() if line.split()[:1] == ["bootstapir"])
    assert row.split()[-1] == "yes"


def test_fetch_with_the_flag(command, server, tmp_path):
    status, out, _ = command("weights", "fetch", "bootstapir", "--accept-licence")
    assert status == 0
    file = tmp_path / "weights" / "bootstapir.pt"
    assert out.strip() == f"here: {file}"
    assert file.read_bytes() == CONTENT


def test_fetch_without_a_terminal_needs_the_flag(command, server, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    status, out, err = command("weights", "fetch", "bootstapir")
    assert status == 1
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert err.strip().endswith("run `vfm-sdm weights fetch bootstapir --accept-licence`")


def test_fetch_asks_once_at_a_terminal(command, server, terminal):
    asked = terminal("y")
    status, _, err = command("weights", "fetch", "bootstapir")
    assert status == 0
    assert len(asked) == 1
    assert "Apache-2.0" in err
    local_weights("bootstapir").unlink()
    assert command("weights", "fetch", "bootstapir")[0] == 0
    assert command("weights", "fetch", "bootstapir")[0] == 0
    assert len(asked) == 1


def test_a_refused_licence_fetches_nothing(command, server, terminal):
    terminal("n")
    status, _, err = command("weights", "fetch", "bootstapir")
    assert status == 1
    assert "--accept-licence" in err
    assert not local_weights("bootstapir").exists()


def test_an_unknown_name_is_one_line(command, terminal):
    terminal("y")
    status, _, err = command("weights", "fetch", "vgg")
    assert status == 1
    assert "expected one of" in err
    assert len(err.strip().splitlines()) == 1


def test_info_names_back_ends_and_weights(command):
    status, out, _ = command("info")
    assert status == 0
    assert "icgn: can run" in out
    assert "PyTorch" in out
    for name in CHECKPOINTS:
        assert f"weights {name}: not here; vfm-sdm weights fetch {name}" in out
