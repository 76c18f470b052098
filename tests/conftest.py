"""What all tests share."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]


def _shared_folder() -> Path:
    return Path(os.environ.get("VFM_SDM_SHARED", _ROOT.parent / "shared"))


@pytest.fixture(scope="session", autouse=True)
def no_weights_of_this_machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests see no fetched weights: what they show must not depend on who runs them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VFM_SDM_WEIGHTS", str(tmp_path_factory.mktemp("no_weights")))
        yield


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Folder of a real data set by name; the test skips where the data are not at hand."""

    def find(name: str) -> Path:
        folder = _shared_folder() / "data" / name
        if not folder.is_dir():
            pytest.skip(f"real data {name!r} are not here; set VFM_SDM_SHARED to the folder that holds data/")
        return folder

    return find
