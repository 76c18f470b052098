"""Interchangeable parts that are found by name and imported only when asked for: trackers and camera estimators."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from vfm_sdm.errors import BackendUnavailableError

__all__ = ["Backend", "find_backend"]


@dataclass(frozen=True)
class Backend:
    """Where a part is, and what it wants to know.

    Parameters
    ----------
    module, attribute
        Its class.
    settings
        Fields of ``[method]`` in a session that its constructor takes, by the same names.
    fixed
        Arguments that come with its name.
    """

    module: str
    attribute: str
    settings: tuple[str, ...] = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def make(self, **options: Any) -> Any:
        """The part with these options.

        Raises
        ------
        BackendUnavailableError
            It cannot run here.
        """
        return getattr(import_module(self.module), self.attribute)(**self.fixed, **options)

    def make_for(self, method: object) -> Any:
        """The part with the settings of a session's ``[method]``."""
        return self.make(**{name: getattr(method, name) for name in self.settings})


def find_backend(backends: Mapping[str, Backend], kind: str, name: str) -> Backend:
    """The entry of this name.

    Raises
    ------
    BackendUnavailableError
        There is none.
    """
    if name not in backends:
        raise BackendUnavailableError(f"{kind}: expected one of {sorted(backends)}, got {name!r}; choose one of these")
    return backends[name]
