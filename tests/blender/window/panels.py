# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the panels for a finished job, taken in a real window: Georeference, Drawings, Models, control points.

    PYTHONPATH=.:tests:tests/blender python tests/blender/window/panels.py --blender BLENDER --engine PYTHON
        --out FOLDER [--pictures docs/pictures]

Needs what ``run.py`` needs, and an engine with the extras ``survey`` and ``models``. The building is a house painted by
the engine's z-buffer (minutes); its job, true coordinates by control points, drawings and models are made by the
engine, once for each --out. Each panel is shown alone, and its picture is cut out of the screenshot.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
from driver import REPO, Window, engine_python, open_with_addon

from benchmarks.buildings import BUILDINGS
from benchmarks.camera_path import Ring, plan
from benchmarks.catalogue import SceneSpec
from benchmarks.control_points import CRS, Noise, targets_of, write_inputs
from benchmarks.prompts import click_prompts
from benchmarks.scenes import read_png
from benchmarks.surroundings import car, tree
from benchmarks.town import write_photos
from benchmarks.town_painted import paint_views
from benchmarks.truth import write_truth

GEOREFERENCE = 180  # the button, pixels below the top of the sidebar, with control points read
PANELS = ("georef", "drawings", "models")
SHOWN = {"drawings": (252, 620)}  # width and height of a panel that goes on below the window, up to a whole row of it
SPEC = SceneSpec(
    building="half_timber", photos=20, width=720, rings=(Ring(0.55, 5.5, 16.0, 5.0), Ring(0.45, 14.0, 14.0, 5.0))
)


def main() -> int:
    """Make what is to be shown, show it, cut the pictures out; returns the exit code."""
    parser = argparse.ArgumentParser(description="Take pictures of the panels in a real Blender.")
    parser.add_argument("--blender", required=True)
    parser.add_argument("--engine", type=engine_python, required=True, help="Python that has the engine")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pictures", type=Path, help="folder for the documentation's pictures")
    args = parser.parse_args()
    out, engine = args.out.absolute(), args.engine
    scene, job = out / "scene", out / "job"
    if not (job / "models" / "models.json").is_file():
        make_scene(out)
        make_job(engine, scene, job)
    window = open_with_addon(args.blender, out, MGF_ENGINE_PYTHON=str(engine))
    try:
        begin(window, scene, job)
        for name in PANELS:
            show_panel(window, name)
        georeference(window)
        show_marks(window, scene)
    finally:
        window.close()
    if args.pictures is not None:
        for name in (*(f"panel-{p}" for p in PANELS), "control-points"):
            colors = ["-colors", "48" if name.startswith("panel") else "160"]
            target = args.pictures / f"{name}.png"
            command = ["convert", out / f"{name}.png", "-strip", "-dither", "none", *colors, f"PNG8:{target}"]
            subprocess.run(command, check=True)
    return 0


def make_scene(out: Path) -> None:
    """Photos with GPS, cameras, control points and their marks."""
    whole, rng = out / "whole", np.random.default_rng(SPEC.seed)
    house = BUILDINGS[SPEC.building]("clay")
    ground = np.concatenate([p.vertices[:, :2] for p in house if p.building])
    extent = np.stack([ground.min(0), ground.max(0)])
    shots = plan(SPEC.photos, extent, SPEC.rings, None, 0.0, 0.0, rng)
    shots = [replace(shot, name=f"photo_{k:03d}.jpg") for k, shot in enumerate(shots)]
    others = [p for k, spot in enumerate([(-12, 9), (11, 8), (-11, -9)])
              for p in tree(f"tree{k}.", np.array(spot, float), 5.0, rng)]  # fmt: skip
    others += car("car.", np.array([10.0, -9.0]), rng)
    paint_views(whole, SPEC, [*((1, p) for p in house), *((0, p) for p in others)], shots)
    write_photos(whole, SPEC, shots, rng)
    write_truth(whole, house)
    (whole / "sparse_truth").symlink_to(whole / "sparse" / "0")
    shutil.rmtree(out / "scene", ignore_errors=True)
    write_inputs(whole, out / "scene", targets_of(whole), Noise(), 0)
    labels = [read_png(whole / "work" / "ids" / (Path(s.name).stem + ".png")) for s in shots]
    poses = np.array([[*(-s.rotation.T @ s.translation), *s.rotation[2]] for s in shots])
    click_prompts(out / "scene" / "prompts.json", [s.name for s in shots], poses, labels)


def make_job(engine: Path, scene: Path, job: Path) -> None:
    """The job and all that is made of it."""
    shutil.rmtree(job, ignore_errors=True)
    points = ["--crs", CRS, "--control", scene / "points.csv", "--marks", scene / "marks.csv"]
    for command in (
        ["reconstruct", scene, "--prompts", scene / "prompts.json", "--out", job, "--preset", "quick"],
        ["georef", job, *points],
        ["georef", job, *points, "--predict", job.with_name(job.name + ".places.json")],
        ["drawings", job],
        ["models", job],
    ):
        subprocess.run([engine, "-m", "mgf_engine", *map(str, command)], check=True, cwd=REPO)


