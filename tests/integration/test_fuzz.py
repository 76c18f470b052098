"""Spoiled inputs of every kind: one message and no traceback, no hang, and no half result."""

import contextlib
import io
import shutil
import signal
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from compressed import film
from mutations import spoil_file, spoil_json, spoil_lines, spoil_toml
from scenes import write_scene
from sensor_files import HEADER, put, rows, swinging
from vfm_sdm.commands.app import main
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.core.run_folder import RunFolder
from vfm_sdm.errors import VfmSdmError
from vfm_sdm.inputs.session import Session, read_session, write_session
from vfm_sdm.networks.loading import load_weights

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

ROUNDS = 10
"""Tests of each kind, so that they share the processors."""
LIMIT_S = 120


class Hang(BaseException):
    """A command took longer than any of this size may."""


@contextlib.contextmanager
def alarm(seconds: int) -> Iterator[None]:
    def ring(number: int, frame: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def run(*words: object) -> str:
    """Runs a command; what is wrong with how it ended, empty where nothing is."""
    said = io.StringIO()
    try:
        with alarm(LIMIT_S), contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            main([str(word) for word in words])
    except SystemExit as ended:
        return "" if ended.code in (0, 1, 3, None) else f"exit {ended.code}: {said.getvalue()[-500:]}"
    except Hang:
        return f"a hang of {LIMIT_S} s"
    except BaseException:  # noqa: BLE001  (the fault that is looked for)
        return traceback.format_exc()
    return ""


def half(folder: Path) -> str:
    """What in a run folder is neither whole nor refused by name."""
    orphans = [path.name for path in folder.rglob(".*")]
    if orphans:
        return f"orphans {orphans}"
    if (folder / "displacement.nc").is_file():
        try:
            RunFolder(folder).check_whole("displacement", read_displacement(folder).attrs)
        except VfmSdmError:
            return ""
        except Exception:  # noqa: BLE001  (the fault that is looked for)
            return traceback.format_exc()
    return ""


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """Folder of a small session and its finished run."""
    folder = tmp_path_factory.mktemp("fuzz")
    session = write_scene(folder / "scene", injection=False)
    assert run("measure", session, "-o", folder / "run") == ""
    time_s, acceleration = swinging(duration_s=4.0)
    put(folder, [HEADER, *rows(time_s, acceleration)])
    (folder / "lengths.csv").write_text("point_a,point_b,length_m\na,b,0.75\na,c,1.35\n")
    write_films(folder)
    return folder


def write_films(folder: Path) -> None:
    """The scene's pictures as videos, and their session."""
    (folder / "films").mkdir()
    for view in ("left", "right"):
        pictures = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in sorted((folder / "scene" / view).iterdir())]
        film(folder / "films" / f"{view}.mp4", np.stack(pictures), np.zeros((len(pictures), 2)))
    shutil.copy(folder / "scene" / "rig.toml", folder / "films")
    session = read_session(folder / "scene" / "session.toml")
    views = [
        view.model_copy(update={"images": None, "fps": None, "video": Path(f"{view.name}.mp4")})
        for view in session.view
    ]
    write_session(
        folder / "films" / "session.toml", Session(**{**dict(session), "view": views, "folder": folder / "films"})
    )


