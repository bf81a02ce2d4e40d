# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole way by mouse in a real Blender, from the zip on disk to the mesh in the scene.

    python tests/blender/window/run.py --blender BLENDER --zip dist/mgf-….zip --scene FOLDER --out shots
        (--engine PYTHON | --wheels FOLDER)  [--pictures docs/pictures]

Install from disk, set up the engine, import, crop box, drop the model, click points, preview the mask, save and open
with the tool active, reconstruct, leave Blender and resume, look at the results. Needs Xvfb, xdotool and ImageMagick.
Every press is a real X event; a helper inside Blender only says where things are and changes settings. Exits with 0
only when the add-on's own state shows each step; screenshots are left in --out, and those of the documentation go to
--pictures.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from driver import Window, engine_python
from first_steps import install_engine, install_extension, use_environment

# Places in the sidebar, pixels below its top at interface scale 1, panels as the add-on leaves them when new.
IMPORT, CROP, MARK = 84, 71, 195
RECONSTRUCT, RESUME = 500, 558  # with a photo marked
SHOW_RENDER = 493  # while training
SCENE_HEADER, RESULTS_HEADER = 16, 214  # the second while only the panel Scene is open
PAINT, SHOW, ROW = 203, 272, 23  # in the Results panel, the other panels closed
POINTS, NEXT_PHOTO, PREVIEW = 51, 81, 346
#: First icon in a File Browser in place of the Properties editor, and the distance of the rows, by the major version.
FILES = {4: ((1177, 364), 20), 5: ((1170, 251), 22)}
SIDE = 0.915  # of the small button at the end of a row, as a share of the sidebar's width

#: Screenshot -> part of it (width, height, x, y) and picture of the documentation.
PICTURES = {
    "05-engine": ((990, 650, 165, 158), "blender-preferences"),
    "12-crop-box": ((1160, 815, 0, 0), "blender-scene"),
    "23-mask": ((1160, 815, 0, 0), "blender-prompts"),
    "31-training": ((1160, 815, 0, 0), "blender-training"),
    "31-render": ((1160, 815, 0, 0), "blender-render"),
    "32-mesh": ((1160, 815, 0, 0), "blender-mesh"),
    "33-error": ((1160, 815, 0, 0), "blender-error"),
    "35-confidence": ((1160, 815, 0, 0), "blender-confidence"),
}


def main() -> int:
    """Run every step; returns the exit code."""
    args = parser().parse_args()
    args.out = args.out.absolute()
    shutil.rmtree(args.out, ignore_errors=True)
    args.out.mkdir(parents=True)
    scene = args.out / args.scene.name.split("-")[0]
    shutil.copytree(args.scene, scene, ignore=shutil.ignore_patterns("*_job*"), copy_function=shutil.copyfile)
    for path in scene.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    prompts = json.loads((scene / "prompts.json").read_text())
    window = Window(args.blender, args.out)
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:6.1f} s  {text}", flush=True)

    try:
        window.tell('py bpy.context.preferences.view.filebrowser_display_type = "SCREEN"')
        window.tell("py [bpy.data.objects.remove(o) for o in list(bpy.data.objects)]")
        say("window ready")
        install_extension(window, args.zip.resolve())
        say("extension installed from disk")
        if args.wheels is not None:
            install_engine(window, args.wheels.resolve())
        else:
            use_environment(window, args.engine)
        say("engine ready")
        import_scene(window, scene)
        say("scene imported, crop box made and undone, model dropped into the viewport")
        set_options(window, args.set)
        at = click_points(window, prompts)
        say("points clicked, moved, removed, undone")
        say(f"mask previewed {preview_mask(window):.1f} s after the engine was asked")
        reopen_with_tool(window, at, args.out / "building.blend")
        say("file saved with the point tool active, opened again, clicked on")
        quit_and_resume(window, args.out / "building.blend")
        say("Blender left in the middle of the job, the engine ended; opened again, job resumed")
        watch_to_the_end(window)
        say("mesh in the scene")
        look_at_results(window)
        say("results looked at")
        state = window.state()
        print(f"longest tick of the jobs' timer: {1000 * state['longest_tick']:.1f} ms")
        print(f"longest step of bringing the mesh in: {1000 * state['longest_step']:.1f} ms")
    finally:
        window.close()
    if args.pictures is not None:
        make_pictures(args.out, args.pictures)
    return 0


