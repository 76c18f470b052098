"""Which back ends can run, and what is said where they cannot."""

import subprocess
import sys

import pytest

from vfm_sdm.core.parts import BUILT_IN, KINDS
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks import availability
from vfm_sdm.networks.availability import (
    choose_weights,
    default_checkpoint,
    require_torch,
    why_unavailable,
)
from vfm_sdm.networks.checkpoints import CHECKPOINTS
from vfm_sdm.networks.weights import local_weights


@pytest.fixture(autouse=True)
def empty(tmp_path, monkeypatch):
    """No weights here, and a switch for the packages."""
    monkeypatch.setenv("VFM_SDM_WEIGHTS", str(tmp_path))

    def packages(*names):
        monkeypatch.setattr(availability, "find_spec", lambda name: name if name in names else None)

    packages("torch", "safetensors", "pycolmap")
    return packages


def test_the_needs_name_registered_checkpoints():
    parts = [part for kind in BUILT_IN.values() for part in kind.values() if part.needs is not None]
    assert len(parts) >= 5
    for needs in (part.needs for part in parts):
        assert needs.packages
        assert set(needs.checkpoints) <= set(CHECKPOINTS)


def test_classical_back_ends_need_nothing(empty):
    empty()
    assert why_unavailable("trackers", "icgn") is None
    assert why_unavailable("cameras", "two-view") is None


def test_packages_come_first_then_weights(empty):
    empty()
    assert why_unavailable("trackers", "vggt") == "expected PyTorch, got none; pip install 'vfm-sdm[vfm]'"
    assert why_unavailable("cameras", "sfm") == "expected pycolmap, got none; pip install 'vfm-sdm[sfm]'"
    empty("torch")
    assert why_unavailable("cameras", "vggt") == "expected safetensors, got none; pip install 'vfm-sdm[vfm]'"
    empty("torch", "safetensors", "pycolmap")
    assert why_unavailable("cameras", "sfm") is None
    reason = why_unavailable("trackers", "vggt")
    assert reason.startswith("expected weights (vggt-1b or vggt-1b-commercial) in ")
    assert reason.endswith("got none; run `vfm-sdm weights fetch vggt-1b`")


def test_any_of_the_checkpoints_will_do():
    assert default_checkpoint("trackers", "vggt") == "vggt-1b"
    local_weights("vggt-1b-commercial").write_bytes(b"x")
    assert why_unavailable("trackers", "vggt") is None
    assert default_checkpoint("trackers", "vggt") == "vggt-1b-commercial"
    local_weights("vggt-1b").write_bytes(b"x")
    assert default_checkpoint("trackers", "vggt") == "vggt-1b"


def test_of_a_combination_every_part_has_to_run():
    assert "weights fetch bootstapir" in why_unavailable("trackers", "tapir+icgn")
    local_weights("bootstapir").write_bytes(b"x")
    assert why_unavailable("trackers", "tapir+icgn") is None
    assert default_checkpoint("trackers", "tapir+icgn") == "bootstapir"


def test_weights_of_a_session_are_those_of_every_network_that_knows_them(tmp_path):
    local_weights("vggt-1b").write_bytes(b"x")
    local_weights("bootstapir-causal").write_bytes(b"x")
    assert choose_weights("trackers", "tapir", "bootstapir-causal") == local_weights("bootstapir-causal")
    assert choose_weights("cameras", "vggt", "bootstapir-causal") == local_weights("vggt-1b")
    own = tmp_path / "own.pt"
    own.write_bytes(b"x")
    assert choose_weights("trackers", "vggt", str(own)) == own
    with pytest.raises(BackendUnavailableError, match="vfm-sdm weights fetch bootstapir`"):
        choose_weights("trackers", "tapir", None)


def test_acknowledged_weights_are_fetched_on_first_use(monkeypatch, tmp_path):
    fetched = []

    def fetch(name):
        fetched.append(name)
        return tmp_path / "fetched.safetensors"

    monkeypatch.setattr(availability, "fetch_weights", fetch)
    with pytest.raises(BackendUnavailableError, match="vfm-sdm weights fetch vggt-1b`"):
        choose_weights("trackers", "vggt", None)
    monkeypatch.setattr(availability, "is_licence_accepted", lambda name: name == "vggt-1b")
    assert choose_weights("trackers", "vggt", None) == tmp_path / "fetched.safetensors"
    assert fetched == ["vggt-1b"]
    # A file of that name is the user's, whatever it is.
    local_weights("vggt-1b").write_bytes(b"mine")
    assert choose_weights("trackers", "vggt", None) == local_weights("vggt-1b")
    assert fetched == ["vggt-1b"]


def test_a_back_end_without_weights_has_no_checkpoint():
    for kind, name in (("trackers", "icgn"), ("cameras", "sfm")):
        with pytest.raises(
            BackendUnavailableError, match=f"{KINDS[kind].word}: expected a back end with weights, got '{name}'"
        ):
            default_checkpoint(kind, name)


def test_without_torch_one_line_says_what_to_install(empty):
    require_torch("tracker vggt")
    empty()
    with pytest.raises(
        BackendUnavailableError, match=r"^tracker vggt: expected PyTorch, got none; pip install 'vfm-sdm\[vfm\]'$"
    ):
        require_torch("tracker vggt")


def test_without_the_packages_the_commands_import_and_list(tmp_path):
    code = """
import importlib.util, sys
hidden = ("torch", "safetensors", "huggingface_hub", "transformers", "pycolmap")
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in hidden:
            raise ModuleNotFoundError(name)
real = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name in hidden else real(name, package)
sys.meta_path.insert(0, Hide())
import pytest
from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks import availability, checkpoints, download, loading, weights
import vfm_sdm.commands.app
from vfm_sdm.commands.environment import describe_environment
from vfm_sdm.commands.weights import weights_table
assert weights_table().row_count == len(checkpoints.CHECKPOINTS)
lines = describe_environment()["vision foundation models"]
assert "not installed; pip install 'vfm-sdm[vfm]'" in lines[0], lines
assert any("weights vggt-1b: not here" in line for line in lines), lines
with pytest.raises(BackendUnavailableError, match="weights mine.pt: expected PyTorch, got none"):
    loading.read_state(sys.argv[1])
"""
    (tmp_path / "mine.pt").write_bytes(b"x")
    command = [sys.executable, "-c", code, str(tmp_path / "mine.pt")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
