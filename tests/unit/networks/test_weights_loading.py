"""Weights into modules: every key, every shape, and one line where they differ."""

import pickle
import subprocess
import sys

import pytest

from vfm_sdm.errors import BackendUnavailableError
from vfm_sdm.networks import loading
from vfm_sdm.networks.loading import load_weights, read_state

torch = pytest.importorskip("torch")
safetensors_torch = pytest.importorskip("safetensors.torch")


class Net(torch.nn.Module):
    """A body with a buffer and an integer counter, and a head that need not be built."""

    def __init__(self, *, head: bool = True):
        super().__init__()
        self.body = torch.nn.Linear(4, 3)
        self.norm = torch.nn.BatchNorm1d(3)
        if head:
            self.head = torch.nn.Linear(3, 2)


def state(seed: int = 3, *, head: bool = True) -> dict:
    generator = torch.Generator().manual_seed(seed)
    return {
        key: torch.randn(value.shape, generator=generator).to(value.dtype) + 7
        for key, value in Net(head=head).state_dict().items()
    }


@pytest.fixture(params=["mine.safetensors", "mine.pt", "mine.pth"])
def file(request, tmp_path):
    path = tmp_path / request.param
    if path.suffix == ".safetensors":
        safetensors_torch.save_file(state(), path)
    else:
        torch.save(state(), path)
    return path


def assert_equal(found, expected):
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        torch.testing.assert_close(found[key], value, rtol=0, atol=0)


def test_every_tensor_comes_back(file):
    assert_equal(read_state(file), state())
    assert_equal(read_state(str(file)), state())


def test_floats_are_converted_and_counters_are_not(file):
    found = read_state(file, dtype=torch.bfloat16)
    assert found["body.weight"].dtype == torch.bfloat16
    assert found["norm.num_batches_tracked"].dtype == torch.int64
    assert_equal(found, {k: v.bfloat16() if v.is_floating_point() else v for k, v in state().items()})


@pytest.mark.parametrize("nest", [["model"], ["state_dict"], ["model_state_dict"], ["state_dict", "model"]])
def test_the_usual_nesting_is_taken_off(tmp_path, nest):
    stored = state()
    for name in nest:
        stored = {name: stored, "epoch": 20}
    torch.save(stored, tmp_path / "nested.pt")
    assert_equal(read_state(tmp_path / "nested.pt"), state())


@pytest.mark.parametrize("device", ["meta", "cpu"])
def test_a_module_takes_the_weights(file, device):
    with torch.device(device):
        net = Net()
    load_weights(net, file)
    assert_equal(net.state_dict(), state())
    assert all(parameter.requires_grad for parameter in net.parameters())
    torch.testing.assert_close(net.body(torch.ones(4)), state()["body.weight"].sum(1) + state()["body.bias"])


def test_a_module_takes_tensors_and_another_precision():
    with torch.device("meta"):
        net = Net()
    load_weights(net, state(), dtype=torch.float64)
    assert net.body.weight.dtype == torch.float64
    assert net.norm.num_batches_tracked.dtype == torch.int64


def test_heads_that_are_not_built_are_not_read(file, monkeypatch):
    read = []
    real = loading._convert_type
    monkeypatch.setattr(
        loading, "_convert_type", lambda tensor, dtype: read.append(tuple(tensor.shape)) or real(tensor, dtype)
    )
    net = Net(head=False)
    load_weights(net, file, optional_prefixes=("head.",))
    assert len(read) == len(net.state_dict())
    assert (2, 3) not in read
    assert_equal(net.state_dict(), {k: v for k, v in state().items() if not k.startswith("head.")})


def test_a_head_that_is_built_must_be_there_although_optional():
    with pytest.raises(BackendUnavailableError, match=r"2 missing \(head\.weight 2x3, head\.bias 2\)"):
        load_weights(Net(), state(head=False), optional_prefixes=("head.",))


def test_a_head_that_is_built_is_loaded_although_optional(file):
    net = Net()
    load_weights(net, file, optional_prefixes=("head.",))
    assert_equal(net.state_dict(), state())


