"""What video files say of their cameras: tags that the demuxer hands on, and boxes that it does not."""

import struct

import pytest

from tagged_films import write_tagged
from vfm_sdm.inputs.video import CameraTags, open_video
from vfm_sdm.inputs.video.boxes import read_boxes
from vfm_sdm.inputs.video.camera_tags import read_camera_tags


def box(kind, *contents):
    content = b"".join(contents)
    return struct.pack(">I4s", 8 + len(content), kind) + content


def gpmf(name, kind, data, size=1):
    padded = data + bytes(-len(data) % 4)
    return struct.pack(">4sBBH", name, kind, size, len(data) // size) + padded


def append(path, *boxes):
    """A file with another `moov` behind it: demuxers read the first one, and so hand nothing of these on."""
    with path.open("ab") as file:
        file.write(box(b"moov", *boxes))
    return path


def keys_and_values(**values):
    names = [name.replace("__", ".").encode() for name in values]
    keys = struct.pack(">II", 0, len(names)) + b"".join(box(b"mdta", name) for name in names)
    items = [
        box(struct.pack(">I", number), box(b"data", struct.pack(">II", kind, 0), data))
        for number, (kind, data) in enumerate(values.values(), start=1)
    ]
    return box(b"hdlr", bytes(24)), box(b"keys", keys), box(b"ilst", *items)


GOPRO = gpmf(
    b"DEVC",
    0,
    gpmf(b"MINF", ord("c"), b"HERO7 Black") + gpmf(b"VFOV", ord("c"), b"L") + gpmf(b"EISA", ord("c"), b"N")
    + gpmf(b"ZFOV", ord("f"), struct.pack(">f", 92.0), size=4),
)  # fmt: skip


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({"com.android.manufacturer": "Google", "com.android.model": "Pixel 7"}, CameraTags("Google", "Pixel 7")),
        (
            {
                "com.apple.quicktime.make": "Apple",
                "com.apple.quicktime.model": "iPhone 13",
                "com.apple.quicktime.camera.lens_model": "iPhone 13 back camera 5.1mm f/1.6",
                "com.apple.quicktime.camera.focal_length.35mm_equivalent": "26",
            },
            CameraTags("Apple", "iPhone 13", ("iPhone 13 back camera 5.1mm f/1.6",), 26.0),
        ),
        ({"firmware": "HD9.01.01.72.00"}, CameraTags("GoPro", "HD9.01")),
        ({"com.apple.quicktime.camera.focal_length.35mm_equivalent": "none"}, CameraTags()),
        ({}, CameraTags()),
    ],
)
def test_tags_of_the_container(tmp_path, tags, expected):
    assert open_video(write_tagged(tmp_path / "a.mov", tags)).info.camera == expected


def test_a_gopro_states_model_mode_and_stabilisation(tmp_path):
    path = append(
        write_tagged(tmp_path / "a.mp4", {}), box(b"udta", box(b"FIRM", b"HD7.01.01.90.00"), box(b"GPMF", GOPRO))
    )
    assert open_video(path).info.camera == CameraTags("GoPro", "HERO7 Black", ("Linear",), None, False)
    assert read_boxes(path)["firm"] == "HD7.01.01.90.00"


@pytest.mark.parametrize("version", [b"", bytes(4)], ids=["QuickTime", "ISO"])
def test_apple_states_the_lens_with_the_track(tmp_path, version):
    values = keys_and_values(
        com__apple__quicktime__make=(1, b"Apple"),
        com__apple__quicktime__model=(1, b"iPhone 14 Pro"),
        com__apple__quicktime__camera__focal_length__35mm_equivalent=(21, struct.pack(">i", 24)),
        another=(24, struct.pack(">d", 2.5)),
    )
    path = append(write_tagged(tmp_path / "a.mov", {}), box(b"trak", box(b"meta", version, *values)))
    assert open_video(path).info.camera == CameraTags("Apple", "iPhone 14 Pro", (), 24.0)
    assert read_boxes(path)["another"] == "2.5"


def test_names_in_boxes_of_text(tmp_path):
    text = b"FC7303"
    path = append(
        write_tagged(tmp_path / "a.mp4", {}), box(b"udta", box(b"\xa9mdl", struct.pack(">HH", len(text), 0), text))
    )
    assert read_boxes(path)["model"] == "FC7303"
    with path.open("ab") as file:
        file.write(
            box(b"meta", b'<?xml version="1.0"?><Device manufacturer="Sony" modelName="ILCE-7M4" serialNo="1"/>')
        )
    assert open_video(path).info.camera == CameraTags("Sony", "ILCE-7M4")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no film at all",
        box(b"ftyp", b"qt  ") + struct.pack(">I4s", 4, b"moov"),
        box(b"ftyp", b"qt  ") + struct.pack(">I4s", 1, b"moov"),
        box(b"ftyp", b"qt  ") + box(b"moov", box(b"udta", struct.pack(">I4s", 1 << 30, b"GPMF"))),
        box(b"ftyp", b"qt  ") + box(b"moov", box(b"meta", box(b"hdlr", bytes(24)), box(b"keys", bytes(4)))),
        box(b"ftyp", b"qt  ") + box(b"moov", box(b"udta", box(b"GPMF", b"DEVC\0\1\xff\xff"))),
        box(b"ftyp", b"qt  ") + box(b"moov", box(b"udta", box(b"\xa9mod", b"\0"))),
    ],
)
def test_files_that_are_cut_or_none_say_nothing(tmp_path, content):
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    assert not any(read_boxes(path).values())
    assert read_camera_tags({}, path) == CameraTags()
    assert read_boxes(tmp_path / "none.mp4") == {}
