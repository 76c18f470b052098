"""Finished tracks of other programs: every form gives the motion that was written, and what does not fit is named."""

from unicodedata import normalize

import cv2
import numpy as np
import pytest
import xarray as xr

from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.errors import ResultsError, SessionError
from vfm_sdm.inputs.session import Method, Session, write_session
from vfm_sdm.inputs.tracks import read_foreign_tracks
from vfm_sdm.inputs.video import open_images
from vfm_sdm.measurement import Measurement
from vfm_sdm.outputs.results import write_movement
from vfm_sdm.stages.tracking.base import tracker_of

FRAMES, FPS = 12, 25.0
NAMES = ("mid", "pier, süd")
HOMES = np.array([[60.25, 40.5], [150.0, 80.75]])
STD = np.array([[0.02, 0.03], [0.04, 0.05]])
LOST, DOUBTFUL = (3, 0), (5, 1)
DICE = "SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA,GAMMA,BETA,STATUS_FLAG"
OPENCORR = "x,y,u,v,u0,v0,ZNCC,iteration,convergence,feature,exx,eyy,exy,subset_rx,subset_ry"


def motion():
    """Of both points, shape (T, P, 2) [px]."""
    phase = np.arange(FRAMES)[:, None, None] / 3
    return np.array([[1.5, -0.7], [0.3, 2.0]]) * np.sin(phase)


@pytest.fixture
def video(tmp_path):
    (tmp_path / "left [A]").mkdir()
    for number in range(FRAMES):
        assert cv2.imwrite(str(tmp_path / "left [A]" / f"{number}.png"), np.full((120, 200), 90, np.uint8))
    return open_images(str(tmp_path / "left [[]A[]]" / "*.png"), FPS)


def track(video, path, points=HOMES, **settings):
    method = Method(tracker="file", file={"left": str(path), **settings})
    return tracker_of(method).of_view("left").track(video, points, names=NAMES)


def write_table(path, *, clock="frame", gap=True):
    position = HOMES + motion()
    lines = [f"{clock},point,u,v,std_u,std_v,status"]
    for t in range(FRAMES):
        for p, name in enumerate(NAMES):
            if gap and (t, p) == LOST:
                continue
            status = "unreliable" if (t, p) == DOUBTFUL else "ok"
            stamp = t if clock == "frame" else t / FPS + 0.001
            u, v = position[t, p].tolist()
            lines.append(f'{stamp},"{name}",{u!r},{v!r},{STD[p, 0]},{STD[p, 1]},{status}')
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def check(tracks, *, std=STD, doubtful=True, names=NAMES):
    expected = HOMES + motion()
    expected[LOST] = np.nan
    np.testing.assert_allclose(tracks["position"].values, expected, atol=1e-9)
    status = np.zeros((FRAMES, 2))
    status[LOST] = Status.LOST
    status[DOUBTFUL] = Status.UNRELIABLE if doubtful else Status.OK
    np.testing.assert_array_equal(tracks["status"].values, status)
    known = np.sqrt(np.einsum("tpkk->tpk", tracks["position_covariance"].values))
    np.testing.assert_allclose(np.nanmedian(known, axis=0), np.broadcast_to(std, (2, 2)))
    np.testing.assert_allclose(tracks["time"].values, np.arange(FRAMES) / FPS)
    assert tracks["point"].values.tolist() == list(names)


@pytest.mark.parametrize("clock", ["frame", "time_s"])
def test_a_table(video, tmp_path, clock):
    check(track(video, write_table(tmp_path / "left.csv", clock=clock)))


def test_poses_that_this_package_wrote(video, tmp_path):
    position, covariance = HOMES + motion(), np.eye(2) * (STD**2)[None, :, None, :] + np.zeros((FRAMES, 2, 2, 2))
    status = np.zeros((FRAMES, 2), int)
    status[LOST], status[DOUBTFUL], position[LOST] = Status.LOST, Status.UNRELIABLE, np.nan
    tracks = make_tracks(np.arange(FRAMES) / FPS, NAMES, position, covariance, status, attrs={"view": "left"})
    (path,) = write_movement(tmp_path, {"left": tracks})
    check(track(video, path))