def test_differences_are_counted_and_named(file):
    net = Net(head=False)
    net.body = torch.nn.Linear(5, 3)
    net.more = torch.nn.ModuleList(torch.nn.Linear(2, 2, bias=False) for _ in range(7))
    before = {key: value.clone() for key, value in net.state_dict().items()}
    with pytest.raises(BackendUnavailableError) as error:
        load_weights(net, file)
    text = str(error.value)
    assert "\n" not in text
    assert f"weights {file.name}: expected the 14 tensors of Net" in text
    assert (
        "7 missing (more.0.weight 2x2, more.1.weight 2x2, more.2.weight 2x2, more.3.weight 2x2, more.4.weight" in text
    )
    assert "more.5" not in text
    assert "2 unexpected (" in text
    assert "head.bias 2" in text
    assert "1 of another shape (body.weight 3x4 instead of 3x5)" in text
    assert "weights list" in text
    assert_equal(net.state_dict(), before)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("dtype", [None, torch.float16])
def test_values_that_are_no_numbers_are_named(value, dtype):
    wrong = {key: tensor.clone() for key, tensor in state().items()}
    wrong["body.weight"][1, 2] = value
    net = Net()
    before = {key: tensor.clone() for key, tensor in net.state_dict().items()}
    with pytest.raises(BackendUnavailableError, match=r"none in 1 tensors \(body\.weight\); the file is damaged"):
        load_weights(net, wrong, dtype=dtype)
    assert_equal(net.state_dict(), before)


def test_a_scalar_has_a_name_for_its_shape():
    wrong = {**state(), "norm.num_batches_tracked": torch.zeros(1)}
    with pytest.raises(BackendUnavailableError, match=r"num_batches_tracked 1 instead of scalar"):
        load_weights(Net(), wrong)


def test_truncated_and_foreign_files_are_one_line(file):
    whole = file.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:-20], b"", b"<html>not found</html>" * 50, pickle.dumps(state)):
        file.write_bytes(content)
        with pytest.raises(BackendUnavailableError, match="truncated or foreign, fetch it again") as error:
            read_state(file)
        assert "\n" not in str(error.value)
        assert str(file) in str(error.value)


def test_nothing_in_a_file_is_executed(tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    torch.save({"a": torch.zeros(2), "trap": Trap()}, tmp_path / "trap.pt")
    with pytest.raises(BackendUnavailableError, match="holds tensors only, got Weights only load failed"):
        read_state(tmp_path / "trap.pt")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("stored", [{"a": torch.zeros(2), "epoch": 3}, [torch.zeros(2)], {}, torch.zeros(2)])
def test_files_with_other_content_are_refused(tmp_path, stored):
    torch.save(stored, tmp_path / "other.pt")
    with pytest.raises(BackendUnavailableError, match=r"expected tensors by key, got .* with other content"):
        read_state(tmp_path / "other.pt")


def test_without_safetensors_the_extra_is_named(tmp_path, monkeypatch):
    path = tmp_path / "mine.safetensors"
    safetensors_torch.save_file(state(), path)
    monkeypatch.setattr(loading, "find_spec", lambda _: None)
    with pytest.raises(BackendUnavailableError, match=r"safetensors, got none; pip install 'vfm-sdm\[vfm\]'"):
        read_state(path)


def test_a_large_file_is_not_held_twice(tmp_path):
    """Of 216 MB in each file, 36 MB are for the module: peak memory rises by far less than one file's size."""
    code = """
import resource, sys, torch
from vfm_sdm.networks.loading import load_weights
import safetensors
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sys.argv[1:]:
    with torch.device("meta"):
        net = torch.nn.ModuleDict({"body": torch.nn.Linear(3000, 3000, bias=False)})
    load_weights(net, path, optional_prefixes=("head.",))
    assert float(net["body"].weight.detach().sum()) == 9e6
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""
    large = {"body.weight": torch.ones(3000, 3000)} | {f"head.{n}": torch.ones(3000, 3000) for n in range(5)}
    paths = [tmp_path / "large.safetensors", tmp_path / "large.pt"]
    safetensors_torch.save_file(large, paths[0])
    torch.save(large, paths[1])
    command = [sys.executable, "-c", code, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(done.stdout) < 150
