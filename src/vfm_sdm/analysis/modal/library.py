"""pyOMA-2, imported when it is asked for, and without what its import does to the rest of the process."""

import logging
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from vfm_sdm.errors import BackendUnavailableError

__all__ = ["Library", "load_library"]


@dataclass(frozen=True)
class Library:
    """Modules of pyOMA-2.

    Parameters
    ----------
    ssi, fdd, general
        Stochastic subspace identification, frequency domain decomposition, and what both share.
    """

    ssi: Any
    fdd: Any
    general: Any


@cache
def load_library() -> Library:
    """The modules of pyOMA-2 that are used.

    Raises
    ------
    BackendUnavailableError
        It is not installed.

    Notes
    -----
    Its import silences NumPy's warnings and sets up logging, both for the whole process; both are put back. Its
    progress bars, which no argument turns off, are turned off in its own modules.
    """
    drawing = logging.getLogger("matplotlib")
    level = drawing.level
    try:
        with np.errstate():
            from pyoma2.functions import fdd, gen, ssi  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise BackendUnavailableError(
            "modes: expected the package pyOMA-2, got none; pip install 'vfm-sdm[modal]'"
        ) from error
    finally:
        drawing.setLevel(level)
        logging.getLogger("pyoma2").handlers.clear()
        logging.getLogger("pyoma2").setLevel(logging.WARNING)
    modules: tuple[Any, ...] = (ssi, fdd)
    for module in modules:
        module.trange = partial(module.trange, disable=True)
        module.tqdm = partial(module.tqdm, disable=True)
    return Library(ssi, fdd, gen)
