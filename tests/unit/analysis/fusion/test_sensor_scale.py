"""An accelerometer in place of the tape: what it says of a motion's length, and what the cameras make of that."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from simulation import SIZE, intrinsics, looking_at
from vfm_sdm.analysis.fusion.scale import SensorScale, find_contradiction, find_sensor_scale, first_session
from vfm_sdm.core.datasets import make_points
from vfm_sdm.core.statuses import CameraStatus
from vfm_sdm.errors import SessionError
from vfm_sdm.geometry.camera import Camera, Rig
from vfm_sdm.inputs.session import Measured, Point, Sensor, Session, View
from vfm_sdm.stages.cameras.site import adjust_to_site
from vfm_sdm.stages.cameras.solution import CameraSolution
from vfm_sdm.studies.synthetic.sensed_point import STATIC, SensedPoint, record_point

TURN_RAD = np.radians(20.0)
BASELINE_M, SIZE_OF_FIRST = 3.2, 0.7
"""And how large the first cameras see everything."""
WHAT = SensedPoint(duration_s=30.0, gain=1.004, clock_rate=1.0, lag_s=0.2)
NAMES = ("mid", *STATIC)


def make_rig(size=1.0, std=0.5):
    """Two cameras that look at a point 12 m away, whose distance from each other is all that is not known."""
    second = looking_at(np.array([BASELINE_M, 0.0, 0.0]), np.array([1.0, 0.0, 12.0]))
    second[:, 3] *= size
    covariance = np.zeros((20, 20))
    # The translation moves along itself only.
    covariance[17:, 17:] = std**2 * np.outer(second[:, 3], second[:, 3]) + 1e-14 * np.eye(3)
    cameras = Camera(intrinsics(1500.0), SIZE), Camera(intrinsics(1500.0), SIZE, cam_from_world=second)
    return Rig(("left", "right"), cameras, True, covariance)


@pytest.fixture(scope="module")
def first():
    """Cameras that see everything too small, and what is measured with them."""
    rig = make_rig(SIZE_OF_FIRST)
    places = SIZE_OF_FIRST * np.array([[0.5, 0.2, 11.0], [-2.0, 1.0, 12.0], [1.0, 1.0, 14.0], [2.5, -1.0, 13.0]])
    pixels = np.stack([camera.project(places) for camera in rig.cameras])
    points = make_points(
        rig.names, NAMES, position=pixels, position_std=0 * pixels, status=np.full((2, 4), "ok", object)
    )
    displacement, acceleration, _ = record_point(WHAT, 4)
    scaled = displacement.assign(
        {name: SIZE_OF_FIRST * displacement[name] for name in ("displacement", "displacement_std")}
    )
    for name in ("displacement", "displacement_std"):
        scaled[name].attrs["units"] = "mm"
    return CameraSolution(rig, None, None, points), scaled, acceleration


def write_phone(folder, time_s, values):
    rows = zip(time_s, values, strict=True)
    lines = ["time,lateral,vertical", *(f"{t:.6f},{a[0]:.6f},{a[1]:.6f}" for t, a in rows)]
    (folder / "phone.csv").write_text("\n".join(lines))


@pytest.fixture(scope="module")
def session(tmp_path_factory, first):
    acceleration, tmp_path = first[2], tmp_path_factory.mktemp("site")
    # The phone lies askew, about the structure's longitudinal axis: one of its axes would say the cosine of that.
    turn = np.array([[np.cos(TURN_RAD), -np.sin(TURN_RAD)], [np.sin(TURN_RAD), np.cos(TURN_RAD)]])
    write_phone(tmp_path, acceleration["time"].values, acceleration["acceleration"].values[:, 0] @ turn)
    sensor = {"name": "phone", "file": "phone.csv", "point": "mid", "units": "m/s2"}
    return Session(
        name="site",
        folder=tmp_path,
        view=[{"name": name, "video": f"{name}.mp4"} for name in ("left", "right")],
        point=[{"name": n, "view": "left", "pixel": [9.0, 9.0], "static": n in STATIC} for n in NAMES],
        sensor=[{**sensor, "use_as_scale": True, "scale_std": 0.01}],
    )


@pytest.fixture(scope="module")
def scale(session, first):
    cameras, displacement, _ = first
    return find_sensor_scale(session, lambda _: (cameras, displacement))


def test_the_phone_replaces_the_tape(session, scale):
    [motion] = scale.motion
    assert motion.std / motion.length < 0.015
    assert scale.baseline.value == pytest.approx(BASELINE_M, rel=3 * motion.std / motion.length)
    adjusted = adjust_to_site(make_rig(0.8), (), scale.put_into(session).site)
    found = adjusted.rig.baseline()
    relative = np.sqrt(
        adjusted.rig.cameras[1].translation @ adjusted.covariance[17:20, 17:20] @ adjusted.rig.cameras[1].translation
    )
    relative /= found**2
    assert relative < 0.015
    assert abs(found / BASELINE_M - 1) < 2.5 * relative
    told = {one.name: one for one in adjusted.quantities}
    assert told["motion of mid by sensor phone"].measured
    assert "motion of mid by sensor phone" in {one.source for one in adjusted.contributions}


def test_a_tape_that_contradicts_the_sensor_is_named(session, scale):
    scale = replace(scale, baseline=None)
    wrong = Measured(value=1.15 * BASELINE_M, std=0.01)
    site = scale.put_into(session).site.model_copy(update={"baseline": wrong})
    adjusted = adjust_to_site(make_rig(), (), site)
    assert adjusted.status == CameraStatus.DISAGREE
    said = " ".join(adjusted.notes)
    assert "baseline" in said
    assert "motion of mid by sensor phone" in said


def test_a_sensor_at_rest_tells_no_length(session, first, tmp_path):
    cameras, displacement, acceleration = first
    quiet = 1e-3 * np.random.default_rng(0).normal(size=(acceleration.sizes["time"], 2))
    write_phone(tmp_path, acceleration["time"].values, quiet)
    session = session.model_copy(update={"folder": tmp_path})
    scale = find_sensor_scale(session, lambda _: (cameras, displacement))
    assert scale.motion == ()
    assert "tells no length" in scale.notes[0]
    lost = scale.judge(cameras)
    assert lost.rig is None
    assert lost.status == CameraStatus.NO_LENGTH
    # A tape would do.
    assert replace(scale, baseline=None).judge(cameras).rig is cameras.rig


@pytest.mark.parametrize(("factor", "read"), [(1 / 9.80665, "1.00"), (0.7, "6.86"), (9.80665, "96.1")])
def test_a_sensor_in_other_units_tells_no_length(session, first, tmp_path, factor, read):
    cameras, displacement, acceleration = first
    write_phone(tmp_path, acceleration["time"].values, factor * acceleration["acceleration"].values[:, 0])
    scale = find_sensor_scale(session.model_copy(update={"folder": tmp_path}), lambda _: (cameras, displacement))
    assert scale.motion == ()
    assert f"tells no length: it reads {read}" in scale.notes[0]


def fusion(*, sizes=(1.0, 1.0), scatter=1.0, agree=1):
    """What a fusion says of the sensor along two axes, known to 1 %."""
    axes, names = ("lateral", "vertical"), ("size", "size_std", "stated_ratio", "bands_agree")
    values = np.transpose([(size, 0.01 * size, scatter, agree) for size in sizes])
    return {a: xr.Dataset({n: v[i] for n, v in zip(names, values, strict=True)}) for i, a in enumerate(axes)}


@pytest.mark.parametrize(
    ("found", "said"),
    [
        ({}, ""),
        ({"sizes": (1.0, 1.04)}, ""),
        ({"sizes": (1.0, 0.7)}, "the video over it is 1.43 times as large along lateral as along vertical"),
        ({"scatter": 3.0}, "along lateral the video scatters 3.0 times as much"),
        ({"agree": 0}, "along lateral its motion has another size at some frequencies"),
    ],
)
def test_a_sensor_that_saw_another_motion_contradicts_itself(found, said):
    by_axis = fusion(**found)
    sizes = {axis: float(one["size"]) for axis, one in by_axis.items()}
    answer = find_contradiction(by_axis, sizes, dict.fromkeys(sizes, 0.01))
    assert answer.startswith(said) if said else answer == ""


def test_a_session_without_such_a_sensor_is_not_measured_twice(session):
    plain = session.model_copy(update={"sensor": ()})
    scale = find_sensor_scale(plain, lambda _: pytest.fail("measured"))
    assert scale == SensorScale()
    assert scale.put_into(plain).site == plain.site


def test_the_first_measurement_has_the_sensors_points_and_what_is_static(session):
    more = session.model_copy(update={"point": (*session.point, Point(name="end", view="left", pixel=(5.0, 5.0)))})
    first = first_session(more)
    assert [point.name for point in first.point] == list(NAMES)
    assert first.sensor == ()
    assert first.site.baseline is not None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"scale_std": None}, "scale_std: expected how well"),
        ({"point": None}, "point: expected the point that it sits at"),
        ({"units": "mm"}, "units: expected those of acceleration"),
        ({"units": None}, "units: expected those of acceleration"),
        ({"use_as_scale": False}, "expected use_as_scale = true beside it"),
    ],
)
def test_nonsense_is_refused(changes, said):
    fields = {"name": "a", "file": "a.csv", "point": "mid", "units": "g", "use_as_scale": True, "scale_std": 0.01}
    with pytest.raises(ValueError, match=said):
        Sensor(**{key: value for key, value in {**fields, **changes}.items() if value is not None})


def test_a_static_point_and_a_single_view_tell_no_length(session):
    fields = {"view": [View(name="left", video="a.mp4")], "point": session.point}
    sensor = {**session.sensor[0].model_dump(exclude_none=True), "point": STATIC[0]}
    with pytest.raises(SessionError, match=r"(?s)expected a point that moves.*expected two views, got one"):
        Session(name="site", sensor=[sensor], **fields)


def test_sessions_without_it_are_written_as_before():
    plain = Sensor(name="a", file="a.csv")
    assert "use_as_scale" not in plain.model_dump()
    assert "scale_std" not in plain.model_dump()