def test_poses_as_movement_writes_them(video, tmp_path):
    """Frames in place of seconds, other orders of dims and of space, no uncertainty but a confidence."""
    position = HOMES + motion()
    position[LOST] = np.nan
    confidence = np.full((FRAMES, 2), 0.9)
    confidence[DOUBTFUL] = 0.3
    poses = xr.Dataset(
        {
            "position": (("time", "individuals", "keypoints", "space"), position[:, None, :, ::-1]),
            "confidence": (("time", "keypoints", "individuals"), confidence[..., None]),
        },
        coords={"time": np.arange(FRAMES), "space": ["y", "x"], "keypoints": list(NAMES), "individuals": ["id_0"]},
        attrs={"ds_type": "poses", "time_unit": "frames"},
    )
    poses.to_netcdf(tmp_path / "poses.nc", engine="h5netcdf")
    check(track(video, tmp_path / "poses.nc"), std=0.05)


def write_dice(folder, *, first=0, offset=(0.3, -0.4)):
    folder.mkdir()
    moved = motion()
    for t in range(first, FRAMES):
        rows = [DICE]
        for p in range(2):
            sigma = -1.0 if (t, p) == LOST else STD[p, 0]
            (x, y), (u, v) = (HOMES[p] + offset).tolist(), moved[t, p].tolist()
            rows.append(f"{p},{x!r},{y!r},{u!r},{v!r},{sigma},0.01,0.0,4")
        rows.append(f"2,10.0,10.0,0.0,0.0,{STD[0, 0]},0.01,0.0,4")
        head = "***\n*** Digital Image Correlation Engine (DICe)\n***\n" if t % 2 else ""
        (folder / f"DICe_solution_{t}.txt").write_text(head + "\n".join(rows) + "\n")
    (folder / "DICe_solution_stats.txt").write_text("mean 1.0\n")


@pytest.mark.parametrize("first", [0, 1])
def test_dice(video, tmp_path, first):
    """With a table for the reference frame or without; the nearest subset's motion is the point's."""
    write_dice(tmp_path / "dice", first=first)
    check(track(video, tmp_path / "dice"), std=STD[:, :1], doubtful=False)


def test_opencorr(video, tmp_path):
    folder = tmp_path / "corr"
    folder.mkdir()
    moved = motion()
    for t in range(1, FRAMES):
        rows = [OPENCORR]
        for p in range(2):
            zncc = 0.2 if (t, p) == LOST else 0.7 if (t, p) == DOUBTFUL else 0.99
            (x, y), (u, v) = HOMES[p].tolist(), moved[t, p].tolist()
            rows.append(f"{x!r},{y!r},{u!r},{v!r},0,0,{zncc},3,0.001,0,0,0,0,16,16")
        (folder / f"frame_{t}_table.csv").write_text("\n".join(rows) + "\n")
    check(track(video, folder), std=0.05)
    check(track(video, folder, std_px=0.2), std=0.2)


