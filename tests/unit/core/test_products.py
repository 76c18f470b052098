"""Products that are made from each other, on a small chain of numbers and texts."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from vfm_sdm.core.products import Chain, Kept, product
from vfm_sdm.errors import ResultsError


@dataclass(frozen=True)
class Numbers:
    """Settings of the chain."""

    a: int = 1
    b: int = 2
    unused: int = 0

    def narrowed(self, reads: Sequence[str]) -> "Numbers":
        return replace(Numbers(), **{name: getattr(self, name) for name in reads})

    def as_fields(self) -> dict[str, int]:
        return {one.name: getattr(self, one.name) for one in fields(self)}


def _read(path: Path) -> tuple[int, str]:
    try:
        value, key = json.loads(path.read_text())
    except ValueError as error:
        raise ResultsError("expected a number, got something else; delete it") from error
    return value, key


def _write(path: Path, value: int, marks: Mapping[str, str]) -> None:
    path.write_text(json.dumps([value, marks["key"]]))


class Sums(Chain[Numbers]):
    """A sum and what is made of it."""

    @product(reads=("a", "b"), kept=Kept("total.json", _read, _write))
    def total(self, numbers: Numbers) -> int:
        return numbers.a + numbers.b + numbers.unused

    @product(needs=("total",), identity=lambda sign: sign)
    def sign(self, numbers: Numbers) -> int:
        return 1 if self.total > 0 else -1

    @product(needs=("sign",), kept=Kept("word.json", _read, _write))
    def word(self, numbers: Numbers) -> str | None:
        return None if self.sign > 0 else "negative"

    @product(needs=("total",))
    def undeclared(self, numbers: Numbers) -> int:
        return self.total + self.sign

    @product(parts=("hammer",))
    def undeclared_part(self, numbers: Numbers) -> None:
        self.check_declared("saw")

    @product()
    def everything(self, numbers: Numbers) -> None:
        self.check_outside("everything")

    def part_of(self, kind):
        return {"kind": kind}

    def part_settings(self, kind):
        return ()

    def part_modules(self, kind):
        return ()


def test_asking_makes_what_is_needed_once_and_nothing_else():
    sums = Sums(Numbers(), None)
    assert (sums.sign, sums.total, sums.sign) == (1, 3, 1)
    assert sums.made == {"total": 1, "sign": 1}


def test_a_product_sees_only_the_settings_that_it_declares():
    assert Sums(Numbers(unused=40), None).total == 3


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("undeclared", "product 'undeclared' reads 'sign' and does not declare it"),
        ("undeclared_part", "product 'undeclared_part' uses a part 'saw' and does not declare it"),
        ("everything", "product 'everything' reads everything; declare what it needs of it"),
    ],
)
def test_what_is_not_declared_is_refused(name, message):
    with pytest.raises(RuntimeError, match=message):
        getattr(Sums(Numbers(), None), name)


def test_a_kept_product_is_read_while_its_key_is_the_same(tmp_path):
    Sums(Numbers(), tmp_path).total  # noqa: B018
    again = Sums(Numbers(unused=7), tmp_path)
    assert (again.total, again.reused, again.made) == (3, ["total"], {})
    other = Sums(Numbers(a=5), tmp_path)
    assert (other.total, other.reused, other.made) == (7, [], {"total": 1})


def test_a_damaged_file_is_made_again(tmp_path):
    (tmp_path / "total.json").write_text("half of a numb")
    sums = Sums(Numbers(), tmp_path)
    assert (sums.total, sums.made) == (3, {"total": 1})
    assert _read(tmp_path / "total.json") == (3, sums.key("total"))


def test_a_product_that_is_not_there_any_more_leaves_no_file(tmp_path):
    assert Sums(Numbers(a=-9), tmp_path).word == "negative"
    assert (tmp_path / "word.json").exists()
    assert Sums(Numbers(), tmp_path).word is None
    assert not (tmp_path / "word.json").exists()


def test_keys_follow_what_is_declared():
    plain, other, unread = (Sums(numbers, None) for numbers in (Numbers(), Numbers(b=30), Numbers(unused=1)))
    assert plain.key("total") == unread.key("total") != other.key("total")
    # A product told by its content is the same where its content is.
    assert plain.key("sign") == other.key("sign")
    assert plain.key("word") == other.key("word") != Sums(Numbers(a=-9), None).key("word")
    assert len(plain.key("total")) == 64


def test_the_code_of_a_product_is_in_its_key(monkeypatch):
    before = Sums(Numbers(), None).key("total")
    monkeypatch.setattr("vfm_sdm.core.products.code_hash", lambda modules, also: "other code")
    assert Sums(Numbers(), None).key("total") != before


def test_given_products_are_not_made():
    assert Sums(Numbers(), None).given(total=-4).sign == -1
    with pytest.raises(ValueError, match=r"got unknown \['totals'\]"):
        Sums(Numbers(), None).given(totals=3)


def test_a_chain_in_a_folder_takes_no_given_products(tmp_path):
    with pytest.raises(ValueError, match="got a chain in"):
        Sums(Numbers(), tmp_path).given(total=3)


def test_times_are_without_those_of_what_is_needed(monkeypatch):
    ticks = iter(range(100))
    monkeypatch.setattr("vfm_sdm.core.products.time.perf_counter", lambda: float(next(ticks)))
    sums = Sums(Numbers(), None)
    sums.sign  # noqa: B018
    # sign starts at 0, total at 1, total ends at 2, sign at 3.
    assert sums.seconds == {"total": 1.0, "sign": 2.0}


def test_products_are_named_in_the_order_in_which_they_are_written():
    assert Sums.products()[:3] == ("total", "sign", "word")


def test_a_product_of_ones_own_takes_the_place_of_ours():
    class Doubled(Sums):
        @product(reads=("a",))
        def total(self, numbers: Numbers) -> int:
            return -2 * numbers.a

    assert Doubled.products() == Sums.products()
    assert Doubled(Numbers(), None).sign == -1
    assert Doubled(Numbers(b=9), None).key("total") == Doubled(Numbers(), None).key("total")


def test_products_are_made_with_one_thread_for_small_algebra():
    class Threads(Chain[Numbers]):
        @product()
        def counted(self, numbers: Numbers) -> list[int]:
            return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]

    assert set(Threads(Numbers(1, 2, 3), None).counted) == {1}


class Unfinished(Sums):
    """A sum that is whole only from ten on, and what is made of it, which is kept as well."""

    found = 9

    @product(reads=("a", "b"), kept=Kept("rough.json", _read, _write, whole=lambda value: value >= 10))
    def rough(self, numbers: Numbers) -> int:
        return self.found

    @product(needs=("rough",))
    def between(self, numbers: Numbers) -> int:
        return -self.rough

    @product(needs=("between",), kept=Kept("made.json", _read, _write))
    def made_of_it(self, numbers: Numbers) -> int:
        return 2 * self.between


def test_what_is_made_of_an_unfinished_product_is_made_again_with_it(tmp_path):
    first = Unfinished(Numbers(), tmp_path)
    assert first.made_of_it == -18
    assert first.in_folder == {name: f"{first.key(name)} unfinished" for name in ("rough", "made_of_it")}
    assert json.loads((tmp_path / "made.json").read_text())[1] == first.in_folder["made_of_it"]
    again = Unfinished(Numbers(), tmp_path)
    again.found = 10
    assert again.made_of_it == -20
    assert again.in_folder == {name: again.key(name) for name in ("rough", "made_of_it")}
    last = Unfinished(Numbers(), tmp_path)
    assert last.made_of_it == -20
    assert last.made.get("rough", 0) == last.made.get("made_of_it", 0) == 0


def test_pieces_stay_until_their_product_is_whole(tmp_path):
    import xarray as xr

    class Keeps(Unfinished):
        @product(reads=("a", "b"), kept=Kept("rough.json", _read, _write, whole=lambda value: value >= 10))
        def rough(self, numbers: Numbers) -> int:
            self.pieces().write(0, 0, xr.Dataset(attrs={"found": self.found}))
            return self.found

    Keeps(Numbers(), tmp_path).ask(Keeps.rough)
    assert (tmp_path / "rough" / "0" / "0000.npz").exists()
    whole = Keeps(Numbers(), tmp_path)
    whole.found = 10
    assert whole.rough == 10
    assert not (tmp_path / "rough").exists()
