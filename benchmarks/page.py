"""How long the page takes to its first pictures, and from a click to what is known of the point.

A pair of films is rendered (4K by default). The page is started as a user starts it, and its first pictures of both
views are asked for as soon as its address is told; beside it stands the plain way: a process that opens both films
with PyAV and writes their first frames as JPEG with OpenCV. Clicks are what the page computes for one, in this process
and without a browser: the subset in the own view, the counterpart in the other one, and the subset there. The relation
of the views and the frames that are sampled, once in the background, are timed by themselves.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path

from vfm_sdm.inputs.session import Point, read_session
from vfm_sdm.page.sight import Sight
from vfm_sdm.studies.synthetic.field_test import demo_plan, make_field_test
from vfm_sdm.studies.synthetic.footbridge import FootbridgeSite

PLAIN = """
import sys, time
import av, cv2
for path in sys.argv[1:]:
    with av.open(path) as film:
        picture = next(film.decode(video=0)).to_ndarray(format="bgr24")
    cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 90])
"""
BARS = {"first pictures": 3.0, "subset": 0.5, "counterpart": 0.5}


def start_page(folder: Path) -> tuple[float, float]:
    """Seconds to the page's address, and to the pictures of both views behind it."""
    begin = time.perf_counter()
    command = [sys.executable, "-u", "-m", "vfm_sdm", "page", str(folder), "--no-browser"]
    # NiceGUI serves nothing where it believes to be tested.
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=own)
    try:
        said = ""
        while (found := re.search(r"http://\S+/\?token=\S+", said)) is None:
            line = process.stdout.readline() if process.stdout else ""
            if not line:
                raise SystemExit(f"the page ended: {said}")
            said += line
        there = time.perf_counter() - begin
        for view in ("left", "right"):
            urllib.request.urlopen(found[0].replace("/?", f"/picture/{view}/0?"), timeout=60).read()
        return there, time.perf_counter() - begin
    finally:
        process.kill()
        process.wait()
        if process.stdout:
            process.stdout.close()


def timed(function: Callable[..., object], *arguments: object) -> float:
    begin = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - begin


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--height", type=int, default=2160)
    parser.add_argument("--duration-s", type=float, default=1.0)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="vfm-sdm-page-") as folder:
        site = FootbridgeSite(image_size=(options.height * 16 // 9, options.height))
        path = make_field_test(Path(folder), demo_plan(duration_s=options.duration_s, site=site))
        films = [str(one) for one in sorted(path.parent.glob("*.mp4"))]
        starts, plain = [], []
        for _ in range(options.repeats):
            plain.append(timed(subprocess.run, [sys.executable, "-c", PLAIN, *films]))
            starts.append(start_page(path.parent))
        session = read_session(path)
        sight = Sight(session.model_copy(update={"point": ()}))
        relation = timed(sight.look_around)
        first, places = session.point[0], []
        sight.judge(first.view, first.pixel)  # compiled
        clicks: dict[str, list[float]] = {"subset": [], "counterpart": [], "subset there": []}
        for point in session.point[1:]:
            own = Point(name=point.name, view=point.view, pixel=point.pixel)
            clicks["subset"].append(timed(sight.judge, own.view, own.pixel))
            clicks["counterpart"].append(timed(lambda own=own: places.append(sight.counterparts(own))))
            for view, one in places[-1].items():
                if one.pixel is not None:
                    clicks["subset there"].append(timed(sight.judge, view, one.pixel))
    address, pictures = (statistics.median(one) for one in zip(*starts, strict=True))
    rows = {"address": address, "first pictures": pictures, "plain first pictures": statistics.median(plain)}
    rows |= {"looking around, once": relation} | {
        name: statistics.median(values) for name, values in clicks.items() if values
    }
    print(f"{'what':22s}  {'seconds':>8s}  {'bar':>5s}")
    for name, seconds in rows.items():
        print(f"{name:22s}  {seconds:8.3f}  {BARS.get(name, '-')!s:>5s}")
    keys = {f"{name.replace(', ', '_').replace(' ', '_')}_s": value for name, value in rows.items()}
    ratio = pictures / rows["plain first pictures"]
    print(json.dumps({"processors": os.cpu_count(), "height_px": options.height, **keys, "ratio_to_plain": ratio}))


if __name__ == "__main__":
    main()