def import_scene(window: Window, scene: Path) -> None:
    """The button, the file browser, and a crop box that undo takes away again."""
    window.tell("editor VIEW_3D")
    window.wait("the sidebar", lambda s: s["regions"]["UI"][2] > 100)
    time.sleep(2)
    window.tell("tab")
    window.shot("10-empty")
    window.press(window.button(IMPORT), "the file browser", lambda s: s["browser"])
    window.choose_file(f"{scene}/")
    window.wait("the cameras", lambda s: s["objects"]["Cameras"] > 0 and not s["browser"])
    time.sleep(2)
    window.settle(4)
    window.shot("11-imported")
    window.press(window.button(CROP), "the crop box", lambda s: s["crop"] == 1)
    window.tell("py area.spaces.active.region_3d.view_distance *= 1.5")  # all of it beside the sidebar
    time.sleep(2)
    window.shot("12-crop-box")
    window.move(400, 500)
    window.key("ctrl+z")
    window.wait("undo of the crop box", lambda s: s["crop"] == 0)
    drop_model(window, scene)


def drop_model(window: Window, scene: Path) -> None:
    """A file of the model, dragged out of a File Browser into the viewport, replaces the import."""
    model = next(p.parent for p in sorted(scene.rglob("images.bin")))
    window.tell("py [bpy.data.objects.remove(o) for o in list(bpy.data.objects)]")
    window.tell(f"browse {model}/")
    time.sleep(1)
    rows = [p.name for p in sorted(model.iterdir(), key=lambda p: (p.is_file(), p.name.lower()))]
    (x, y), row = FILES[window.state()["version"][0]]
    window.drag_file(x, y + row * rows.index("images.bin"), 400, 420, "13-drop")
    window.wait("the cameras of the dropped model", lambda s: s["objects"]["Cameras"] > 0, 60)
    window.tell("py next(a for a in window.screen.areas if a.type == 'FILE_BROWSER').type = 'PROPERTIES'")
    time.sleep(1)


def set_options(window: Window, options: list[str]) -> None:
    """Small options, so that the run is quick; set from inside because sliders are no part of this test."""
    for text in options:
        name, value = text.split("=")
        value = repr(value) if not value.replace(".", "").isdigit() else value
        window.tell(f"py window.scene.mgf.options.{name} = {value}")


def click_points(window: Window, prompts: dict) -> int:
    """Mark Building, then the points of the prompts file on the first root photo that the file knows; its index."""
    window.press(window.button(MARK), "the photos", lambda s: s["area"] == "IMAGE_EDITOR")
    window.wait("the photo", lambda s: s["area"] == "IMAGE_EDITOR" and s["tool"] == "mgf.point_tool" and s["image"])
    window.wait("our tab", lambda s: s["tab"] == "MGF")
    time.sleep(1)
    names = [photo["name"] for photo in window.state()["photos"]]
    at = next((i for i in range(len(names)) if names[i] in prompts), None)
    assert at is not None, "prompts.json names none of the root photos"
    for step in range(1, at + 1):
        window.click(*window.button(NEXT_PHOTO, 0.75))
        window.wait("a photo", lambda s, step=step: s["photo_index"] == step and s["image"])
    time.sleep(1)
    window.shot("20-photo")
    photo = window.state()["photos"][at]
    width, height = photo["size"]
    entry = prompts[photo["name"]]
    positive = [p for p in entry["positive"] if clear_of_sidebar(window, p[0] / width, p[1] / height)]
    negative = [p for p in entry.get("negative", []) if clear_of_sidebar(window, p[0] / width, p[1] / height)]
    assert positive, "every point of this photo lies under the sidebar"
    for u, v in positive:
        window.click(*window.image_point(u / width, v / height))
    state = window.wait("the points", lambda s: len(s["photos"][at]["clicks"]) == len(positive))
    pixel = width / (window.image_point(1, 0)[0] - window.image_point(0, 0)[0])
    pairs = zip(state["photos"][at]["clicks"], positive, strict=True)
    worst = max(max(abs(c[0] - p[0]), abs(c[1] - p[1])) for c, p in pairs)
    assert worst <= 2 * pixel, f"a click landed {worst:.1f} photo pixels away"
    for u, v in negative[1:]:
        window.click(*window.image_point(u / width, v / height), hold="ctrl")
    count = len(positive) + len(negative[1:])
    window.wait("the negative points", lambda s: len(s["photos"][at]["clicks"]) == count)
    edit_points(window, at, positive[0], negative[0] if negative else [width * 0.5, height * 0.97], pixel)
    return at


