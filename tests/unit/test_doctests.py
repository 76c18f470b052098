"""The examples in docstrings print what they say."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

import vfm_sdm

_PACKAGE = Path(vfm_sdm.__file__).parent


def modules_with_examples() -> list[str]:
    """Names of the modules with examples, found in their text, so that nothing is imported before its test runs."""
    files = sorted(path for path in _PACKAGE.rglob("*.py") if ">>> " in path.read_text(encoding="utf-8"))
    parts = [path.relative_to(_PACKAGE.parent).with_suffix("").parts for path in files]
    return [".".join(names[:-1] if names[-1] == "__init__" else names) for names in parts]


@pytest.mark.parametrize("name", modules_with_examples())
def test_examples_print_what_they_say(name):
    try:
        module = import_module(name)
    except ModuleNotFoundError as missing:
        if missing.name not in {"torch", "safetensors", "huggingface_hub", "transformers", "pycolmap"}:
            raise
        pytest.skip(f"needs {missing.name}, which only an extra installs")
    results = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert results.attempted > 0
    assert results.failed == 0
