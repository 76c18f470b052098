"""Confusions on site and wrong lenses are named by what they are; what is right is not doubted."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import measurements as m
from simulation import project_all
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.geometry.camera import Rig
from vfm_sdm.geometry.structure_frame import structure_from_cam1
from vfm_sdm.inputs.session import Lens, Level, Session, View
from vfm_sdm.stages.cameras.culprits import Suspect, advise_on_lens
from vfm_sdm.stages.cameras.solution import CameraSolution

RIGHT = {"focal_std": 0.02, "focal_errors": (0.004, -0.006), "distortion_std": 0.0, "distortion_errors": (0.0, 0.0)}
RIGHT |= {"length_std": 0.003, "length_error": 0.0, "range_std": 0.01, "range_error": 0.0, "baseline_std": 0.005}
RIGHT |= {"baseline_error": 0.0, "perpendicular_std": 0.03, "face_offset_std": 0.03, "focal_px": 4000.0}
RIGHT |= {"level_std": 0.2, "roll": 2.0, "height": 2.5, "perpendicular_error": 0.01, "longitudinal_error": 0.02}
RIGHT |= {"longitudinal_std": 0.05, "level_errors": (0.05, -0.05)}


def solve(
    seed: int, misread: Callable[[Session], Session] = lambda session: session, *, films_swapped=False, **fixed
) -> CameraSolution:
    """Cameras of a site whose notes were misread, or whose recordings were exchanged."""
    rng, noise = (np.random.default_rng([seed, stream]) for stream in range(2))
    c = replace(m.draw_conditions(rng), **RIGHT | fixed)
    rig, frame, pitch = m._true_rig(c, noise)
    points3d = m._place_points(rig, frame, c, noise)
    clicked = project_all(rig, points3d) + noise.normal(0, 0.5, (2, len(points3d), 2))
    session = m._session(c, rig, points3d, clicked, pitch, "none")
    session = misread(session.model_copy(update={"view": (session.view[0], _levelled(session.view[1], rig, c, pitch))}))
    if films_swapped:
        rig, clicked = Rig.from_world(m.VIEWS, rig.cameras[::-1], metric=True), clicked[::-1]
    return m._solve(c, session, rig, clicked, noise)


def _levelled(view: View, rig: Rig, c: m.Conditions, pitch: float) -> View:
    """A further view with what its level shows."""
    axes = structure_from_cam1(0.0, pitch_rad=pitch, roll_rad=np.radians(c.roll)) @ rig.cameras[1].rotation.T
    pitch_deg, roll_deg = np.degrees([-np.arcsin(axes[1, 2]), np.arctan2(axes[1, 0], axes[1, 1])])
    level = Level(pitch_deg=float(pitch_deg), roll_deg=float(roll_deg), std_deg=c.level_std)
    return view.model_copy(update={"level": level})


def of_site(**changes: object) -> Callable[[Session], Session]:
    return lambda session: session.model_copy(update={"site": session.site.model_copy(update=changes)})


def swap_distances(session: Session) -> Session:
    site = session.site
    swapped = {"perpendicular_distance": site.longitudinal_distance}
    return of_site(**swapped, longitudinal_distance=site.perpendicular_distance)(session)


def turn_level(session: Session) -> Session:
    level = session.site.reference_camera_level
    changed = {"pitch_deg": -level.pitch, "roll_deg": -level.roll}
    return of_site(reference_camera_level=level.model_copy(update=changed))(session)


def in_unit(metres: float) -> Callable[[Session], Session]:
    def misread(session: Session) -> Session:
        baseline = session.site.baseline
        stated = {"value": baseline.value / metres, "std": baseline.std / metres}
        return of_site(baseline=baseline.model_copy(update=stated))(session)

    return misread


@pytest.mark.parametrize(
    ("misread", "name", "words"),
    [
        pytest.param(
            *(swap_distances, "distances of 'left'", "the other way round, do: exchange"), marks=pytest.mark.slow
        ),
        pytest.param(
            *(of_site(structure_side="left"), "side of the structure", "expected 'right', got 'left', do: correct"),
            marks=pytest.mark.slow,
        ),
        (turn_level, "signs of the level of 'left'", "do: correct the level"),
        (in_unit(1e-3), "baseline", "in millimetres, do: state it in metres"),
        pytest.param(in_unit(0.3048), "baseline", "in feet", marks=pytest.mark.slow),
    ],
)
def test_confusions_are_named_with_what_to_do(misread, name, words):
    solution = solve(1, misread)
    assert solution.status != CameraStatus.OK
    assert solution.suspects[0].name == name
    assert any(words in note for note in solution.notes if note.startswith("most probably wrong"))


@pytest.mark.slow
def test_exchanged_recordings_are_named():
    solution = solve(1, films_swapped=True)
    assert solution.suspects[0].name == "recordings of the two views"


@pytest.mark.parametrize("seed", [1, 2])
def test_right_statements_are_not_doubted(seed):
    solution = solve(seed)
    assert solution.status == CameraStatus.OK
    assert solution.suspects == ()


@pytest.mark.parametrize("errors", [(0.3, 0.0), pytest.param((0.0, -0.3), marks=pytest.mark.slow)])
@pytest.mark.slow
def test_one_wrong_lens_of_two_is_the_one_that_is_named(errors):
    wrong = int(np.argmax(np.abs(errors)))
    solution = solve(1, focal_errors=errors)
    assert solution.suspects[0].name == f"focal {m.VIEWS[wrong]}"
    assert solution.suspects[0].freed == pytest.approx(4000 * np.exp(-errors[wrong]), rel=0.03)


@pytest.mark.parametrize(
    ("lens", "freed", "words"),
    [
        (Lens(focal_mm=26.0, sensor_width_mm=6.17), 26 / 36 * 1920, "sensor_width_mm = 36"),
        (Lens(focal_mm=35.0, sensor_width_mm=36.0), 1.5 * 35 / 36 * 1920, "expected a sensor 24"),
        (Lens(focal_mm=35.0, sensor_width_mm=36.0), 1.2 * 35 / 36 * 1920, ""),
        (None, 1000.0, ""),
    ],
)
def test_focal_lengths_of_film_are_recognised(lens, freed, words):
    stated = 1400.0 if lens is None else lens.focal_prior_px(1920)
    advice = advise_on_lens(Suspect("focal left", "px", stated, freed, 5.0, drop=9.0, rank=81.0), lens)
    assert (words in advice) if words else not advice