def edit_points(window: Window, at: int, first: list[float], beside: list[float], pixel: float) -> None:
    """Ctrl click: negative. Drag: moves. Alt click and X: remove. Ctrl Z: brings back."""
    width, height = window.state()["photos"][at]["size"]
    count = len(window.state()["photos"][at]["clicks"]) + 1
    clicks = lambda s: s["photos"][at]["clicks"]  # noqa: E731
    window.click(*window.image_point(beside[0] / width, beside[1] / height), hold="ctrl")
    window.wait("the negative point", lambda s: len(clicks(s)) == count and clicks(s)[-1][2])
    u, v = first
    there = (u / width + 0.03, v / height)
    window.drag(*window.image_point(u / width, v / height), *window.image_point(*there))
    window.wait("the moved point", lambda s: abs(clicks(s)[0][0] - (u + 0.03 * width)) < 3 * pixel)
    window.shot("21-points")
    window.click(*window.image_point(*there), hold="alt")
    window.wait("the removed point", lambda s: len(clicks(s)) == count - 1)
    window.key("ctrl+z")
    window.wait("undo", lambda s: len(clicks(s)) == count)
    window.move(*window.image_point(*there))
    window.key("x")
    window.wait("X to remove", lambda s: len(clicks(s)) == count - 1)
    window.key("ctrl+z")
    window.wait("undo", lambda s: len(clicks(s)) == count)


def clear_of_sidebar(window: Window, u: float, v: float) -> bool:
    """Whether a place of the image can be clicked: not under the sidebar, which lies over it, nor the gizmos."""
    x, y = window.image_point(u, v)
    return x < window.region("UI")[0] - 60 and y > 100


def preview_mask(window: Window) -> float:
    """The button and the overlay; then the automatic one after a click. Returns the seconds of the first."""
    window.press(window.button(PREVIEW), "a preview", lambda s: s["previews"])
    state = window.wait("the preview", lambda s: any(p[0] != "RUNNING" for p in s["previews"].values()), 60)
    (first,) = state["previews"].values()
    assert first[0] == "DONE", first
    time.sleep(1)
    window.shot("22-mask")
    window.click(*window.button(PREVIEW, SIDE))
    window.wait("the switch", lambda s: s["auto"])
    at, photo = next((i, p) for i, p in enumerate(window.state()["photos"]) if p["clicks"])
    u, v = photo["clicks"][0][0] / photo["size"][0], photo["clicks"][0][1] / photo["size"][1]
    count = len(photo["clicks"]) + 1
    window.press(window.image_point(u, v + 0.04), "one more point", lambda s: len(s["photos"][at]["clicks"]) == count)
    window.wait("the next preview", lambda s: s["previews"] and [first] != list(s["previews"].values()), 60)
    window.wait("its mask", lambda s: all(p[0] == "DONE" for p in s["previews"].values()), 60)
    time.sleep(1)
    window.shot("23-mask")
    return first[2]


def reopen_with_tool(window: Window, at: int, blend: Path) -> None:
    """Save and open while the point tool is active; it is still active then, and clicking goes on."""
    window.tell(f"py bpy.ops.wm.save_as_mainfile(filepath={str(blend)!r})")
    before = window.state()["photos"][at]["clicks"]
    window.quit()
    window.start(blend)
    state = window.wait(
        "the photo", lambda s: s["area"] == "IMAGE_EDITOR" and s["tool"] == "mgf.point_tool" and s["image"]
    )
    assert state["photos"][at]["clicks"] == before, "clicks were lost"
    window.tell("tab")
    u, v = (before[0][i] / state["photos"][at]["size"][i] for i in (0, 1))
    one_more = lambda s: len(s["photos"][at]["clicks"]) == len(before) + 1  # noqa: E731
    window.press(window.image_point(u + (0.06 if u < 0.1 else -0.06), v), "one more point", one_more)
    time.sleep(4)  # the automatic preview
    window.shot("24-reopened")


def quit_and_resume(window: Window, blend: Path) -> None:
    """Start the job, save, leave Blender in the middle; the engine ends with it. Open again and press Resume."""
    window.press(window.button(POINTS, SIDE), "the viewport", lambda s: s["area"] == "VIEW_3D")
    window.wait("our tab", lambda s: s["tab"] == "MGF")
    time.sleep(1)
    window.shot("30-before")
    window.press(window.button(RECONSTRUCT), "the job", lambda s: s["jobs"])
    window.wait("training", lambda s: s["jobs"][-1][2] == "field" and s["jobs"][-1][5] > 0, 1800)
    time.sleep(4)
    window.shot("31-training")
    watch_training(window)
    window.move(400, 500)
    window.key("ctrl+s")
    time.sleep(1)
    pid = window.state()["pids"][-1]
    window.quit()
    end = time.monotonic() + 60
    while Path(f"/proc/{pid}").exists() and time.monotonic() < end:
        time.sleep(0.2)
    assert not Path(f"/proc/{pid}").exists(), "the engine outlived Blender"
    window.start(blend)
    window.wait("the viewport", lambda s: s["area"] == "VIEW_3D" and s["objects"]["Cameras"] > 0)
    window.tell("tab")
    window.move(400, 500)
    time.sleep(2)
    window.shot("34-interrupted")
    window.press(window.button(RESUME), "the resumed job", lambda s: s.get("jobs"))
    window.wait("training to go on", lambda s: s["jobs"][-1][2] in ("field", "mesh", "deliver"), 600)
    (log,) = blend.parent.glob(f"{blend.stem}_jobs/*/log.txt")
    assert log.read_text().count("stage masks begins") == 1, "the resumed job began again"


