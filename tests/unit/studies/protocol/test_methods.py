"""Which methods the protocol compares, and why some cannot run."""

import re

import pytest

from vfm_sdm.studies.protocol.methods import MONOCULAR, WITH_SGR, WITHOUT_SGR, ComparedMethod, comparisons, why_not


def test_the_paper_s_four_comparisons():
    found = {comparison.name: comparison for comparison in comparisons()}
    assert list(found) == ["refinement", "baseline", "cameras", "trackers"]
    assert found["refinement"].methods == (WITHOUT_SGR, WITH_SGR)
    assert found["baseline"].methods == (WITH_SGR, MONOCULAR)
    # One camera that looks obliquely measures the vertical direction only.
    assert found["baseline"].axes == ("vertical",)
    assert all(found[name].axes == ("vertical", "lateral") for name in ("refinement", "cameras", "trackers"))
    for comparison in found.values():
        labels = [method.label for method in comparison.methods]
        assert len(set(labels)) == len(labels)


def test_cameras_and_trackers_are_compared_without_refinement_and_one_at_a_time():
    found = {comparison.name: comparison.methods for comparison in comparisons()}
    assert {(m.tracker, m.refinement) for m in found["cameras"]} == {("icgn", "none")}
    assert {(m.cameras, m.refinement) for m in found["trackers"]} == {("two-view", "none")}
    assert {m.cameras for m in found["cameras"]} == {"two-view", "file", "chessboard", "vggt", "posediffusion", "sfm"}
    assert {m.tracker for m in found["trackers"]} == {"icgn", "template", "vggt", "tapir", "vggt+icgn"}


def test_refinements_share_cameras_and_tracks_and_nothing_else_does():
    assert WITH_SGR.run_name == WITHOUT_SGR.run_name == "icgn+two-view"
    assert (WITH_SGR.refinement, WITHOUT_SGR.refinement) == ("sgr", "none")
    others = {ComparedMethod("", tracker="template").run_name, ComparedMethod("", cameras="file").run_name}
    assert len({WITH_SGR.run_name, *others}) == 3


@pytest.mark.parametrize(
    "method",
    [WITH_SGR, WITHOUT_SGR, MONOCULAR, ComparedMethod("", tracker="template"), ComparedMethod("", cameras="file")],
)
def test_what_needs_no_weights_can_run(method):
    assert why_not(method) is None


@pytest.mark.parametrize(
    ("method", "reason"),
    [
        (ComparedMethod("", cameras="chessboard"), "the field tests hold no pictures of a chessboard"),
        (
            ComparedMethod("", cameras="none such"),
            "cameras: expected one of .*, got 'none such'; choose one of these, .*",
        ),
        (
            ComparedMethod("", tracker="none such"),
            "tracker: expected one of .*, got 'none such'; choose one of these, .*",
        ),
        # Only the paper's baseline itself needs no rig.
        (ComparedMethod("another", tracker="template", cameras=MONOCULAR.cameras), "cameras: expected one of .*"),
        (ComparedMethod("", tracker="vggt"), ".*(weights fetch vggt-1b`|PyTorch, got none; .*)"),
        (ComparedMethod("", cameras="vggt"), ".*(weights fetch vggt-1b`|PyTorch, got none; .*)"),
        (
            ComparedMethod("", cameras="posediffusion"),
            ".*(weights fetch posediffusion-co3d`|PyTorch, got none; .*)",
        ),
        (ComparedMethod("", tracker="tapir+icgn"), ".*(weights fetch bootstapir`|PyTorch, got none; .*)"),
    ],
)
def test_what_cannot_run_says_why(method, reason):
    assert re.fullmatch(reason, why_not(method))


def test_the_reason_is_that_of_the_back_end(monkeypatch):
    reasons = {("trackers", "icgn"): "expected weights, got none; install them"}
    monkeypatch.setattr(
        "vfm_sdm.studies.protocol.methods.why_unavailable", lambda kind, name: reasons.get((kind, name))
    )
    assert why_not(WITH_SGR) == "expected weights, got none; install them"
    assert why_not(MONOCULAR) is None
    reasons = {("cameras", "sfm"): "expected pycolmap"}
    assert why_not(ComparedMethod("", cameras="sfm")) == "expected pycolmap"
