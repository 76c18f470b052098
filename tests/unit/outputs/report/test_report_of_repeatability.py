"""Repeatability in a report: what it shows is what its file holds, and a result of another displacement says so."""

import pytest

from run_folders import write_run
from vfm_sdm.analysis.repeatability import RepeatedRun, compare_runs, write_repeatability
from vfm_sdm.core.netcdf import read_displacement
from vfm_sdm.outputs.report import write_report


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("repeated")
    write_run(folder, moving=2)
    here = read_displacement(folder)
    other = here.copy(deep=True)
    other["displacement"].values[:] *= 1.2
    runs = [RepeatedRun("one", "Anna & <b>", here, {}), RepeatedRun("two", "Ben", other, {})]
    result = compare_runs(runs)
    write_repeatability(folder, result)
    return folder, result


@pytest.mark.parametrize(("language", "title"), [("en", "Repeatability and"), ("de", "Wiederhol- und")])
def test_it_stands_in_the_report(run, tmp_path, language, title):
    folder, result = run
    path, *_ = write_report(folder, tmp_path / "r.html", language=language)
    text = path.read_text(encoding="utf-8")
    assert title in text
    assert "Anna &amp; &lt;b&gt;" in text
    spread = float(result["reproducibility"].sel(quantity="peak_to_peak", point="p0", axis="vertical"))
    assert f"{spread:.3f}".replace(".", "," if language == "de" else ".") in text
    assert "vfm-sdm repeat" not in text


def test_a_result_of_another_displacement_says_so(run, tmp_path):
    folder, result = run
    write_repeatability(folder, result.assign_attrs(displacement_key="of before"))
    path, *_ = write_report(folder, tmp_path / "r.html")
    assert "run `vfm-sdm repeat` again before it is used" in path.read_text(encoding="utf-8")