def watch_training(window: Window) -> None:
    """Show Render puts the training render into an Image Editor, where it gets better; then back to the viewport."""
    window.press(window.button(SHOW_RENDER, 0.25), "the training render", lambda s: s["image"] == "MGF Preview")
    window.wait("our tab", lambda s: s["tab"] == "MGF")
    window.wait("a render of the training", lambda s: s["image_file"].endswith("preview.jpg"), 120)
    time.sleep(1)
    window.shot("31-render")
    window.press(window.button(POINTS, SIDE), "the viewport", lambda s: s["area"] == "VIEW_3D")
    time.sleep(1)


def watch_to_the_end(window: Window) -> None:
    """The job ends and the mesh arrives without holding the window."""
    window.wait("the end", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 3600)
    assert window.state()["jobs"][-1][1] == "DONE", window.state()["jobs"][-1]
    window.wait("the mesh", lambda s: s["painted"] == ["TEXTURE"], 120)
    window.tell("frame Mesh")
    time.sleep(1)  # the view moves there smoothly
    window.tell("py area.spaces.active.region_3d.view_distance *= 1.4")  # clear of the sidebar
    time.sleep(3)
    window.shot("32-mesh")


def look_at_results(window: Window) -> None:
    """Through a held-out camera: its render and the error map; the mesh painted by confidence; all by their buttons."""
    # Ctrl opens a closed panel and closes the others: then Results is where we know it, whatever warnings there are.
    for header, hold in ((SCENE_HEADER, ""), (SCENE_HEADER, "ctrl"), (RESULTS_HEADER, "ctrl")):
        x, y = window.button(header)
        window.click(x - 60, y, hold=hold)
        time.sleep(1)
    window.press(window.button(PAINT + ROW, 0.25), "confidence", lambda s: s["painted"] == ["CONFIDENCE"])
    time.sleep(2)
    window.shot("35-confidence")
    window.press(window.button(PAINT, 0.75), "colours", lambda s: s["painted"] == ["COLOR"])
    window.press(window.button(PAINT, 0.25), "the texture", lambda s: s["painted"] == ["TEXTURE"])
    window.tell(
        "py window.scene.camera = next(o.parent for o in bpy.data.objects if o.get('mgf_kind') == 'Renders');"
        "area.spaces.active.region_3d.view_perspective = 'CAMERA'"
    )
    for kind, across in (("RENDER", 0.38), ("ERROR", 0.62)):
        window.press(window.button(SHOW, across), kind, lambda s, kind=kind: s["camera"] == kind)
        time.sleep(2)
        window.shot(f"33-{kind.lower()}")


def make_pictures(shots: Path, folder: Path) -> None:
    """Cut the documentation's pictures out of the screenshots."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, ((width, height, x, y), title) in PICTURES.items():
        command = ["convert", shots / f"{name}.png", "-crop", f"{width}x{height}+{x}+{y}", "+repage"]
        subprocess.run([*command, "-colors", "200", "-strip", folder / f"{title}.png"], check=True)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description="Drive the add-on by mouse in a real Blender.")
    p.add_argument("--blender", required=True)
    p.add_argument("--zip", type=Path, required=True)
    engine = p.add_mutually_exclusive_group(required=True)
    engine.add_argument("--engine", type=engine_python, help="Python that has the engine")
    engine.add_argument("--wheels", type=Path, help="folder of wheels to install the engine from")
    p.add_argument("--scene", type=Path, required=True, help="scene folder with images, sparse and prompts.json")
    p.add_argument("--out", type=Path, required=True)
    p.add_argument("--set", action="append", default=["preset=draft", "resolution=480", "iterations=1000"])
    p.add_argument("--pictures", type=Path, help="folder for the documentation's pictures (the demo scene only)")
    return p


if __name__ == "__main__":
    sys.exit(main())