def write_lines(path, *lines):
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("lines", "error", "message"),
    [
        (["a,b", "1,2"], ResultsError, "expected columns frame"),
        (["point,u,v", "mid,1,2"], ResultsError, "expected rows with a column frame or time_s"),
        (["frame,point,u,v", "0,mid,x,2"], ResultsError, "row 2: expected numbers in frame, u, v"),
        (["frame,point,u,v", "0,mid,1,2", "0,mid,1,2"], ResultsError, "expected one row a point and frame"),
        (["frame,point,u,v", "0.5,mid,1,2"], ResultsError, "expected whole numbers of frames"),
        (["frame,point,u,v", "1e300,mid,1,2"], ResultsError, r"expected whole numbers of frames .* got 1e\+300"),
        (["frame,point,u,v", ",mid,1,2"], ResultsError, "expected whole numbers of frames .* got nan"),
        (
            ["frame,point,u,v", "0,mid,60,25,40,5"],
            ResultsError,
            "row 2: expected 4 cells as in the head, got 6; write dec",
        ),
        (["frame,point,u,v,status", "0,mid,60,40"], ResultsError, "row 2: expected 5 cells as in the head, got 4"),
        (["frame,point,u,v,u", "0,mid,60,40,3"], ResultsError, "expected each column once, got frame, point, u, v, u"),
        (["frame,point,u,v", '0,"mid,60,40', "1,mid,60,40"], ResultsError, "look for a quote that is not closed"),
        (["frame;point;u;v", "0;mid;60,5;40,1"], ResultsError, "separated by commas, got 'frame;point;u;v'"),
        *(
            (
                ["frame,point,u,v,std", '0,"pier, süd",150,80,0', f"0,mid,{u},40,{std}"],
                SessionError,
                "expected positions within 1e.06 px, and standard deviations from 0",
            )
            for u, std in (("inf", "0"), ("60", "-0.1"), ("60", "inf"), ("60", "1e300"))
        ),
        (["frame,point,u,v", "1,mid,80,40", '0,"pier, süd",150,80'], SessionError, r"begin within 5 px.*mid \(19.8 px"),
        (["frame,point,u,v,status", "0,mid,1,2,good"], ResultsError, "expected a status of ok, lost"),
        (["frame,point,u,v", "0,mid,60,40"], SessionError, "expected points 'pier, süd', got 'mid'"),
        (["frame,point,u,v", "99,mid,60,40", '0,"pier, süd",1,1'], SessionError, "expected frames 0 to 11"),
        (["frame,point,u,v", "0,mid,80,40", '0,"pier, süd",150,80'], SessionError, r"begin within 5 px.*mid \(19.8 px"),
        (["time_s,point,u,v", "0.019,mid,60,40", '0.019,"pier, süd",150,80'], SessionError, "expected the times"),
    ],
)
def test_what_does_not_fit_is_named(video, tmp_path, lines, error, message):
    if "0.019" in lines[-1]:
        lines = [*lines, "0.061,mid,60,40", '0.0612,"pier, süd",150,80']
    with pytest.raises(error, match=message):
        track(video, write_lines(tmp_path / "left.csv", *lines))


def make_poses(**changed):
    position = np.moveaxis(HOMES + motion(), 2, 1)[..., None]
    made = xr.Dataset(
        {"position": (("time", "space", "keypoints", "individuals"), position)},
        coords={"time": np.arange(FRAMES), "space": ["x", "y"], "keypoints": list(NAMES), "individuals": ["id_0"]},
        attrs={"time_unit": "frames"},
    )
    return made.assign(changed)


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (make_poses().assign_coords(time=np.arange(FRAMES) - 3), "expected whole numbers of frames .* got -3"),
        (make_poses().assign_coords(time=np.arange(FRAMES) + 0.5), "expected whole numbers of frames .* got 0.5"),
        (make_poses().assign_coords(time=np.zeros(FRAMES)), "each once, got one of them twice"),
        (make_poses().assign_coords(keypoints=["mid", "mid"]), "expected each point once, got 'mid', 'mid'"),
        (make_poses().isel(time=slice(0)), "expected position .* with x and y alone"),
        (make_poses().isel(space=[0, 1, 0]).assign_coords(space=["x", "y", "z"]), "with x and y alone"),
        (make_poses(confidence=("time", np.ones(FRAMES))), "got .*, other confidence; write it"),
        (make_poses(position_std=(("time", "keypoints"), np.ones((FRAMES, 2)))), "got .*, other position_std"),
        (make_poses().astype(str), "got .*, other position; write it"),
    ],
)
def test_poses_that_do_not_fit_are_named(video, tmp_path, poses, message):
    poses.to_netcdf(tmp_path / "poses.nc", engine="h5netcdf")
    with pytest.raises(ResultsError, match=message):
        track(video, tmp_path / "poses.nc")


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_tables_in_other_letters_are_named(video, tmp_path, encoding):
    path = write_table(tmp_path / "left.csv")
    path.write_text(path.read_text(encoding="utf-8"), encoding=encoding)
    with pytest.raises(ResultsError, match=r"expected a table in UTF-8, got: .*; save it as CSV UTF-8"):
        track(video, path)


