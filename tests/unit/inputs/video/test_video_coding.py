"""What is read of a recording's compression: kinds of frames, quantisers, words, parts of pictures."""

import gc
from fractions import Fraction

import av
import numpy as np
import pytest

from textures import WaveTexture
from vfm_sdm.inputs.video import Region, coding, open_images, open_video
from vfm_sdm.inputs.video.coding import read_coded_clip

FRAMES = 12


def write(path, codec, **options):
    """A texture in motion, 128 x 96 px."""
    texture = WaveTexture(3)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(30), options=options)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for number in range(FRAMES):
            luma = np.clip(np.rint(texture.image((96, 128), (0.4 * number, 0.2))), 0, 255).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(np.concatenate([luma, np.full((48, 128), 128, np.uint8)]), "yuv420p")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return open_video(path)


def test_quantisers_of_blocks_are_those_of_the_encoder(tmp_path):
    params = "ipratio=1:pbratio=1:bframes=2:b-adapt=0:keyint=6:scenecut=0"
    video = write(tmp_path / "a.mp4", "libx264", qp="27", **{"x264-params": params})
    clip = read_coded_clip(video, [], frames=FRAMES)
    assert clip.codec == "h264"
    assert clip.encoder.startswith("x264")
    assert clip.quantisers.shape == (FRAMES, 6, 8)
    # A picture that is wholly predicted has none.
    known = np.isfinite(clip.quantisers).all(axis=(1, 2))
    assert known.sum() >= FRAMES - 3
    np.testing.assert_array_equal(clip.quantisers[known], 27)
    np.testing.assert_array_equal(clip.quantisers_of(Region(-5, 70, 41, 41))[known], 27)
    assert clip.frame_types[0] == clip.frame_types[6] == 1
    assert set(clip.frame_types.tolist()) == {1, 2, 3}


def test_pictures_are_let_go_while_others_are_read(tmp_path, monkeypatch):
    video = write(tmp_path / "a.mp4", "libx264", qp="27")
    alive = []

    def cut(luma, region):
        alive.append(sum(isinstance(one, av.VideoFrame) for one in gc.get_objects()))
        return luma[:1, :1].copy()

    monkeypatch.setattr(coding, "_cut", cut)
    gc.collect()
    gc.disable()
    try:
        read_coded_clip(video, [Region(0, 0, 8, 8)], frames=FRAMES)
    finally:
        gc.enable()
    assert max(alive) <= 2 * 4 < FRAMES


@pytest.mark.parametrize("quantiser", [22, 35])
def test_quantisers_of_hevc_stand_in_its_slices_where_the_encoder_says_nothing(tmp_path, quantiser):
    params = f"log-level=none:info=0:qp={quantiser}:ipratio=1:pbratio=1:bframes=0"
    clip = read_coded_clip(write(tmp_path / "a.mp4", "libx265", **{"x265-params": params}), [], frames=8)
    assert clip.encoder == ""
    assert clip.quantisers.shape == (8, 1, 1)
    np.testing.assert_array_equal(clip.quantisers, quantiser)
    assert clip.frame_types.tolist() == [1, *[2] * 7]


def test_parts_are_those_of_the_decoded_frames_and_mirrored_outside(tmp_path):
    video = write(tmp_path / "a.mp4", "libx264", crf="20")
    regions = [Region(40, 30, 20, 10), Region(-4, 90, 8, 12)]
    clip = read_coded_clip(video, regions, frames=5)
    luma = [frame.luma for frame in video.frames(stop=5)]
    assert len(clip.frame_types) == 5
    np.testing.assert_array_equal(clip.crops[0], [picture[30:40, 40:60] for picture in luma])
    np.testing.assert_array_equal(clip.first, luma[0])
    padded = np.pad(luma[2], 16, mode="reflect")
    np.testing.assert_array_equal(clip.crops[1][2], padded[106:118, 12:20])


def test_images_are_no_compressed_recording(tmp_path):
    cv2 = pytest.importorskip("cv2")
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((48, 64), np.uint8))
    assert read_coded_clip(open_images(tmp_path / "*.png", 10.0), [], frames=1) is None


def test_a_damaged_recording_gives_what_was_sound(tmp_path):
    video = write(tmp_path / "a.mp4", "libx264", crf="20")
    content = bytearray((tmp_path / "a.mp4").read_bytes())
    (tmp_path / "a.mp4").write_bytes(content[: len(content) // 3])
    clip = read_coded_clip(video, [], frames=FRAMES)
    assert clip is None or len(clip.frame_types) < FRAMES
