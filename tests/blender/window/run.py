# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole way by mouse in a real Blender: import, click points, preview the mask, reconstruct, see the mesh.

    python tests/blender/window/run.py --blender BLENDER --zip dist/mgf-….zip --engine PYTHON --scene FOLDER --out shots

Needs Xvfb, xdotool and ImageMagick. Every press is a real X event; a helper inside Blender only says where things are
and changes editors. Exits with 0 only when the add-on's own state shows each step; screenshots are left in --out.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from driver import HEIGHT, WIDTH, Window

# Places in the sidebar, pixels below its top at interface scale 1, panels as the add-on leaves them when new.
IMPORT, RECONSTRUCT = 50, 405
POINT_TOOL, NEXT_PHOTO, PREVIEW = 51, 81, 309


def main() -> int:
    """Run every step; returns the exit code."""
    args = parser().parse_args()
    shutil.rmtree(args.out, ignore_errors=True)
    args.out.mkdir(parents=True)
    scene = args.out / "scene"
    shutil.copytree(args.scene, scene, ignore=shutil.ignore_patterns("*_job*"))
    prompts = json.loads((scene / "prompts.json").read_text())
    window = Window(args.blender, args.zip, args.out, MGF_ENGINE_PYTHON=str(args.engine))
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:6.1f} s  {text}", flush=True)

    try:
        window.wait("the window", lambda s: s["size"][0] > 100, 240)
        window.tell('py bpy.context.preferences.view.filebrowser_display_type = "SCREEN"')
        window.tell("py [bpy.data.objects.remove(o) for o in list(bpy.data.objects)]")
        window.tell("editor VIEW_3D")
        window.wait("the sidebar", lambda s: s["regions"]["UI"][2] > 100)
        time.sleep(2)
        window.tell("tab")
        say("window ready")
        import_scene(window, scene)
        say("scene imported")
        set_options(window, args.set)
        click_points(window, prompts)
        say("points clicked, moved, removed, undone")
        preview_mask(window)
        say("mask previewed")
        reconstruct(window)
        say("mesh in the scene")
        state = window.state()
        print(f"longest tick of the timer: {1000 * state['longest_tick']:.1f} ms")
    finally:
        window.close()
    return 0


def import_scene(window: Window, scene: Path) -> None:
    """The button, the file browser's path field, its confirm button."""
    window.click(*window.button(IMPORT))
    time.sleep(2.5)
    x, y = 0.47 * WIDTH, 49
    window.click(x, y)
    window.click(x, y)
    window.key("ctrl+a")
    window._x("type", "--delay", 30, str(scene) + "/")
    window.key("Return")
    time.sleep(1.5)
    window.shot("1-file-browser")
    window.click(WIDTH - 72, HEIGHT - 44)
    window.wait("the cameras", lambda s: s["objects"]["Cameras"] > 0)
    time.sleep(1)
    window.tell("fit")
    window.shot("2-imported")


def set_options(window: Window, options: list[str]) -> None:
    """Small options, so that the run is quick; set from inside because sliders are no part of this test."""
    for text in options:
        name, value = text.split("=")
        value = repr(value) if not value.replace(".", "").isdigit() else value
        window.tell(f"py window.scene.mgf.options.{name} = {value}")


