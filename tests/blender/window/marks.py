# SPDX-License-Identifier: GPL-3.0-or-later
"""A control point is marked within half a pixel in a real window, though a pixel of the screen is four of the photo's.

    PYTHONPATH=tests:tests/blender python tests/blender/window/marks.py --blender BLENDER --out shots

Needs what ``run.py`` needs, but no engine. The photo has one bright pixel; the magnifier has to show it at its cross,
in the screenshot, once Shift and the mouse have moved the mark there. Exits with 0 only then.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
import synthetic
from driver import HEIGHT, Window, open_with_addon

SIZE, TARGET = (4000, 3000), (1733, 1211)  # of the photo, and its bright pixel: column and row
GROUND, BRIGHT = (60, 90, 120), (40, 250, 80)
AWAY, SIDE = 28, 176  # of the magnifier, see georef/magnifier.py


def main() -> int:
    """Every step; returns the exit code."""
    parser = argparse.ArgumentParser(description="Mark a control point by mouse in a real Blender.")
    parser.add_argument("--blender", required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    out = args.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    photo = write_photo(out / "photo.png")
    window = open_with_addon(args.blender, out)
    try:
        begin(window, photo)
        mark(window)
    finally:
        window.close()
    return 0


def write_photo(path: Path) -> Path:
    """A plain photo with squares to see where one is, and the bright pixel."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    picture = np.empty((SIZE[1], SIZE[0], 3), np.uint8)
    picture[:] = GROUND
    picture[(x // 40 + y // 40) % 2 == 1] = (90, 120, 150)
    picture[TARGET[1] - 3 : TARGET[1] + 4, TARGET[0] - 3 : TARGET[0] + 4] = (20, 20, 20)
    picture[TARGET[1], TARGET[0]] = BRIGHT
    synthetic.write_png(path, picture)
    return path


def begin(window: Window, photo: Path) -> None:
    """Put the photo in the list and in the Image Editor, choose a control point, activate the point tool."""
    window.tell(
        f"py m = window.scene.mgf; p = m.photos.add(); p.name, p.file = 'photo.png', {str(photo)!r};"
        f"p.width, p.height = {SIZE};"
        "c = m.georef.points.add(); c.name, c.role = 'P1', 'control'; m.georef.marking = True"
    )
    window.tell("editor IMAGE_EDITOR")
    window.tell(f"py area.spaces.active.image = bpy.data.images.load({str(photo)!r})")
    time.sleep(2)
    window.tell("tab")
    window.tell("fit")
    window.tell(
        "py with_ = bpy.context.temp_override(window=window, area=area, region=area.regions[-1]); with_.__enter__();"
        "bpy.ops.wm.tool_set_by_id(name='mgf.point_tool', space_type='IMAGE_EDITOR'); with_.__exit__(None, None, None)"
    )
    window.wait("the tool", lambda s: s["tool"] == "mgf.point_tool" and s["image"] == "photo.png")


def mark(window: Window) -> None:
    """Press roughly at the pixel, then move by Shift until the mark is within half a pixel of its middle."""
    want = (TARGET[0] + 0.5, TARGET[1] + 0.5)
    x, y = (round(v) for v in window.image_point(want[0] / SIZE[0] + 0.002, want[1] / SIZE[1] - 0.002))
    window.move(x, y)
    window.shot("hover")
    window._x("mousedown", 1)
    time.sleep(0.4)
    state = window.wait("the mark", lambda s: len(s["marks"]) == 1)
    corner = window.image_point(0, 0), window.image_point(1, 0)
    pixels = SIZE[0] / (corner[1][0] - corner[0][0])  # of the photo in one of the screen
    assert pixels > 2, f"the editor shows a photo pixel too large to prove anything: {pixels:.2f}"
    first = error(state, want)
    assert max(map(abs, first)) > 0.5, f"already there: {first}"
    window._x("keydown", "shift")
    for _ in range(4):
        dx, dy = error(window.state(), want)
        if max(abs(dx), abs(dy)) <= 0.25 * pixels * 0.5:
            break
        for _ in range(2):  # Blender needs to see the pointer arrive
            window._x("mousemove_relative", "--", round(-5 * dx / pixels), round(-5 * dy / pixels))
            time.sleep(0.4)
        window.settle(2)
    window.shot("held")
    centre = lens_centre(window)
    window._x("mouseup", 1)
    window._x("keyup", "shift")
    window.settle(3)
    last = error(window.state(), want)
    print(f"a pixel of the screen is {pixels:.1f} of the photo; off by {first} pixels, with Shift by {last}")
    assert max(map(abs, last)) <= 0.5, last
    seen = pixel_at(window.out / "held.png", centre)
    assert max(abs(a - b) for a, b in zip(seen, BRIGHT, strict=True)) <= 2, f"at the magnifier's cross is {seen}"
    window.move(x + 200, y)
    window.shot("marked")


def error(state: dict, want: tuple[float, float]) -> tuple[float, float]:
    """How far the mark is off, pixels of the photo."""
    u, v = state["marks"][0]
    return u - want[0], v - want[1]


def lens_centre(window: Window) -> tuple[int, int]:
    """The middle of the magnifier on the screen."""
    said = subprocess.run(
        ["xdotool", "getmouselocation", "--shell"], env=window.environment, capture_output=True, text=True, check=True
    ).stdout
    place = dict(line.split("=") for line in said.split())
    away = (AWAY + SIDE / 2) * window.state()["ui_scale"]
    return round(int(place["X"]) + away), round(int(place["Y"]) - away)


def pixel_at(picture: Path, place: tuple[int, int]) -> tuple[int, int, int]:
    """The colour of a screenshot's pixel."""
    assert 0 <= place[1] < HEIGHT
    form = f"%[fx:round(255*p{{{place[0]},{place[1]}}}.r)],%[fx:round(255*p{{{place[0]},{place[1]}}}.g)],"
    form += f"%[fx:round(255*p{{{place[0]},{place[1]}}}.b)]"
    said = subprocess.run(["convert", picture, "-format", form, "info:"], capture_output=True, text=True, check=True)
    r, g, b = map(int, said.stdout.split(","))
    return r, g, b


if __name__ == "__main__":
    sys.exit(main())
