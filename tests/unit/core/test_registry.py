"""Parts by kind and name: what is declared, what is given, and what is said of parts that cannot be had."""

import inspect
import subprocess
import sys
from typing import get_args

import pytest

from plugins import installed
from vfm_sdm.commands.environment import describe_environment
from vfm_sdm.core.parts import BUILT_IN, KINDS, Kind, Part, PartSettings
from vfm_sdm.core.registry import code_modules, find, make, part_names, settings_read, table_names
from vfm_sdm.errors import BackendUnavailableError, SessionError, VfmSdmError
from vfm_sdm.inputs.session import Method, Network
from vfm_sdm.networks.availability import why_unavailable
from vfm_sdm.stages.tracking.base import find_tracker

EVERY = [(kind, name) for kind, parts in BUILT_IN.items() for name in parts]
TRACKER = "class Tracker:\n    {}\n    def track(self, *args, **options): ...\n"


class TestBuiltIn:
    def test_every_kind_has_a_table(self):
        assert set(BUILT_IN) == set(KINDS) == set(get_args(Kind))
        assert all(BUILT_IN.values())
        assert len({info.group for info in KINDS.values()}) == len(KINDS)

    @pytest.mark.parametrize(("kind", "name"), EVERY, ids=lambda word: word)
    def test_the_line_is_right(self, kind, name):
        """The class is there, has the method, and its constructor takes what the line says it reads."""
        part = find(kind, name)
        made = part.load()
        if made is None:
            return
        calls = KINDS[kind].calls
        given = {read.split(".")[0] for read in part.reads} | set(part.fixed) | set(part.chooses)
        for other, called in part.made_of:
            given |= {read.split(".")[0] for read in find(other, called).reads}
        if calls:
            assert given <= set(inspect.signature(made).parameters)
            assert isinstance(made, type) is False or callable(getattr(made, calls))
        else:
            assert callable(made)
            assert not given

    @pytest.mark.parametrize(("kind", "name"), EVERY, ids=lambda word: word)
    def test_it_reads_fields_that_there_are(self, kind, name):
        if not KINDS[kind].field:
            return
        settings = settings_read(kind, Method(**{KINDS[kind].field: name}))
        assert settings[KINDS[kind].field] == name

    def test_nothing_is_imported_to_list_them(self):
        code = """
import sys
from vfm_sdm.core.registry import find, part_names, parts_of, code_modules
from vfm_sdm.core.parts import KINDS
for kind in KINDS:
    for name in part_names(kind):
        parts_of(kind, name)
print([name for name in sys.modules if name.startswith(("vfm_sdm.stages", "vfm_sdm.outputs", "torch", "numba"))])
"""
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "[]"


