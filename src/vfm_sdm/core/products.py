"""Products made from each other: each once, of declared inputs, kept in files under keys that follow from these.

A class derives from `Chain` and writes its products as methods under `product`, in the order in which they are made of
each other. What a method declares is all that it gets: the settings named in ``reads`` (everything else is at its
default), the products named in ``needs`` and the interchangeable parts named in ``parts`` (asking for others is an
error). So the key, a hash of what is declared and of the code that runs, cannot leave anything out.
"""

import hashlib
import inspect
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar, cast, overload

from vfm_sdm.core.code import code_hash, modules_used
from vfm_sdm.core.parts import Kind
from vfm_sdm.core.pieces import Pieces
from vfm_sdm.core.threads import small_algebra
from vfm_sdm.errors import ResultsError

__all__ = ["Chain", "Kept", "Product", "Settings", "product"]

T = TypeVar("T")
S = TypeVar("S", bound="Settings")


class Settings(Protocol):
    """Settings of which a part can be taken."""

    def narrowed(self, reads: Sequence[str]) -> Self:
        """The settings with everything but the named fields at its default.

        Parameters
        ----------
        reads
            Dotted names of the fields that keep their values.
        """
        ...

    def as_fields(self) -> Mapping[str, Any]:
        """Fields of the settings as plain tables."""
        ...


@dataclass(frozen=True)
class Kept(Generic[T]):
    """File of a product in the run folder.

    Parameters
    ----------
    file
        Name of the file.
    read
        Function that returns product and key of the file at a path; ``None`` for a product that is made anew at every
        run.
    write
        Function that writes a product and its key to the file at a path, whole or not at all.
    beside
        Names of further files that this one writes.
    whole
        Function that says whether the product is all that it should be. Of one that is not, the pieces stay, and the
        next run makes it again, with all that is made of it.
    """

    file: str
    read: Callable[[Path], tuple[T, str]] | None
    write: Callable[[Path, T, Mapping[str, str]], object]
    beside: tuple[str, ...] = ()
    whole: Callable[[T], bool] = lambda _: True


@dataclass(frozen=True)
class _Declared:
    """Declarations of a product; see `product`."""

    reads: tuple[str, ...]
    needs: tuple[str, ...]
    parts: tuple[Kind, ...]
    label: str
    identity: Callable[[Any], Any] | None


class Product(Generic[T]):
    """A product of a `Chain`, made or read when it is first asked for."""

    def __init__(self, make: Callable[[Any, Any], T], declared: _Declared, kept: Kept[T] | None) -> None:
        self.make, self.kept = make, kept
        self.reads, self.needs, self.parts = declared.reads, declared.needs, declared.parts
        self.name = make.__name__
        self.label, self.identity = declared.label or self.name, declared.identity
        self.__doc__ = make.__doc__

    @overload
    def __get__(self, chain: None, owner: type | None = None) -> "Product[T]": ...
    @overload
    def __get__(self, chain: "Chain[Any]", owner: type | None = None) -> T: ...
    def __get__(self, chain: "Chain[Any] | None", owner: type | None = None) -> "T | Product[T]":
        """The product of a chain."""
        return self if chain is None else chain.ask(self)


class product:  # noqa: N801  (a decorator)
    """Makes a method of a `Chain` one of its products; the method gets the settings that it declares.

    Parameters
    ----------
    reads
        Dotted names of the settings that it reads.
    needs
        Names of the products that it reads.
    parts
        Kinds of interchangeable parts that it uses; their settings need not be named.
    kept
        File of the product in the run folder; without one, it is in memory only.
    label
        Name of the product in summaries and progress; the method's name by default.
    identity
        Function that gives a product as plain tables, where equal products made of different inputs must count as the
        same.
    """

    def __init__(
        self,
        *,
        reads: Sequence[str] = (),
        needs: Sequence[str] = (),
        parts: Sequence[Kind] = (),
        kept: Kept[Any] | None = None,
        label: str = "",
        identity: Callable[[Any], Any] | None = None,
    ) -> None:
        self._declared = _Declared(tuple(reads), tuple(needs), tuple(parts), label, identity)
        self._kept = kept

    def __call__(self, make: Callable[[Any, Any], T]) -> Product[T]:
        """The product that a method makes."""
        return Product(make, self._declared, self._kept)


