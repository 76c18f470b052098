"""A taped rectangle in the adjustment: what it tells of focal lengths, and that a wrong one is named."""

import numpy as np
import pytest

import scenes
from simulation import SIZE, project_all, site_trial
from vfm_sdm.inputs.session import Ratio, Rectangle, Site, read_session
from vfm_sdm.measurement import Measurement
from vfm_sdm.stages.cameras.site import adjust_to_site
from vfm_sdm.stages.cameras.site_values import SitePoint, SiteState, list_measured

CORNERS = np.array([[-2.0, -1.0, 0.0], [2.0, -1.0, 0.0], [2.0, 1.0, 0.0], [-2.0, 1.0, 0.0]])
TURN = np.radians(50.0)
TURNED = np.array([[np.cos(TURN), 0, np.sin(TURN)], [0, 1, 0], [-np.sin(TURN), 0, np.cos(TURN)]])


def adjusted(seed, aspect=None, *, focal_std=0.05, std_px=0.2, square_deg=0.2, length=None):
    """Relative error of both focal lengths, their standard deviations, and the adjustment."""
    rng = np.random.default_rng(seed)
    trial = site_trial(rng, focal_std=focal_std)
    pixels = project_all(trial.truth, CORNERS @ TURNED.T + [0.0, 0.0, 22.0])
    assert ((pixels > 0) & (pixels < SIZE)).all()
    pixels = pixels + rng.normal(0, std_px, pixels.shape)
    rectangle = Rectangle(
        points=("a", "b", "c", "d"),
        aspect=None if aspect is None else Ratio(value=aspect + rng.normal(0, 0.002), std=0.002),
        out_of_square_std_deg=square_deg,
    )
    site = Site(
        baseline={"value": trial.truth.baseline(), "std": 0.01},
        rectangle=() if aspect is None else (rectangle,),
        length=() if length is None else ({"points": ("a", "b"), "value": length, "std": 0.005},),
    )
    points = {name: SitePoint(pixels[:, index], std_px) for index, name in enumerate("abcd")}
    found = adjust_to_site(trial.prior, [trial.matches], site, points)
    pairs = zip(trial.truth.cameras, found.rig.cameras, strict=True)
    errors = np.array([np.log(b.focal_px / a.focal_px) for a, b in pairs])
    return errors, np.sqrt(np.diag(found.rig.covariance)[[0, 10]]), found


def test_a_taped_rectangle_narrows_the_focal_lengths_and_its_intervals_hold():
    scaled = []
    for seed in range(6):
        errors, stds, found = adjusted(seed, 2.0)
        _, without, _ = adjusted(seed)
        assert np.all(stds < 0.6 * without)
        assert not found.suspects
        scaled.append(errors / stds)
    assert 0.3 < np.sqrt(np.mean(np.square(scaled))) < 1.6


def test_a_wrong_aspect_is_named():
    _, _, found = adjusted(1, 2.2, focal_std=0.003, length=4.0)
    assert found.suspects[0].name == "rectangle 1: aspect"
    assert found.suspects[0].freed == pytest.approx(2.0, rel=0.04)


def test_a_rectangle_is_measured_as_it_is():
    points = dict(zip("abcd", CORNERS + np.array([0.0, 0.0, 9.0]), strict=True))
    trial = site_trial(np.random.default_rng(0))
    rectangle = Rectangle(points=("a", "b", "c", "d"), aspect=Ratio(value=2.0, std=0.01))
    state = SiteState(trial.truth, points, 0.0, 0.0, 9.0, None)
    values = {one.name: one.value for one in list_measured(state, Site(rectangle=(rectangle,)), {})}
    assert values["rectangle 1: aspect"] == pytest.approx(2.0)
    assert values["rectangle 1: right angle"] == pytest.approx(0.0, abs=1e-12)
    points["c"] = points["c"] + [0.1, 0.0, 0.0]
    points["d"] = points["d"] + [0.1, 0.0, 0.0]
    values = {one.name: one.value for one in list_measured(state, Site(rectangle=(rectangle,)), {})}
    assert abs(values["rectangle 1: right angle"]) == pytest.approx(
        np.degrees(np.arcsin(0.1 / np.hypot(2, 0.1))), rel=1e-3
    )
    points["d"] = points["d"] - [0.2, 0.0, 0.0]
    values = {one.name: one.value for one in list_measured(state, Site(rectangle=(rectangle,)), {})}
    assert values["rectangle 1: taper of its height"] == pytest.approx(np.degrees(0.1 / 2), rel=0.01)
    assert values["rectangle 1: taper of its width"] == pytest.approx(0.0, abs=1e-12)
    points["a"] = points["a"] + [0.0, 0.0, 0.2]
    values = {one.name: one.value for one in list_measured(state, Site(rectangle=(rectangle,)), {})}
    assert values["rectangle 1: flatness"] > 0.5


def test_corners_clicked_in_the_pictures_take_part(tmp_path):
    session = read_session(scenes.write_scene(tmp_path, frames=2))
    wide, high = np.array([0.6, 0.0, 0.12]), np.array([0.0, 0.4, 0.0])
    corners = np.array([-wide - high, wide - high, wide + high, high - wide]) + np.array([0.0, 0.0, scenes.DEPTH])
    rig = scenes.make_rig()
    pixels = {name: camera.project(corners).tolist() for name, camera in zip(rig.names, rig.cameras, strict=True)}
    aspect = float(np.linalg.norm(wide) / 0.4)
    rectangle = Rectangle(corners=pixels, std_px=0.5, aspect=Ratio(value=aspect, std=0.001))
    session = session.model_copy(update={"site": Site(rectangle=(rectangle,))})
    cameras = Measurement(session).cameras
    values = {one.name: one for one in cameras.quantities}
    assert values["rectangle 1: aspect"].value == pytest.approx(aspect, abs=0.001)
    assert abs(values["rectangle 1: right angle"].value) < 0.1
    assert not cameras.suspects


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, "expected either points or corners, got neither"),
        ({"points": ("a", "b", "c", "a")}, "expected four different ones"),
        ({"corners": {"left": ((0.0, 0.0),) * 4}}, "expected two views"),
    ],
)
def test_what_is_no_rectangle_is_refused(fields, expected):
    with pytest.raises(ValueError, match=expected):
        Rectangle(**fields)


def test_corners_without_names_are_numbered():
    rectangle = Rectangle(corners={"a": ((0.0, 0.0),) * 4, "b": ((0.0, 0.0),) * 4})
    assert rectangle.corner_names(2) == tuple(f"rectangle 2, corner {corner}" for corner in (1, 2, 3, 4))