class TestSettings:
    def test_what_each_part_reads(self):
        method = Method(tracker="vggt+icgn", network=Network(weights="mine.pt", preset="paper"), subset_px=31)
        assert settings_read("trackers", method) == {
            "tracker": "vggt+icgn",
            "network.weights": "mine.pt",
            "network.device": "auto",
            "network.precision": "auto",
            "network.preset": "paper",
            "subset_px": 31,
        }
        plain = method.model_copy(update={"matching": "sift"})
        assert settings_read("cameras", plain) == {"cameras": "two-view", "matching": "sift"}
        assert settings_read("matchers", method) == {"correspondence": "registration"}
        assert settings_read("trackers", Method(tracker="tapir", network=method.network)) == {
            "tracker": "tapir",
            "network.weights": "mine.pt",
            "network.device": "auto",
        }

    def test_settings_of_a_part_that_another_one_uses_are_among_them(self):
        plain = Method(cameras="sfm", matching="sift")
        assert settings_read("cameras", plain) == {"cameras": "sfm", "matching": "sift"}
        learned = Method(cameras="sfm", matching="superpoint+lightglue")
        assert settings_read("cameras", learned) == {
            "cameras": "sfm",
            "matching": "superpoint+lightglue",
            "sfm.model": None,
        }
        assert code_modules("cameras", learned) == (
            "vfm_sdm.stages.cameras.sfm",
            "vfm_sdm.stages.matching.learned_features",
        )

    def test_the_code_is_that_of_all_parts(self):
        assert code_modules("trackers", Method(tracker="tapir+icgn")) == (
            "vfm_sdm.stages.tracking.hybrid",
            "vfm_sdm.stages.tracking.icgn",
            "vfm_sdm.stages.tracking.tapir",
        )
        assert code_modules("matchers", Method()) == ()

    def test_a_part_is_given_only_what_it_declares(self, monkeypatch):
        """A key made of declarations holds by construction: other keys of a table have their defaults."""
        given = {}
        monkeypatch.setattr("vfm_sdm.core.parts._load", lambda target: given.update if target else None)
        monkeypatch.setitem(BUILT_IN["trackers"], "mine", Part("a:B", ("network.device", "subset_px")))
        network = Network(weights="mine.pt", preset="paper", device="cpu")
        make("trackers", Method(tracker="mine", network=network, subset_px=31))
        assert given == {"network": Network(device="cpu"), "subset_px": 31}
        monkeypatch.setitem(BUILT_IN["trackers"], "mine", Part("a:B", ("network",)))
        make("trackers", Method(tracker="mine", network=network))
        assert given["network"] == network

    def test_a_declared_field_must_be_one(self, monkeypatch):
        monkeypatch.setitem(BUILT_IN["trackers"], "mine", Part("a:B", ("network.colour",)))
        message = r"mine: expected it to read fields of \[method\], got 'network\.colour', which there is not"
        with pytest.raises(BackendUnavailableError, match=message):
            settings_read("trackers", Method(tracker="mine"))

    def test_tables_belong_to_parts_that_sessions_name(self, tmp_path):
        with broken(tmp_path, TRACKER.format("")):
            assert "mine" in table_names()
        with_tables = {name for parts in BUILT_IN.values() for name, part in parts.items() if part.settings}
        assert not {"mine", *(name for _, name in EVERY)} & set(table_names()) - with_tables


def broken(folder, text, **options):
    return installed(folder, {"vfm_sdm.trackers": {"mine": "broken_parts:Tracker"}}, {"broken_parts": text}, **options)


BROKEN = {
    "does not import": (
        "import no_such_module",
        r"expected to import broken_parts:Tracker, got ModuleNotFoundError: ",
    ),
    "does not parse": ("def", r"expected to import broken_parts:Tracker, got SyntaxError: "),
    "raises": ("raise RuntimeError('two\nlines')".replace("\n", "\\n"), r"got RuntimeError: two lines; repair or"),
    "lacks the class": ("", r"expected to import broken_parts:Tracker, got AttributeError: "),
    "is no class": ("Tracker = 3", r"expected a class with the method track, got 3; repair or uninstall"),
    "lacks the method": ("class Tracker: ...", r"expected a class with the method track, got <class"),
    "has other settings": (
        TRACKER.format("Settings = dict"),
        r"expected Settings to derive from vfm_sdm\.core\.parts\.PartSettings, got <class 'dict'>",
    ),
    "declares text": (TRACKER.format("reads = 'subset_px'"), r"expected reads to be a tuple, got 'subset_px'"),
    "needs a list": (TRACKER.format("needs = ['torch']"), r"expected needs to be a Needs, got \['torch'\]"),
    "requires the unknown": (
        TRACKER.format("requires = ('tape',)"),
        r"expected requires of \('baseline', .*got \['tape'\]",
    ),
}