class Chain(Generic[S]):
    """Products of one set of settings, in a folder or in memory.

    Parameters
    ----------
    settings
        Settings that the products read.
    folder
        Folder of the products' files; ``None`` keeps all products in memory.

    Attributes
    ----------
    seconds
        Time that each product took, without that of the products that it needs, by label [s].
    reused
        Labels of the products that were read from the folder.
    made
        How often each product was made, by name.
    were_given
        Names of the products that were given instead of made.
    in_folder
        Keys of the products that were read from the folder or written to it, by name.
    """

    def __init__(self, settings: S, folder: Path | None) -> None:
        self.folder = folder
        self.seconds: dict[str, float] = {}
        self.reused: list[str] = []
        self.made: dict[str, int] = {}
        self.were_given: set[str] = set()
        self.in_folder: dict[str, str] = {}
        self._settings = settings
        self._values: dict[str, Any] = {}
        self._unfinished: set[str] = set()
        self._keys: dict[str, str] = {}
        self._asking: list[Product[Any]] = []
        self._inside_s: list[float] = []

    def given(self, **products: Any) -> Self:
        """The chain with some of its products given instead of made: tracks of another program, known cameras.

        Raises
        ------
        ValueError
            There is no such product, some were made already, or the chain keeps its products in a folder, where nothing
            tells what the given ones were made of.
        """
        unknown = set(products) - set(self.products())
        if unknown or self.folder is not None or self.made:
            got = f"unknown {sorted(unknown)}" if unknown else f"a chain in {self.folder}"
            got = f"one that has made {sorted(self.made)}" if self.made else got
            raise ValueError(f"given: expected products {self.products()} of a chain in memory, got {got}; correct it")
        self._values.update(products)
        self.were_given |= set(products)
        return self

    def inputs_of(self, settings: S) -> Mapping[str, str]:
        """Hashes of the files that settings name, by their names in the key; none here."""
        del settings
        return {}

    def part_of(self, kind: Kind) -> Mapping[str, Any]:
        """Facts that tell an interchangeable part of this kind from another; see `product`."""
        raise NotImplementedError(kind)

    def part_settings(self, kind: Kind) -> Sequence[str]:
        """Settings that the chosen part of this kind reads, and the one that chooses it."""
        raise NotImplementedError(kind)

    def part_modules(self, kind: Kind) -> Sequence[str]:
        """Modules of the chosen part of this kind."""
        raise NotImplementedError(kind)

    def marks(self) -> Mapping[str, str]:
        """What a kept product says of where it comes from, beside its key."""
        return {}

    def versions(self) -> Mapping[str, str]:
        """Versions of the programs that every product depends on."""
        return {}

    def ask(self, wanted: Product[T]) -> T:
        """A product: from memory, from the folder where its key is still the same, or made."""
        if self._asking and wanted.name not in self._asking[-1].needs:
            raise RuntimeError(f"product {self._asking[-1].name!r} reads {wanted.name!r} and does not declare it")
        if wanted.name not in self._values:
            self._values[wanted.name] = self._fetch(wanted)
        return cast(T, self._values[wanted.name])

    def rounded_seconds(self) -> dict[str, float]:
        """Time that each product took [s], by label."""
        return {name: round(value, 3) for name, value in self.seconds.items()}

    def check_outside(self, what: str) -> None:
        """Refuses access to what no product may read, while a product is made.

        Parameters
        ----------
        what
            Name of what is asked for, for the message.

        Raises
        ------
        RuntimeError
            A product is being made.
        """
        if self._asking:
            raise RuntimeError(f"product {self._asking[-1].name!r} reads {what}; declare what it needs of it")

    def check_declared(self, kind: Kind) -> None:
        """Refuses a part that the product in the making does not declare.

        Raises
        ------
        RuntimeError
            The product in the making does not declare the part.
        """
        if self._asking and kind not in self._asking[-1].parts:
            raise RuntimeError(f"product {self._asking[-1].name!r} uses a part {kind!r} and does not declare it")

    def key(self, name: str) -> str:
        """Key of a product: one hash, 64 hexadecimal digits, of all that it is made of."""
        if name not in self._keys:
            one = self.product(name)
            if one.identity is not None:
                with self._step_outside():
                    made_of = [name, one.identity(self.ask(one))]
            else:
                made_of = [name, self.ingredients(one)]
            text = json.dumps(made_of, sort_keys=True)
            self._keys[name] = hashlib.sha256(text.encode()).hexdigest()
        return self._keys[name]

    def ingredients(self, one: Product[Any]) -> Mapping[str, Any]:
        """All that a product is made of, as plain tables, whose hash is its key."""
        settings = self._narrow_settings(one)
        return {
            "settings": settings.as_fields(),
            "files": dict(self.inputs_of(settings)),
            "products": {need: self.key(need) for need in one.needs},
            "parts": {kind: dict(self.part_of(kind)) for kind in one.parts},
            "code": self._hash_code(one),
            "versions": dict(self.versions()),
        }

    @classmethod
    def product(cls, name: str) -> Product[Any]:
        """The product of this name."""
        return cast(Product[Any], inspect.getattr_static(cls, name))

    @classmethod
    def products(cls) -> tuple[str, ...]:
        """Names of all products in the order in which they are written."""
        members = (item for base in reversed(cls.__mro__) for item in vars(base).items())
        return tuple(dict.fromkeys(name for name, one in members if isinstance(one, Product)))

    def _fetch(self, wanted: Product[T]) -> T:
        path = None if self.folder is None or wanted.kept is None else self.folder / wanted.kept.file
        key = self._compute_input_key(wanted) if path is not None else ""
        if path is not None and wanted.kept is not None and wanted.kept.read is not None and path.exists():
            try:
                found, known = wanted.kept.read(path)
            except ResultsError:
                known = ""  # of another version, or damaged: it is made again
            if known == key:
                self.reused.append(wanted.label)
                self.in_folder[wanted.name] = key
                return found
        settings = self._narrow_settings(wanted)
        self._asking.append(wanted)
        try:
            with self.timed(wanted.label), small_algebra():
                value = wanted.make(self, settings)
        finally:
            self._asking.pop()
        self.made[wanted.name] = self.made.get(wanted.name, 0) + 1
        self._values[wanted.name] = value  # now already: what cannot be written need not be made again
        if not self._unfinished.isdisjoint(wanted.needs) or not (wanted.kept is None or wanted.kept.whole(value)):
            self._unfinished.add(wanted.name)
        if path is not None and wanted.kept is not None:
            if value is None:  # an earlier run had one
                for name in (wanted.kept.file, *wanted.kept.beside):
                    path.with_name(name).unlink(missing_ok=True)
            else:
                mark = f"{key} unfinished" if wanted.name in self._unfinished else key
                wanted.kept.write(path, value, {"key": mark, **self.marks()})
                self.in_folder[wanted.name] = mark
                if mark == key:
                    self._pieces_of(wanted).clear()
        return value

    def pieces(self) -> Pieces | None:
        """Where the product in the making keeps its pieces, for a run that is cut short; ``None`` without a file."""
        wanted = self._asking[-1]
        if self.folder is None or wanted.kept is None:
            return None
        return self._pieces_of(wanted)

    def _pieces_of(self, one: Product[Any]) -> Pieces:
        return Pieces((self.folder or Path()) / one.name, self._compute_input_key(one))

    def _compute_input_key(self, wanted: Product[Any]) -> str:
        """Key of the inputs of a product, also where the product's own key is its content."""
        if wanted.identity is None:
            return self.key(wanted.name)
        text = json.dumps([wanted.name, self.ingredients(wanted)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def _narrow_settings(self, one: Product[Any]) -> S:
        of_parts = [name for kind in one.parts for name in self.part_settings(kind)]
        return self._settings.narrowed([*one.reads, *of_parts])

    def _hash_code(self, one: Product[Any]) -> str:
        # What makes it, the methods that this calls, and what keeps it: a file in another form must not be read.
        called = (inspect.getattr_static(type(self), name, None) for name in one.make.__code__.co_names)
        functions: list[Callable[..., Any]] = [one.make, *(f for f in called if inspect.isfunction(f))]
        if one.kept is not None:
            functions += [function for function in (one.kept.read, one.kept.write) if function is not None]
        modules = {module for function in functions for module in modules_used(function)}
        modules |= {function.__module__ for function in functions} - {one.make.__module__}
        modules |= {module for kind in one.parts for module in self.part_modules(kind)}
        return code_hash(frozenset(modules), also="\n".join(inspect.getsource(function) for function in functions))

    @contextmanager
    def _step_outside(self) -> Iterator[None]:
        """Asks for a product beside the one in the making."""
        asking, self._asking = self._asking, []
        try:
            yield
        finally:
            self._asking = asking

    @contextmanager
    def timed(self, label: str) -> Iterator[None]:
        """Adds the time of the block, without that of blocks inside it, to `seconds` under a label."""
        self._inside_s.append(0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            whole = time.perf_counter() - start
            self.seconds[label] = self.seconds.get(label, 0.0) + whole - self._inside_s.pop()
            if self._inside_s:
                self._inside_s[-1] += whole