def fresh(scene: Path, folder: Path, *names: str) -> Path:
    """The named parts of the scene, to spoil."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name in names:
        (shutil.copytree if (scene / name).is_dir() else shutil.copy)(scene / name, folder / name)
    return folder


def try_all(count: int, seed: int, attempt: Callable[[np.random.Generator], str]) -> None:
    found = {}
    for number in range(count):
        wrong = attempt(np.random.default_rng([seed, number]))
        if wrong:
            found[number] = wrong
    lines = [f"--- {number}\n{wrong[-1500:]}" for number, wrong in found.items()]
    assert not found, f"{len(found)} of {count} (seed {seed})\n" + "\n".join(lines)


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_sessions(scene, tmp_path, seed):
    def attempt(rng):
        folder = fresh(scene, tmp_path / "one", "scene", "run")
        spoil_toml(folder / "scene" / "session.toml", rng)
        return run("displacement", folder / "scene" / "session.toml", "-o", folder / "run") or half(folder / "run")

    try_all(15, seed, attempt)


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_camera_files(scene, tmp_path, seed):
    def attempt(rng):
        folder = fresh(scene, tmp_path / "one", "scene", "run")
        spoil_toml(folder / "scene" / "rig.toml", rng)
        return run("displacement", folder / "scene" / "session.toml", "-o", folder / "run") or half(folder / "run")

    try_all(10, seed, attempt)


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_sensor_files(scene, tmp_path, seed):
    def attempt(rng):
        folder = fresh(scene, tmp_path / "one", "acc.csv")
        for _ in range(int(rng.integers(1, 3))):
            if (folder / "acc.csv").is_file():
                spoil = spoil_lines if rng.random() < 0.8 else spoil_file
                with contextlib.suppress(UnicodeDecodeError, IndexError, ValueError):  # spoilt beyond lines
                    spoil(folder / "acc.csv", rng)
        units = [(), ("--units", "mm"), ("--units", "m/s2"), ("--rate", "200")][int(rng.integers(4))]
        return run("reference", folder / "acc.csv", "-o", folder / "reference.nc", *units)

    try_all(10, seed, attempt)


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_images(scene, tmp_path, seed):
    def spoil_image(path, rng):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:  # spoiled before
            return
        changed = {
            0: image[: image.shape[0] // 2],
            1: image.astype(np.uint16) * 257,
            2: np.dstack([image] * 4),
            3: np.zeros_like(image),
            4: image[:1, :1],
        }.get(int(rng.integers(8)))
        if changed is None:
            spoil_file(path, rng)
        else:
            cv2.imwrite(str(path), changed)

    def attempt(rng):
        folder = fresh(scene, tmp_path / "one", "scene", "run")
        if rng.random() < 0.5:
            shutil.rmtree(folder / "run")
        for _ in range(int(rng.integers(1, 4))):
            pictures = [
                p for p in sorted((folder / "scene" / str(rng.choice(["left", "right"]))).iterdir()) if p.is_file()
            ]
            spoil_image(pictures[int(rng.integers(len(pictures)))], rng)
        return run("displacement", folder / "scene" / "session.toml", "-o", folder / "run") or half(folder / "run")

    try_all(8, seed, attempt)


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_videos(scene, tmp_path, seed):
    def attempt(rng):
        folder = fresh(scene, tmp_path / "one", "films")
        spoil_file(folder / "films" / str(rng.choice(["left.mp4", "right.mp4"])), rng)
        return run("displacement", folder / "films" / "session.toml", "-o", folder / "run") or half(folder / "run")

    try_all(5, seed, attempt)


def spoil_weights(path: Path, state: dict, rng: np.random.Generator, trap: Path) -> bool:
    """A file of weights with other keys, shapes, types or values, with code in it, or damaged; whether it is useless.

    Of a damaged file nobody knows: a byte of a weight may be another.
    """
    torch = pytest.importorskip("torch")
    save = pytest.importorskip("safetensors.torch").save_file if path.suffix == ".safetensors" else torch.save
    key = sorted(state)[int(rng.integers(len(state)))]
    kind = int(rng.integers(9))
    state = {name: value.clone() for name, value in state.items()}
    if kind == 0:
        del state[key]
    elif kind == 1:
        state[f"module.{key}"] = state.pop(key)
    elif kind == 2:
        state[key] = torch.zeros((*state[key].shape, 2))
    elif kind == 3:
        state = {name: value * float(rng.choice([np.nan, np.inf])) for name, value in state.items()}
    elif kind == 4:
        state["further"] = torch.ones(3)
    save(state, path)
    if kind == 5 and path.suffix != ".safetensors":

        class Trap:
            def __reduce__(self) -> tuple:
                return (open, (str(trap), "w"))

        torch.save({**state, key: Trap()}, path)
    elif kind >= 5:
        spoil_file(path, rng)
        return False
    return True


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_weights(tmp_path, seed):
    torch = pytest.importorskip("torch")
    trap = tmp_path / "sprung"

    def network():
        return torch.nn.Sequential(torch.nn.Linear(4, 3), torch.nn.BatchNorm1d(3))

    def attempt(rng):
        folder = tmp_path / "one"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        path = folder / f"mine{rng.choice(['.safetensors', '.pt', '.pth'])}"
        useless = spoil_weights(path, network().state_dict(), rng, trap)
        try:
            with alarm(LIMIT_S):
                load_weights(network(), path)
        except VfmSdmError as error:
            return "" if "; " in str(error) and "\n" not in str(error) else f"no advice: {error}"
        except Hang:
            return f"a hang of {LIMIT_S} s"
        except Exception:  # noqa: BLE001  (the fault that is looked for)
            return traceback.format_exc()
        return f"taken: {path}" if useless else ""

    try_all(30, seed, attempt)
    assert not trap.exists()


READERS = (
    ("displacement", "scene/session.toml", "-o", "run"),
    ("evaluate", "run", "whole/displacement.nc", "--axis", "right"),
    ("verify", "run"),
    ("accept", "budget", "run", "--monte-carlo", "10000"),
    ("accept", "noise-floor", "run"),
    ("accept", "lengths", "run", "lengths.csv"),
)


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_run_folders(scene, tmp_path, seed):
    def attempt(rng):
        folder = fresh(scene, tmp_path / "one", "scene", "run", "lengths.csv")
        shutil.copytree(scene / "run", folder / "whole")
        for _ in range(int(rng.integers(1, 3))):
            files = [p for p in sorted((folder / "run").iterdir()) if p.is_file()]
            chosen = files[int(rng.integers(len(files)))]
            own = {".toml": spoil_toml, ".json": spoil_json}.get(chosen.suffix)
            try:
                (own if own is not None and rng.random() < 0.7 else spoil_file)(chosen, rng)
            except ValueError:  # spoiled before, beyond its form
                spoil_file(chosen, rng)
        words = READERS[int(rng.integers(len(READERS)))]
        placed = [folder / word if (folder / word).exists() else word for word in words]
        return run(*placed) or (half(folder / "run") if words[0] == "displacement" else "")

    try_all(15, seed, attempt)