class TestOtherPackages:
    @pytest.mark.parametrize("fault", BROKEN)
    def test_a_broken_one_is_one_line_for_those_who_ask_for_it(self, tmp_path, fault):
        text, message = BROKEN[fault]
        with broken(tmp_path, text):
            with pytest.raises(
                BackendUnavailableError, match=rf"^tracker 'mine' of river-tools 1\.2: .*{message}"
            ) as caught:
                find_tracker("mine")
            assert "\n" not in str(caught.value)
            # Nobody else is concerned, and a session that names it can be read.
            assert find_tracker("icgn").name == "icgn"
            assert Method(tracker="mine").tracker == "mine"
            line = next(line for line in describe_environment()["trackers"] if line.startswith("mine: "))
            assert line == f"mine: cannot run: {caught.value}"

    def test_a_table_of_a_broken_one_is_a_fault_of_the_session(self, tmp_path, small_session):
        with broken(tmp_path, "import no_such_module"):
            message = r"method\.mine: tracker 'mine' of river-tools 1\.2: expected to import .*No module named"
            with pytest.raises(SessionError, match=message):
                small_session(mine={"gain": 2.0})

    def test_none_may_take_the_name_of_a_part_of_this_package(self, tmp_path):
        with installed(tmp_path, {"vfm_sdm.trackers": {"icgn": "mine:Tracker"}}, {"mine": TRACKER.format("")}):
            message = (
                r"tracker 'icgn': expected one package that brings it, got vfm-sdm and river-tools 1\.2; "
                r"uninstall river-tools, or let it choose another name"
            )
            with pytest.raises(BackendUnavailableError, match=message):
                find_tracker("icgn")
            assert find_tracker("template").name == "template"
            assert any(
                "icgn: cannot run: tracker 'icgn': expected" in line for line in describe_environment()["trackers"]
            )
        assert find_tracker("icgn").name == "icgn"

    def test_a_name_belongs_to_one_package(self, tmp_path):
        parts = {"vfm_sdm.trackers": {"mine": "mine:Tracker"}}
        with (
            installed(tmp_path / "a", parts, {"mine": TRACKER.format("")}),
            installed(tmp_path / "b", parts, {"mine": TRACKER.format("")}, name="hill-tools", version="3"),
            pytest.raises(
                BackendUnavailableError, match=r"tracker 'mine': expected one package .* got (hill|river)-tools"
            ),
        ):
            find_tracker("mine")

    def test_names_are_keys_and_parts_of_file_names(self, tmp_path):
        with (
            installed(tmp_path, {"vfm_sdm.writers": {"a/b": "mine:write"}}, {"mine": "def write(): ..."}),
            pytest.raises(
                BackendUnavailableError, match=r"export 'a/b' of river-tools 1\.2: expected a name of letters"
            ),
        ):
            find("writers", "a/b")

    def test_one_that_cannot_be_made_says_so(self, tmp_path):
        text = TRACKER.format("reads = ('subset_px',)")
        with broken(tmp_path, text):
            message = r"broken_parts:Tracker of river-tools 1\.2: expected it to take \['subset_px'\], got TypeError: "
            with pytest.raises(BackendUnavailableError, match=message):
                make("trackers", Method(tracker="mine", subset_px=31))

    def test_what_a_session_leaves_open_is_left_to_it(self, tmp_path):
        text = TRACKER.format(
            "reads = ('subset_px',)\n    def __init__(self, *, subset_px=17):\n        self.side = subset_px"
        )
        with broken(tmp_path, text):
            assert make("trackers", Method(tracker="mine")).side == 17
            assert make("trackers", Method(tracker="mine", subset_px=31)).side == 31

    def test_its_own_errors_pass(self, tmp_path):
        raising = (
            "def __init__(self):\n        from vfm_sdm.errors import SessionError\n        raise SessionError('no')"
        )
        with broken(tmp_path, TRACKER.format(raising)), pytest.raises(SessionError, match=r"^no$"):
            find_tracker("mine")

    def test_declarations_are_attributes_of_the_class(self, tmp_path):
        declared = (
            "from vfm_sdm.core.parts import Needs\n"
            "class Tracker:\n"
            "    reads = ('network.device',)\n"
            "    made_of = (('trackers', 'icgn'),)\n"
            "    needs = Needs('', ('no_such_package',))\n"
            "    def __init__(self, *, network, subset_px):\n"
            "        self.given = (network, subset_px)\n"
            "    def track(self, *args, **options): ...\n"
        )
        with broken(tmp_path, declared):
            method = Method(tracker="mine", subset_px=31, network=Network(device="cpu", preset="paper"))
            assert make("trackers", method).given == (Network(device="cpu"), 31)
            assert settings_read("trackers", method) == {"tracker": "mine", "network.device": "cpu", "subset_px": 31}
            assert code_modules("trackers", method) == (
                "broken_parts",
                "river-tools 1.2",
                "vfm_sdm.stages.tracking.icgn",
            )
            assert (
                why_unavailable("trackers", "mine") == "expected no_such_package, got none; pip install no_such_package"
            )

    def test_what_an_estimator_requires_of_the_session(self, tmp_path, small_session):
        text = "class Cameras:\n    requires = ('chessboard',)\n    def estimate(self, session, frames): ...\n"
        with installed(tmp_path, {"vfm_sdm.cameras": {"mine": "mine:Cameras"}}, {"mine": text}):
            message = r'chessboard: expected a table \[chessboard\] for cameras = "mine", got nothing'
            with pytest.raises(SessionError, match=message):
                small_session(cameras="mine")

    def test_a_table_may_not_be_called_as_a_key_of_the_method(self, tmp_path, small_session):
        text = "from vfm_sdm.core.parts import PartSettings\n" + TRACKER.format("class Settings(PartSettings): ...")
        with installed(tmp_path, {"vfm_sdm.trackers": {"network": "mine:Tracker"}}, {"mine": text}):
            message = (
                r"method\.tracker: expected a part whose table has a name of its own, got 'network', which is another"
            )
            with pytest.raises(SessionError, match=message):
                small_session(tracker="network")

    def test_two_parts_of_one_name_have_one_table(self, tmp_path, small_session):
        head = "from vfm_sdm.core.parts import PartSettings\n"
        tracker = TRACKER.format("class Settings(PartSettings):\n        gain: float = 1.0")
        cameras = "class Cameras:\n    Settings = {}\n    def estimate(self, *args): ...\n"
        for settings, fails in (("Tracker.Settings", False), ("type('Settings', (PartSettings,), {{}})", True)):
            name = "separate" if fails else "common"
            groups = {
                "vfm_sdm.trackers": {name: f"{name}_parts:Tracker"},
                "vfm_sdm.cameras": {name: f"{name}_parts:Cameras"},
            }
            text = head + tracker + cameras.format(settings.format())
            with installed(tmp_path / name, groups, {f"{name}_parts": text}):
                if fails:
                    with pytest.raises(SessionError, match=r"method\.separate: expected one model of"):
                        small_session(tracker=name, cameras=name)
                else:
                    method = small_session(tracker=name, cameras=name).method
                    assert method.tables["common"].gain == 1.0


@pytest.fixture
def small_session():
    from vfm_sdm.inputs.session import Session

    def make_session(**method):
        return Session(
            name="small",
            view=[{"name": "left", "video": "left.mp4", "camera": "left.toml"}],
            point=[{"name": "a", "view": "left", "pixel": [1.0, 1.0]}],
            method=method,
        )

    return make_session


def test_settings_are_frozen_and_closed():
    class Settings(PartSettings):
        gain: float = 1.0

    with pytest.raises(ValueError, match="frozen"):
        Settings().gain = 2.0
    with pytest.raises(ValueError, match="Extra inputs are not permitted"):
        Settings(gian=2.0)


def test_names_of_this_package_come_first():
    for kind, parts in BUILT_IN.items():
        assert part_names(kind)[: len(parts)] == list(parts)


def test_unknown_names_are_errors_of_this_package():
    for kind in KINDS:
        with pytest.raises(VfmSdmError, match=rf"^{KINDS[kind].word}: expected one of \[.*\], got 'none such'; choose"):
            find(kind, "none such")
