"""Recordings tracked segment by segment: as good as in one piece, by whomever, and whole but for what failed."""

import gc
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from drifting_plate import FPS, POINTS, SIZE, motion, pictures, write_film
from moving_frames import memory_video
from vfm_sdm.core.block_files import JoinedBlocks
from vfm_sdm.core.datasets import Status, make_tracks
from vfm_sdm.core.executors import ProcessWorkers
from vfm_sdm.core.netcdf import write_tracks
from vfm_sdm.core.pieces import Pieces
from vfm_sdm.errors import VideoError
from vfm_sdm.inputs.video import open_video
from vfm_sdm.stages.tracking.base import Targets
from vfm_sdm.stages.tracking.icgn import IcgnTracker
from vfm_sdm.stages.tracking.segments import Work, join_records, plan_segments, read_pass, track_segment
from vfm_sdm.stages.tracking.subset_design import design_subsets
from vfm_sdm.stages.tracking.template import TemplateTracker
from vfm_sdm.stages.tracking.views import is_whole, track_views

FRAMES = 100
HOME = np.array(list(POINTS.values()))


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    return write_film(tmp_path_factory.mktemp("plate") / "plate.mp4", pictures(motion(FRAMES)))


@pytest.fixture(scope="module")
def processes():
    with ProcessWorkers(2) as workers:
        yield workers


def as_points(places, views=("cam",)):
    names = [f"p{number}" for number in range(len(places))]
    position = np.broadcast_to(np.asarray(places, float), (len(views), len(places), 2))
    return xr.Dataset(
        {"position": (("view", "point", "pixel"), position)},
        coords={"view": list(views), "point": names, "pixel": ["u", "v"]},
    )


def track(film, *, segment_s=1.0, tracker=None, places=HOME, **work):
    tracker = tracker or IcgnTracker(subset_px=31)
    return track_views({"cam": open_video(film)}, as_points(places), tracker, work=Work(segment_s, **work))["cam"]


def errors(tracks, moved, places=HOME):
    """Errors (T, P, 2) [px] against the truth."""
    return tracks["position"].values - (np.asarray(places)[None] + moved[:, None])


def bits(tmp_path, tracks):
    return write_tracks(tmp_path, {"cam": tracks}).read_bytes()


def moved_by(u):
    return np.stack([np.asarray(u, float), np.zeros(len(u))], axis=1)