def test_letters_may_be_taken_apart_and_lines_end_as_on_windows(video, tmp_path):
    path = write_table(tmp_path / "left.csv")
    text = normalize("NFD", path.read_text(encoding="utf-8")).replace("\n", "\r\n")
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    check(track(video, path))


@pytest.mark.parametrize("spoil", [lambda path: path.unlink(), lambda path: path.write_text("x;y\n1,5;2,5\n")])
@pytest.mark.parametrize(
    ("number", "message"), [(5, "got none between DICe_solution_4.txt and "), (11, "another one is")]
)
def test_a_table_that_is_missing_moves_no_frames(video, tmp_path, spoil, number, message):
    """Eleven of twelve could be all but the first: every frame before the gap would be the next one's."""
    write_dice(tmp_path / "dice")
    spoil(tmp_path / "dice" / f"DICe_solution_{number}.txt")
    with pytest.raises((ResultsError, SessionError), match=message):
        track(video, tmp_path / "dice")


def test_tables_that_do_not_fit_are_named(video, tmp_path):
    write_dice(tmp_path / "dice", first=4)
    with pytest.raises(
        SessionError, match="expected a table for each of the 12 frames, or for all but the first, got 8"
    ):
        track(video, tmp_path / "dice")
    write_dice(tmp_path / "far", offset=(9.0, 0.0))
    with pytest.raises(SessionError, match=r"expected a subset within 5 px of every point, got none for mid \(9.0 px"):
        track(video, tmp_path / "far")
    table = tmp_path / "far" / "DICe_solution_3.txt"
    table.write_text(table.read_text().replace("2,10.0", "2,11.0"))
    with pytest.raises(ResultsError, match=r"DICe_solution_3.txt: expected the same subsets"):
        read_foreign_tracks(tmp_path / "far")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ResultsError, match="expected tables of DICe or OpenCorr, one a frame, got none"):
        read_foreign_tracks(tmp_path / "empty")
    xr.Dataset({"a": 1}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(ResultsError, match="expected position"):
        read_foreign_tracks(tmp_path / "other.nc")


@pytest.fixture
def session(video, tmp_path):
    write_table(tmp_path / "left.csv")
    write_dice(tmp_path / "dice")
    return Session(
        name="bridge",
        view=[{"name": view, "images": "left [[]A[]]/*.png", "fps": FPS} for view in ("left", "right")],
        point=[{"name": "mid", "view": "left", "pixel": HOMES[0].tolist()}],
        site={"baseline": {"value": 3.6, "std": 0.01}},
        method={"tracker": "file", "file": {"left": "left.csv", "right": "dice"}},
        folder=tmp_path,
    )


@pytest.mark.parametrize("changed", ["left.csv", "dice/DICe_solution_7.txt"])
def test_the_content_of_the_files_is_in_the_key(session, changed):
    before = Measurement(session).key("tracks")
    assert Measurement(session).key("tracks") == before
    path = session.folder / changed
    path.write_bytes(path.read_bytes() + b"\n")
    assert Measurement(session).key("tracks") != before


def test_the_files_move_with_the_session(session):
    written = write_session(session.folder / "run" / "session.resolved.toml", session).read_text(encoding="utf-8")
    assert 'left = "../left.csv"' in written
    assert 'right = "../dice"' in written


def test_missing_files_are_named_before_any_work(session):
    (session.folder / "left.csv").unlink()
    with pytest.raises(SessionError, match=r"method.file: expected files of tracks, got none at left: .*left.csv"):
        Measurement(session).check_method()


def test_a_view_without_a_file_is_named(tmp_path):
    tracker = tracker_of(Method(tracker="file"))
    with pytest.raises(SessionError, match="expected a file of tracks for view 'left'"):
        tracker.of_view("left")
