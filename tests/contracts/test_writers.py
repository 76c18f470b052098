"""One suite over every output writer: what any of them promises, whatever its format."""

import csv
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.io import loadmat

from plugins import installed
from uff import read_uff
from vfm_sdm.core.datasets import STRUCTURE_AXES, DisplacementArrays, make_displacement, make_tracks
from vfm_sdm.core.parts import BUILT_IN
from vfm_sdm.errors import BackendUnavailableError, DatasetError, ResultsError
from vfm_sdm.outputs.results import write_export

FRAMES = 25
AWKWARD = ["1/2 span", 'süd, "oben"; = 3', "two\nlines", "x" * 90, "-1", " "]


def read_table(path):
    """CSV, by the standard library."""
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    columns = [i for i, name in enumerate(header) if name.endswith(" [mm]") and not name.endswith(" std [mm]")]
    points = [header[i].removesuffix(" lateral [mm]") for i in columns[::3]]
    values = np.array([[float(row[i] or "nan") for i in columns] for row in rows])
    return np.array([float(row[0]) for row in rows]), points, values.reshape(len(rows), -1, 3)


def read_matlab(path):
    """MAT, by SciPy."""
    content = loadmat(path)
    return content["time_s"][:, 0], [str(cell[0]) for cell in content["points"][:, 0]], content["displacement_mm"]


def read_universal(path):
    """UFF 58; samples without a value are left out there, and names are ASCII in a line of 80."""
    functions = read_uff(path)[1]
    nodes = max(f["node"] for f in functions)
    time_s = np.unique(np.concatenate([f["times"] for f in functions]).round(5))
    values = np.full((len(time_s), nodes, 3), np.nan)
    names = [""] * nodes
    for f in functions:
        rows = np.abs(time_s[:, None] - f["times"]).argmin(axis=0)
        values[rows, f["node"] - 1, f["direction"] - 1] = 1e3 * f["values"]
        names[f["node"] - 1] = f["ids"][0]
    return time_s, names, values


READERS = {"csv": read_table, "mat": read_matlab, "uff": read_universal}
"""An independent reader of each format: time [s], what stands for the points' names, and displacement [mm]."""


@pytest.fixture(params=sorted(BUILT_IN["writers"]))
def name(request):
    return request.param


def example(points=("1/2 span", "abutment"), *, frames=FRAMES, seed=0):
    rng = np.random.default_rng(seed)
    shape = (frames, len(points), 3)
    status = np.zeros(shape[:2])
    displacement = rng.normal(size=shape)
    displacement[3, 0], status[3, 0] = np.nan, 1
    return make_displacement(
        np.arange(frames) / 50.0,
        list(points),
        STRUCTURE_AXES,
        DisplacementArrays(
            displacement_mm=displacement,
            displacement_std_mm=rng.uniform(0.1, 0.2, shape),
            scale_std=rng.uniform(0.01, 0.02, shape[1:]),
            position_m=rng.normal(size=shape),
            reprojection_error_px=rng.uniform(size=shape[:2]),
            status=status,
        ),
        attrs={"frame": "structure"},
    )


def test_the_file_has_the_name_of_its_writer(name, tmp_path):
    path = write_export(name, tmp_path / "new" / "run", example())
    assert path == tmp_path / "new" / "run" / f"displacement.{name}"
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_an_independent_reader_finds_what_was_written(name, tmp_path):
    displacement = example()
    time_s, _, values = READERS[name](write_export(name, tmp_path, displacement))
    np.testing.assert_allclose(time_s, displacement["time"], atol=1e-5)
    np.testing.assert_allclose(values, displacement["displacement"], rtol=1e-8, atol=1e-9)
    assert np.isnan(values).sum() == 3


def test_awkward_names_stay_where_they_belong(name, tmp_path):
    displacement = example(AWKWARD)
    _, names, values = READERS[name](write_export(name, tmp_path, displacement))
    np.testing.assert_allclose(values, displacement["displacement"], rtol=1e-8, atol=1e-9)
    assert len(names) == len(AWKWARD)
    if name != "uff":
        assert names == AWKWARD
    else:
        assert names[0] == "1/2 span longitudinal"
        assert names[1] == 's?d, "oben"; = 3 longitudinal'
        assert names[2] == "two lines longitudinal"


def test_the_dataset_stays_as_it_was(name, tmp_path):
    displacement = example()
    write_export(name, tmp_path, displacement)
    xr.testing.assert_identical(displacement, example())


def test_what_is_no_displacement_is_refused(name, tmp_path):
    covariance = np.broadcast_to(np.eye(2), (4, 1, 2, 2))
    tracks = make_tracks(np.arange(4.0), ["a"], np.ones((4, 1, 2)), covariance, np.zeros((4, 1)), attrs={})
    metres = example()
    metres["displacement"].attrs["units"] = "m"
    wrong = {
        "expected a variable 'displacement'": tracks,
        "displacement: expected units 'mm', got 'm'": metres,
        "expected a variable 'displacement_std'": example().drop_vars("displacement_std"),
        r"displacement: expected dims \('time', 'point', 'axis'\)": example().transpose("axis", "point", "time"),
    }
    for message, dataset in wrong.items():
        with pytest.raises(DatasetError, match=message):
            write_export(name, tmp_path, dataset)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_earlier_file_and_nothing_else(name, tmp_path, monkeypatch):
    earlier = write_export(name, tmp_path, example()).read_bytes()

    def full(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    message = rf"displacement\.{name}: expected to write it, got: .*No space left on device; close it elsewhere, or"
    with pytest.raises(ResultsError, match=message):
        write_export(name, tmp_path, example(seed=1))
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == [f"displacement.{name}"]
    assert (tmp_path / f"displacement.{name}").read_bytes() == earlier


def test_without_any_value_there_is_a_whole_file_or_an_error(name, tmp_path):
    empty = example()
    empty["displacement"][:] = np.nan
    try:
        path = write_export(name, tmp_path, empty)
    except ResultsError as error:
        assert str(error).startswith(f"{tmp_path / 'displacement'}.{name}: expected at least one value, got none")  # noqa: PT017
        assert list(tmp_path.iterdir()) == []
    else:
        assert np.isnan(READERS[name](path)[2]).all()


HALF = """
def write(path, displacement):
    path.write_text("half")
    raise {}
"""


@pytest.mark.parametrize(
    ("raised", "message"),
    [
        ("OSError(28, 'No space left on device')", r"displacement\.half: expected to write it, got: .*No space left"),
        ("ValueError('no such type')", r"displacement\.half: expected to write it, got: no such type"),
    ],
)
def test_a_writer_that_fails_half_way_leaves_nothing(tmp_path, raised, message):
    with installed(tmp_path / "site", {"vfm_sdm.writers": {"half": "half:write"}}, {"half": HALF.format(raised)}):
        with pytest.raises(ResultsError, match=message):
            write_export("half", tmp_path / "run", example())
        assert list((tmp_path / "run").iterdir()) == []


def test_an_unknown_name_lists_the_known_ones(tmp_path):
    with pytest.raises(BackendUnavailableError, match=r"export: expected one of .*; did you mean 'mat'\?"):
        write_export("matlab", tmp_path, example())