class FailsAt(Executor):
    """Works at once; the segment that begins with a frame never gets done. Counts who tried what."""

    workers = 1

    def __init__(self, first=None):
        self.first, self.tried = first, []

    def submit(self, fn, /, *args, **kwargs):
        future, task = Future(), args[0]
        self.tried.append(task.first)
        if task.first == self.first:
            future.set_exception(OSError(f"no memory for {task.first}"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


class TestAgainstOnePiece:
    def test_a_film_in_segments_is_tracked_as_well_as_in_one_piece(self, film):
        whole, cut = track(film, segment_s=60.0), track(film)
        assert (whole.attrs["recording"]["segments"], cut.attrs["recording"]["segments"]) == (1, 10)
        assert (cut["status"].values == Status.OK).all()
        np.testing.assert_allclose(cut["position"], whole["position"], atol=1e-3)
        np.testing.assert_allclose(cut["position_covariance"], whole["position_covariance"], rtol=0.02, atol=1e-8)
        np.testing.assert_array_equal(cut["time"], whole["time"])
        # 1.5 grey levels of noise and the compression of a film of high quality allow about 0.01 px.
        found, expected = errors(cut, motion(FRAMES)), errors(whole, motion(FRAMES))
        assert np.abs(found).max() < 0.05
        assert np.sqrt((found**2).mean()) == pytest.approx(np.sqrt((expected**2).mean()), rel=0.01)
        for name in ("frames", "duplicated", "dropped", "status", "message", "alike", "untracked"):
            assert cut.attrs["recording"][name] == whole.attrs["recording"][name]

    def test_longer_segments_and_other_trackers(self, film):
        template = TemplateTracker(subset_px=31)
        whole = track(film, segment_s=60.0, tracker=template)
        for segment_s, count in ((1.0, 10), (2.5, 4)):
            cut = track(film, segment_s=segment_s, tracker=template)
            assert cut.attrs["recording"]["segments"] == count
            xr.testing.assert_identical(cut.drop_attrs(), whole.drop_attrs())
        found = track(film, segment_s=2.5)
        assert found.attrs["recording"]["segments"] == 4
        assert np.abs(errors(found, motion(FRAMES))).max() < 0.05

    def test_designed_subsets(self, film):
        names = [f"p{number}" for number in range(len(HOME))]
        choices = dict(zip(names, design_subsets(open_video(film), HOME, names), strict=True))
        found = {}
        for segment_s in (60.0, 1.0):
            work, videos = Work(segment_s), {"cam": open_video(film)}
            tracks = track_views(videos, as_points(HOME), IcgnTracker(), subsets={"cam": choices}, work=work)
            found[segment_s] = tracks["cam"]
        np.testing.assert_allclose(found[1.0]["position"], found[60.0]["position"], atol=1e-3)
        assert found[1.0]["subset_px"].equals(found[60.0]["subset_px"])
        # Strips are measured in other frames, and a robust scale of some 18 samples is known to a quarter: three
        # standard deviations of the difference are 1.
        np.testing.assert_allclose(found[1.0]["part_noise"], found[60.0]["part_noise"], rtol=1.0)
        assert np.abs(errors(found[1.0], motion(FRAMES))).max() < 0.05

    def test_a_view_without_points_has_its_clock(self, film):
        points = as_points(HOME)
        points["position"] = points["position"] * np.nan
        found = track_views({"cam": open_video(film)}, points, IcgnTracker(), work=Work(1.0))["cam"]
        assert (found["status"].values == Status.LOST).all()
        np.testing.assert_allclose(found["time"], np.arange(FRAMES) / FPS, atol=1e-9)
        assert found.attrs["recording"]["segments"] == 10


class TestSameBits:
    @pytest.mark.slow
    def test_whoever_works_and_whether_it_is_kept(self, processes, tmp_path):
        film = write_film(tmp_path / "short.mp4", pictures(motion(40)))
        names = ["p0", "p1"]
        choices = dict(zip(names, design_subsets(open_video(film), HOME[:2], names), strict=True))
        written = {}
        with ThreadPoolExecutor(2) as threads:
            for label, executor in (("none", None), ("processes", processes), ("threads", threads)):
                for pieces in (None, Pieces(tmp_path / label / "tracks", "key")):
                    tracks = track_views(
                        {"cam": open_video(film)},
                        as_points(HOME[:2]),
                        IcgnTracker(),
                        subsets={"cam": choices},
                        work=Work(1.0, executor, pieces),
                    )
                    assert tracks["cam"].attrs["recording"]["segments"] == 4
                    written[label, pieces is None] = write_tracks(tmp_path, tracks).read_bytes()
        assert [key for key, one in written.items() if one != written["none", True]] == []

    def test_one_process(self, film, processes, tmp_path):
        with ProcessWorkers(1) as one:
            found = [bits(tmp_path, track(film, segment_s=5.0, executor=each)) for each in (None, one, processes)]
        assert len(set(found)) == 1

    def test_in_one_piece_too(self, film, processes, tmp_path):
        tracks = [track(film, segment_s=60.0, executor=executor) for executor in (None, processes)]
        kept = track(film, segment_s=60.0, pieces=Pieces(tmp_path / "tracks", "key"))
        assert len({bits(tmp_path, one) for one in (*tracks, kept)}) == 1

    def test_of_the_template(self, film, processes, tmp_path):
        tracker = TemplateTracker(subset_px=31)
        assert len({bits(tmp_path, track(film, tracker=tracker, executor=one)) for one in (None, processes)}) == 1


class TestStarts:
    def test_a_point_that_is_covered_as_a_segment_begins_is_taken_up_again(self, tmp_path):
        moved = motion(FRAMES)
        lumas = pictures(moved)
        for number in range(37, 45):  # the key frame 40 among them
            u, v = np.rint(HOME[1] + moved[number]).astype(int)
            lumas[number][v - 24 : v + 25, u - 24 : u + 25] = 60
        found = track(write_film(tmp_path / "covered.mp4", lumas))
        status = found["status"].values
        seen = status[:, 1] == Status.OK
        assert not seen[37:45].any()
        assert seen[:36].all()
        assert seen[46:].all()
        assert (status[:, [0, 2, 3]] == Status.OK).all()
        assert np.nanmax(np.abs(errors(found, moved)[:36])) < 0.05
        assert np.nanmax(np.abs(errors(found, moved)[46:])) < 0.05

    def test_a_point_that_moves_further_than_it_is_searched(self, tmp_path):
        moved = moved_by(60 * np.sin(2 * np.pi * np.arange(FRAMES) / FPS / 4))
        assert np.abs(np.diff(moved[::FPS, 0])).max() > 55  # the search radius is 40 px
        places = [[160.0, 100.0], [170.0, 150.0]]
        film = write_film(tmp_path / "far.mp4", pictures(moved))
        whole = track(film, segment_s=60.0, places=places)
        for segment_s in (1.0, 3.0):
            cut = track(film, segment_s=segment_s, places=places)
            assert cut.attrs["recording"]["segments"] > 1
            assert (cut["status"].values == Status.OK).all()
            np.testing.assert_allclose(cut["position"], whole["position"], atol=1e-3)

    def test_what_looks_like_a_point_is_not_taken_for_it(self, tmp_path):
        # Equal dots 60 px apart that swing by 35: as a segment begins, the neighbour may be nearer than the point.
        moved = moved_by(35 * np.sin(2 * np.pi * np.arange(FRAMES) / FPS / 3.3))
        rows, columns = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
        rng, lumas = np.random.default_rng(3), []
        for u, _ in moved:
            across = (columns - 160 - u + 30) % 60 - 30
            dots = 60 + 150 / (1 + np.exp((np.hypot(across, rows - 120) - 12) / 0.8))
            lumas.append(np.clip(np.rint(dots + rng.normal(0, 1.5, SIZE)), 16, 235).astype(np.uint8))
        film = write_film(tmp_path / "dots.mp4", lumas)
        for places in ([[160.0, 120.0]], [[160.0, 120.0], [220.0, 120.0]]):
            found = track(film, places=places)
            wrong = np.abs(np.nan_to_num(errors(found, moved, places))).max(axis=2) > 1
            assert not (wrong & (found["status"].values == Status.OK)).any()
            assert not wrong.any(axis=1).all()

    def test_a_point_that_left_the_picture_comes_back(self, tmp_path):
        moved = moved_by(-55 * np.sin(np.pi * np.arange(FRAMES) / (FRAMES - 1)))
        places = [[60.0, 120.0], [200.0, 100.0]]
        film = write_film(tmp_path / "left.mp4", pictures(moved))
        found = track(film, places=places)
        status = found["status"].values
        gone = places[0][0] + moved[:, 0] < 12
        assert (status[gone, 0] == Status.OUTSIDE).all()
        assert (status[[0, 10, -10, -1], 0] == Status.OK).all()
        assert (status[:, 1] == Status.OK).all()
        good = status == Status.OK
        assert np.abs(errors(found, moved, places)[good]).max() < 0.1


class TestLongRecordings:
    @pytest.fixture
    def long(self, monkeypatch):
        """Whatever is tracked is too long for memory."""
        monkeypatch.setattr("vfm_sdm.core.block_files.LONG_BYTES", 1)
        monkeypatch.setattr("vfm_sdm.stages.tracking.views.LONG_BYTES", 1)
        monkeypatch.setattr("vfm_sdm.core.block_files._BLOCK", 17)

    @pytest.mark.parametrize("segment_s", [1.0, 60.0])
    def test_tracks_in_a_file_are_those_in_memory(self, film, tmp_path, request, segment_s):
        in_memory = track(film, segment_s=segment_s)
        request.getfixturevalue("long")
        found = track(film, segment_s=segment_s, pieces=Pieces(tmp_path / "tracks", "key"), folder=tmp_path)
        assert len(list(tmp_path.glob(".scratch-*"))) == 1
        assert not found["position"]._in_memory
        assert set(found.variables) == set(in_memory.variables)
        xr.testing.assert_identical(found.load()[list(in_memory.variables)], in_memory)
        found.close()
        del found
        gc.collect()
        assert not list(tmp_path.glob(".scratch-*"))


class TestFailures:
    def test_a_segment_that_fails_is_named_and_tried_again_alone(self, film, tmp_path):
        pieces = Pieces(tmp_path / "tracks", "key")
        whole = track(film)
        fails = FailsAt(40)
        found = track(film, executor=fails, pieces=pieces)
        assert fails.tried.count(40) == 3
        assert sorted(set(fails.tried)) == list(range(0, FRAMES, FPS))
        assert len(fails.tried) == 12
        recording = found.attrs["recording"]
        assert recording["untracked"] == [[4.0, 5.0]]
        assert recording["doubts"] == ["not tracked from 4 s to 5 s: no memory for 40; run again to try it once more"]
        assert not is_whole({"cam": found})
        np.testing.assert_array_equal(found["time"], np.delete(whole["time"].values, slice(40, 50)))
        kept = np.delete(np.arange(FRAMES), slice(40, 50))
        np.testing.assert_array_equal(found["position"], whole["position"].values[kept])
        again = FailsAt()
        after = track(film, executor=again, pieces=pieces)
        assert again.tried == [40]
        assert is_whole({"cam": after})
        assert bits(tmp_path, after) == bits(tmp_path, whole)

    def test_the_last_segment_ends_with_the_recording(self, film):
        found = track(film, executor=FailsAt(90))
        assert found.attrs["recording"]["untracked"] == [[9.0, None]]
        assert "not tracked from 9 s to the end: no memory for 90" in found.attrs["recording"]["doubts"][0]

    def test_where_all_fail_the_first_error_is_raised(self, film):
        class Fails(FailsAt):
            def submit(self, fn, /, *args, **kwargs):
                self.first = args[0].first
                return super().submit(fn, *args, **kwargs)

        with pytest.raises(OSError, match=r"no memory for 0$"):
            track(film, executor=Fails())

    def test_a_recording_that_is_gone_is_named(self, film, tmp_path):
        copy = tmp_path / "gone.mp4"
        copy.write_bytes(film.read_bytes())
        video = open_video(copy)
        tracker, targets = IcgnTracker(subset_px=31), Targets(HOME, tuple("abcd"))
        plan = plan_segments(video, tracker, targets, 1.0)
        copy.unlink()
        with pytest.raises(VideoError, match="expected a video file, got nothing of that name"):
            track_segment(plan[3])

    def test_damaged_and_other_pieces_are_tracked_again(self, film, tmp_path):
        folder = tmp_path / "tracks"
        whole = track(film, pieces=Pieces(folder, "key"))
        (folder / "0" / "0003.npz").write_bytes(b"half")
        (folder / "0" / "0007.npz").unlink()
        counts = FailsAt()
        assert bits(tmp_path, track(film, executor=counts, pieces=Pieces(folder, "key"))) == bits(tmp_path, whole)
        assert counts.tried == [30, 70]
        counts = FailsAt()
        track(film, executor=counts, pieces=Pieces(folder, "another"))
        assert len(counts.tried) == 10


class TestProgress:
    def count(self, film, **work):
        said = []
        track_views(
            {"cam": open_video(film)},
            as_points(HOME),
            IcgnTracker(subset_px=31),
            progress=lambda what, done, total: said.append((what, done, total)),
            work=Work(1.0, **work),
        )
        assert {what for what, _, _ in said} == {"tracking cam"}
        assert {total for _, _, total in said} == {FRAMES}
        return [done for _, done, _ in said]

    @pytest.mark.parametrize("processors", [1, 3])
    def test_frames_are_counted_through_all_segments(self, film, tmp_path, monkeypatch, processors):
        monkeypatch.setattr("os.cpu_count", lambda: processors)
        assert self.count(film) == list(range(1, FRAMES + 1))
        assert self.count(film, executor=FailsAt()) == list(range(FPS, FRAMES + 1, FPS))
        pieces = Pieces(tmp_path / "tracks", "key")
        track(film, executor=FailsAt(40), pieces=pieces)
        assert self.count(film, executor=FailsAt(), pieces=pieces) == [FRAMES]

    @pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt])
    @pytest.mark.parametrize("processors", [1, 3])
    def test_who_is_told_can_end_the_work(self, film, tmp_path, monkeypatch, processors, kind):
        """An error of progress counted as one of the segment, and the next one began."""
        monkeypatch.setattr("os.cpu_count", lambda: processors)

        def tell(what, done, total):
            said.append(done)
            if done > 40:
                raise kind("enough")

        said: list[int] = []
        pieces = Pieces(tmp_path, "key")
        work = Work(1.0, pieces=pieces)
        with pytest.raises(kind, match="enough"):
            track_views({"cam": open_video(film)}, as_points(HOME), IcgnTracker(subset_px=31), progress=tell, work=work)
        assert said[-1] <= 60
        assert processors > 1 or pieces.read(0, 0) is not None