def click_points(window: Window, prompts: dict) -> None:
    """Click the points of the prompts file on each root photo the list names."""
    window.tell("editor IMAGE_EDITOR")
    window.wait("the sidebar", lambda s: s["area"] == "IMAGE_EDITOR" and s["regions"]["UI"][2] > 100)
    time.sleep(2)
    window.tell("tab")
    names = [photo["name"] for photo in window.state()["photos"]]
    at = next(i for i in (*range(1, len(names)), 0) if names[i] in prompts)
    for step in range(1, (at or len(names)) + 1):
        window.click(*window.button(NEXT_PHOTO, 0.75))
        window.wait("a photo", lambda s, step=step: s["photo_index"] == step % len(names) and s["image"])
    window.tell("fit")
    window.click(*window.button(POINT_TOOL))
    window.wait("the point tool", lambda s: s["tool"] == "mgf.point_tool")
    window.shot("3-photo")
    photo = window.state()["photos"][at]
    width, height = photo["size"]
    entry = prompts[photo["name"]]
    positive = [p for p in entry["positive"] if clear_of_sidebar(window, p[0] / width, p[1] / height)]
    negative = [p for p in entry.get("negative", []) if clear_of_sidebar(window, p[0] / width, p[1] / height)]
    for u, v in positive:
        window.click(*window.image_point(u / width, v / height))
    clicks = window.wait("the points", lambda s: len(s["photos"][at]["clicks"]) == len(positive))["photos"][at][
        "clicks"
    ]
    pixel = width / (window.image_point(1, 0)[0] - window.image_point(0, 0)[0])
    worst = max(max(abs(c[0] - p[0]), abs(c[1] - p[1])) for c, p in zip(clicks, positive, strict=True))
    assert worst <= 2 * pixel, f"a click landed {worst:.1f} photo pixels away"
    # Ctrl click: negative. Drag: moves. Alt click and X: remove. Ctrl Z: brings back.
    spot = negative[0] if negative else [width * 0.5, height * 0.97]
    window.click(*window.image_point(spot[0] / width, spot[1] / height), hold="ctrl")
    count = len(positive) + 1
    window.wait(
        "the negative point", lambda s: len(s["photos"][at]["clicks"]) == count and s["photos"][at]["clicks"][-1][2]
    )
    u, v = positive[0]
    window.drag(*window.image_point(u / width, v / height), *window.image_point(u / width + 0.03, v / height))
    window.wait("the moved point", lambda s: abs(s["photos"][at]["clicks"][0][0] - (u + 0.03 * width)) < 3 * pixel)
    window.shot("4-points")
    window.click(*window.image_point(u / width + 0.03, v / height), hold="alt")
    window.wait("the removed point", lambda s: len(s["photos"][at]["clicks"]) == count - 1)
    window.key("ctrl+z")
    window.wait("undo", lambda s: len(s["photos"][at]["clicks"]) == count)
    window.move(*window.image_point(u / width + 0.03, v / height))
    window.key("x")
    window.wait("X to remove", lambda s: len(s["photos"][at]["clicks"]) == count - 1)
    window.key("ctrl+z")
    window.wait("undo", lambda s: len(s["photos"][at]["clicks"]) == count)


def clear_of_sidebar(window: Window, u: float, v: float) -> bool:
    """Whether a place of the image can be clicked: not under the sidebar, which lies over it."""
    x, _ = window.image_point(u, v)
    return x < window.region("UI")[0] - 10


def preview_mask(window: Window) -> None:
    """The button, and the overlay it leads to."""
    window.click(*window.button(PREVIEW))
    window.wait("the masks job", lambda s: s["jobs"][-1][0] == "masks", 20)
    time.sleep(2)
    window.shot("5-masking")
    window.wait("the masks", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 600)
    assert window.state()["jobs"][-1][1] == "DONE", window.state()["jobs"][-1]
    time.sleep(1.5)
    window.shot("6-mask")


def reconstruct(window: Window) -> None:
    """The button, progress, and the mesh."""
    window.tell("editor VIEW_3D")
    window.wait("the sidebar", lambda s: s["area"] == "VIEW_3D" and s["regions"]["UI"][2] > 100)
    time.sleep(1.5)
    window.tell("tab")
    window.tell("py area.spaces.active.shading.color_type = 'VERTEX'")
    window.shot("7-before")
    window.click(*window.button(RECONSTRUCT))
    window.wait("the job", lambda s: s["jobs"][-1][0] == "reconstruct", 20)
    window.wait("training", lambda s: s["jobs"][-1][2] == "field" and s["jobs"][-1][3] > 0.15, 900)
    time.sleep(4)
    window.shot("8-training")
    window.wait("the end", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 1800)
    assert window.state()["jobs"][-1][1] == "DONE", window.state()["jobs"][-1]
    window.wait("the mesh", lambda s: s["objects"]["Mesh"] == 1, 60)
    window.tell("frame Mesh")
    time.sleep(3)
    window.shot("9-mesh")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description="Drive the add-on by mouse in a real Blender.")
    p.add_argument("--blender", required=True)
    p.add_argument("--zip", type=Path, required=True)
    p.add_argument("--engine", type=Path, required=True, help="Python that has the engine")
    p.add_argument("--scene", type=Path, required=True, help="scene folder with images, sparse and prompts.json")
    p.add_argument("--out", type=Path, required=True)
    p.add_argument("--set", action="append", default=["preset=draft", "resolution=300", "iterations=150"])
    return p


if __name__ == "__main__":
    sys.exit(main())