def begin(window: Window, scene: Path, job: Path) -> None:
    """Import the job, place it where it truly is, and take all our panels out of the sidebar."""
    ops = "bpy.ops.mgf"
    for text in (
        "bpy.context.preferences.system.use_region_overlap = False",
        "[bpy.data.objects.remove(o) for o in list(bpy.data.objects)]",
        f"{ops}.import_colmap(filepath={str(scene)!r})",
        f"{ops}.import_result(directory={str(job)!r})",
        f"g = window.scene.mgf.georef; g.crs, g.control_file = {CRS!r}, {str(scene / 'points.csv')!r}",
        f"{ops}.take_control_points()",
        f"{ops}.import_marks(filepath={str(scene / 'marks.csv')!r})",
        f"{ops}.place_scene()",
        f"{ops}.import_lods()",
        f"{ops}.add_section(axis='FRONT')",
    ):
        window.tell(f"py {text}")
    window.tell(
        "py import builtins; builtins.mgf_panels = {c.__name__: c for c in bpy.types.Panel.__subclasses__()"
        " if c.__name__.startswith('MGF_PT_')};"
        "[bpy.utils.unregister_class(c) for c in reversed(mgf_panels.values()) if c.is_registered]"
    )
    window.tell("editor VIEW_3D")
    window.wait("the sidebar", lambda s: s["regions"]["UI"][2] > 100)


def show_panel(window: Window, name: str) -> None:
    """One panel alone, open, cut out of the screenshot."""
    open_panel(window, name)
    window.move(300, 500)
    time.sleep(1)
    window.shot(f"whole-{name}")
    x, y, w, h = window.region("UI")
    cut = ["convert", window.out / f"whole-{name}.png", "-crop", f"{w - 22}x{h - 2}+{x}+{y}", "+repage"]
    part = ["-crop", "{}x{}+0+0".format(*SHOWN[name]), "+repage"] if name in SHOWN else []
    subprocess.run([*cut, "-fuzz", "1%", "-trim", "+repage", *part, window.out / f"panel-{name}.png"], check=True)
    window.tell(f"py bpy.utils.unregister_class(mgf_panels['MGF_PT_{name}'])")


def open_panel(window: Window, name: str) -> None:
    """Show one panel alone in our tab, open."""
    window.tell(f"py c = mgf_panels['MGF_PT_{name}']; c.bl_options = set(); bpy.utils.register_class(c)")
    time.sleep(1)
    window.tell("tab")


def georeference(window: Window) -> None:
    """Press Georeference Job; the engine finds the coordinates again, and the scene lies there."""
    window.tell("py bpy.ops.mgf.set_up_axis('EXEC_DEFAULT', True, axis='X')")  # no longer in its true place
    open_panel(window, "georef")
    window.press(window.button(GEOREFERENCE), "the job", lambda s: s["jobs"] and s["jobs"][-1][0] == "georef")
    state = window.wait("the end", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 300)
    assert state["jobs"][-1][1] == "DONE", state["jobs"][-1]
    window.wait("the true place", lambda s: s["scene_keys"].get("SRID") == CRS, 30)
    time.sleep(2)
    window.shot("georeferenced")
    window.tell("py bpy.utils.unregister_class(mgf_panels['MGF_PT_georef'])")
    print("georeferenced by the panel's button", flush=True)


def show_marks(window: Window, scene: Path) -> None:
    """A photo with rings and marks, and the magnifier at one of them."""
    with (scene / "marks.csv").open(newline="") as file:
        rows = {(r["name"], r["photo"]): (float(r["x"]), float(r["y"])) for r in csv.DictReader(file)}
    window.tell("py [bpy.utils.register_class(c) for c in mgf_panels.values()]")
    window.tell("py g = window.scene.mgf.georef; g.marking, g.index = True, g.points.find('P1')")
    window.tell("py bpy.ops.mgf.next_marked_photo(step=1); bpy.ops.mgf.mark_control_points()")
    state = window.wait(
        "the photo", lambda s: s["area"] == "IMAGE_EDITOR" and s["tool"] == "mgf.point_tool" and s["image"]
    )
    window.tell("fit")
    photo = state["photos"][state["photo_index"]]
    u, v = (a / b for a, b in zip(rows["P1", photo["name"]], photo["size"], strict=True))
    window.move(*window.image_point(u, v))
    window.settle(3)
    window.shot("whole-control-points")
    (x0, y0), (x1, y1) = window.image_point(0, 0), window.image_point(1, 1)
    part = f"{x1 - x0:.0f}x{y1 - y0 + 24:.0f}+{x0:.0f}+{y0 - 24:.0f}"
    cut = ["convert", window.out / "whole-control-points.png", "-crop", part, "+repage"]
    subprocess.run([*cut, window.out / "control-points.png"], check=True)


if __name__ == "__main__":
    sys.exit(main())
