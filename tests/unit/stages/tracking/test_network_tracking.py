"""Points through a network: patches, mapping to the full image, statuses, and the hybrid trackers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moving_frames import NaturalTexture, digitize, memory_video
from standins import KnownMotion, swaying
from vfm_sdm.core.datasets import Status, check_tracks
from vfm_sdm.errors import BackendUnavailableError, DatasetError, SessionError
from vfm_sdm.stages.tracking.chunks import ChunkPlan
from vfm_sdm.stages.tracking.hybrid import HybridTracker
from vfm_sdm.stages.tracking.network import NetworkPreset, NetworkTracker
from vfm_sdm.stages.tracking.patches import plan_patches

PRESET = NetworkPreset("short", ChunkPlan(10), 98, multiple=14, least_px=56)
PADDED = NetworkPreset("padded", ChunkPlan(12, overlap=4), 98, multiple=14, least_px=56, canvas=(196, 98))
POINTS = np.array([[60.25, 70.5], [200.125, 150.0], [30.0, 20.75], [210.0, 158.5]])
NAMES = ["a", "b", "c", "d"]
FRAMES = 35


def plain(count=FRAMES, shape=(240, 320)):
    """Pictures whose grey value is their number."""
    return memory_video([np.full(shape, index, dtype=np.uint8) for index in range(count)])


def known(**options):
    return KnownMotion(swaying, number=lambda patch: int(patch[0, 0, 0]), **options)


class Told(NetworkTracker):
    """A tracker with a network that is given, and, if told so, with positions that are."""

    name = "told"
    preset = PRESET
    weights_id = "random"

    def __init__(self, network, preset=PRESET, positions=None):
        self.inference, self.preset, self.positions = network, preset, positions

    def load(self):
        raise AssertionError

    def follow(self, *arguments, **options):
        record = super().follow(*arguments, **options)
        if self.positions is not None:
            record["position"].values[:] = self.positions
        return record


def follow(network, preset=PRESET, points=POINTS, names=NAMES, video=None, **options):
    return Told(network, preset).track(video or plain(), points, names=names, **options)


def truth(reference=0, points=POINTS, frames=FRAMES):
    motion = np.array([swaying(i) for i in range(frames)])
    return points + (motion - motion[reference])[:, None]


@pytest.mark.parametrize("preset", [PRESET, PADDED])
@pytest.mark.parametrize("reference", [0, 1, 17, FRAMES - 1])
def test_positions_are_those_of_the_full_image(preset, reference):
    tracks = check_tracks(follow(known(), preset, reference_frame=reference))
    np.testing.assert_allclose(tracks["position"].values, truth(reference), atol=1e-9)
    assert (tracks["status"].values == Status.OK).all()
    covariance = tracks["position_covariance"].values
    assert (covariance[reference] == 0).all()
    others = np.arange(FRAMES) != reference
    assert (np.linalg.eigvalsh(covariance[others]) > 0).all()


@given(
    st.tuples(st.floats(0, 319), st.floats(0, 239)),
    st.sampled_from([56, 98, 224]),
)
def test_a_patch_maps_to_the_image_and_back_exactly(point, side):
    (patch,) = plan_patches(np.array([point]), (320, 240), side_px=side, multiple=14, least_px=56)
    place = patch.region.from_full(np.array([point]))
    np.testing.assert_allclose(patch.region.to_full(place), [point], atol=1e-9)
    assert (place >= -0.5).all()
    assert (place <= side - 0.5).all()


@given(st.tuples(st.floats(120, 200), st.floats(100, 140)))
def test_a_point_is_well_inside_its_patch(point):
    (patch,) = plan_patches(np.array([point]), (320, 240), side_px=98, multiple=14, least_px=56)
    place = patch.region.from_full(np.array(point))
    assert np.abs(place - 48.5).max() <= 98 / 6 + 1


def test_neighbours_share_a_patch_that_does_not_depend_on_them():
    patches = plan_patches(POINTS, (320, 240), side_px=98, multiple=14, least_px=56)
    assert sorted(row for patch in patches for row in patch.rows.tolist()) == [0, 1, 2, 3]
    shared = [patch for patch in patches if len(patch.rows) == 2]
    assert [patch.rows.tolist() for patch in shared] == [[1, 3]]
    alone = plan_patches(POINTS[1:2], (320, 240), side_px=98, multiple=14, least_px=56)
    assert alone[0].region == shared[0].region


def test_points_of_one_patch_take_one_pass():
    network = known()
    tracks = follow(network)
    assert tracks.attrs["patches"] == 3
    assert {queries.shape[0] for _, queries, _ in network.calls} == {1, 2}


def test_the_papers_picture_is_black_beside_the_patch():
    network = known()
    follow(network, PADDED)
    assert {shape[1:] for _, _, shape in network.calls} == {(98, 196, 3)}
    picture = PADDED.picture(np.full((98, 98, 3), 7, dtype=np.uint8))
    assert (picture[:, :98] == 7).all()
    assert not picture[:, 98:].any()


def test_small_images_get_small_patches():
    video = plain(5, (70, 90))
    network = known()
    follow(network, points=np.array([[40.0, 30.0]]), names=["a"], video=video)
    assert {shape[1:3] for _, _, shape in network.calls} == {(70, 84)}
    with pytest.raises(DatasetError, match=r"expected at least 56 px a side, got 50 x 90; .*another tracker"):
        follow(known(), points=np.array([[40.0, 30.0]]), names=["a"], video=plain(5, (90, 50)))


def test_hidden_points_are_lost_and_have_no_position():
    tracks = follow(known(visibility=lambda i: 0.2 if 10 <= i < 14 else 0.9))
    lost = np.zeros(FRAMES, dtype=bool)
    lost[10:14] = True
    assert (tracks["status"].values[lost] == Status.LOST).all()
    assert np.isnan(tracks["position"].values[lost]).all()
    assert np.isnan(tracks["position_covariance"].values[lost]).all()
    assert (tracks["status"].values[~lost] == Status.OK).all()


def test_a_network_that_is_not_sure_is_not_believed():
    tracks = follow(known(confidence=0.3))
    assert (tracks["status"].values[1:] == Status.UNRELIABLE).all()
    np.testing.assert_allclose(tracks["position"].values, truth(), atol=1e-9)


def test_a_point_that_leaves_its_patch_is_lost_and_one_that_leaves_the_image_is_outside():
    away = KnownMotion(lambda i: np.array([-5.0 * i, 0.0]), number=lambda patch: int(patch[0, 0, 0]))
    tracks = follow(away, points=np.array([[200.0, 120.0], [20.0, 120.0]]), names=["patch", "image"])
    codes = tracks["status"].values
    assert codes[30, 0] == Status.LOST
    assert codes[30, 1] == Status.OUTSIDE
    assert np.isnan(tracks["position"].values[30]).all()


def test_nonsense_from_a_network_is_lost():
    broken = KnownMotion(
        lambda i: np.array([np.nan, 0.0]) if i > 20 else np.zeros(2), number=lambda patch: int(patch[0, 0, 0])
    )
    tracks = follow(broken)
    assert (tracks["status"].values[21:] == Status.LOST).all()
    assert np.isfinite(tracks["position"].values[:21]).all()


def test_a_reference_frame_that_is_not_there_is_refused():
    with pytest.raises(DatasetError, match="expected a frame 35, got a video of 35 frames"):
        follow(known(), reference_frame=35)
    with pytest.raises(DatasetError, match="expected 0 or more, got -1"):
        follow(known(), reference_frame=-1)


def test_progress_counts_frames():
    seen = []
    follow(known(), progress=lambda what, done, total: seen.append(done))
    assert seen == list(range(1, FRAMES + 1))


def hybrid_tracker(monkeypatch, positions, **options):
    monkeypatch.setattr(
        "vfm_sdm.stages.tracking.hybrid.find_tracker", lambda name, **kw: Told(known(), positions=positions)
    )
    return HybridTracker(follower="vggt", subset_px=31, **options)


@pytest.fixture(scope="module")
def moving():
    """Jumps that registration alone cannot bridge, and where the points are."""
    texture = NaturalTexture(5)
    shifts = np.array([[0.0, 0.0], [0.3, 0.2], [60.25, -50.5], [60.5, -50.25], [0.5, 0.75], [0.1, 0.1]])
    points = np.array([[100.5, 110.25], [150.0, 130.0]])
    return memory_video([digitize(texture.image(s)) for s in shifts]), points, points + shifts[:, None]


def test_registration_goes_where_the_network_points(monkeypatch, moving):
    video, points, true = moving
    rng = np.random.default_rng(0)
    tracker = hybrid_tracker(monkeypatch, true + rng.uniform(-0.6, 0.6, true.shape))
    tracks = check_tracks(tracker.track(video, points, names=["a", "b"]))
    assert np.abs(tracks["position"].values - true).max() < 0.02
    assert (tracks["status"].values == Status.OK).all()
    assert tracks.attrs["tracker"] == "vggt+icgn"
    assert tracks.attrs["weights"] == "random"
    covariance = tracks["position_covariance"].values[1:]
    assert np.sqrt(np.einsum("tpii->tpi", covariance)).max() < 0.05


def test_two_witnesses_that_disagree_are_not_averaged(monkeypatch, moving):
    video, points, true = moving
    told = true.copy()
    told[3, 0] += [1.6, 0.0]
    tracks = hybrid_tracker(monkeypatch, told).track(video, points, names=["a", "b"])
    assert tracks["status"].values[3, 0] == Status.UNRELIABLE
    assert tracks["disagreement"].values[3, 0] == pytest.approx(1.6, abs=0.05)
    assert np.abs(tracks["position"].values[3, 0] - true[3, 0]).max() < 0.02
    assert (np.delete(tracks["status"].values.ravel(), 6) == Status.OK).all()


def test_what_only_the_registration_found_is_unreliable(monkeypatch, moving):
    video, points, true = moving
    told = true.copy()
    told[1, 1] = np.nan
    tracks = hybrid_tracker(monkeypatch, told).track(video, points, names=["a", "b"])
    assert tracks["status"].values[1, 1] == Status.UNRELIABLE
    assert np.isnan(tracks["disagreement"].values[1, 1])
    assert np.abs(tracks["position"].values[1, 1] - true[1, 1]).max() < 0.02


def test_progress_of_both_passes_ends_at_the_number_of_frames(monkeypatch, moving):
    video, points, true = moving
    seen = []

    def report(what, done, total):
        seen.append(done)

    hybrid_tracker(monkeypatch, true).track(video, points, names=["a", "b"], progress=report)
    assert seen == sorted(seen)
    assert seen[-1] == len(true)


def test_settings_and_followers_are_checked(monkeypatch):
    with pytest.raises(SessionError, match=r"vggt\+icgn: expected positive settings, got agreement_px = 0"):
        HybridTracker(follower="vggt", agreement_px=0)
    with pytest.raises(BackendUnavailableError, match="expected one of"):
        HybridTracker(follower="magic")