class Still:
    """A tracker of someone else, whose points never move; it need not look at the frames."""

    name = "still"

    def __init__(self, looks):
        self.looks = looks

    def track(self, video, points2d, *, names, reference_frame=0, progress=None):
        count = sum(1 for _ in video.frames()) if self.looks else video.info.frame_count
        position = np.tile(points2d, (count, 1, 1))
        covariance = np.tile(1e-4 * np.eye(2), (count, len(names), 1, 1))
        status = np.zeros((count, len(names)), int)
        return make_tracks(np.arange(count) / FPS, names, position, covariance, status, attrs={"tracker": "still"})


@pytest.mark.parametrize("looks", [True, False])
def test_other_trackers_see_the_recording_as_a_whole(film, looks):
    found = track(film, tracker=Still(looks))
    recording = found.attrs["recording"]
    assert recording["segments"] == 1
    assert recording["status"] == ("ok" if looks else "not read")
    assert any("tracked in one piece of 10 s: still needs the whole recording" in one for one in recording["remarks"])
    assert set(found.data_vars) == {"position", "position_covariance", "status", "scatter"}
    assert not any(str(name).startswith("pass") for name in found.attrs)


def test_what_has_no_key_frames_stays_in_one_piece_and_says_so(tmp_path):
    film = write_film(tmp_path / "one.mp4", pictures(motion(30)), key_every=1000)
    found = track(film)
    assert found.attrs["recording"]["segments"] == 1
    said = "tracked in one piece of 3 s: no frames at which it can be divided"
    assert said in found.attrs["recording"]["remarks"]
    short = track(film, segment_s=2.0)
    assert not any("in one piece" in remark for remark in short.attrs["recording"]["remarks"])


def test_frames_in_memory_stay_in_one_piece(processes):
    video = memory_video(pictures(motion(25)), fps=FPS)
    found = [
        track_views({"cam": video}, as_points(HOME), IcgnTracker(subset_px=31), work=Work(1.0, one))["cam"]
        for one in (None, processes)
    ]
    assert found[0].attrs["recording"]["segments"] == 1
    assert found[0].drop_attrs().identical(found[1].drop_attrs())


def test_a_record_holds_the_pass_and_lets_it_go(film):
    plan = plan_segments(open_video(film), IcgnTracker(subset_px=31), Targets(HOME, tuple("abcd")), 1.0)
    record = track_segment(plan[2])
    passed = read_pass(record)
    np.testing.assert_allclose(passed.time_s, np.arange(20, 30) / FPS, atol=1e-9)
    assert passed.status == "ok"
    assert passed.report(plan[2].segment.info) == plan[2].segment.report
    joined, _ = join_records([record], JoinedBlocks(None))
    assert not any("pass_" in str(name) for name in (*joined.variables, *joined.attrs))
