# SPDX-License-Identifier: GPL-3.0-or-later
"""A walk of random operators, undos, redos, scene switches, saves and reopenings, for a process of its own.

    PYTHONPATH=.:tests:tests/blender python tests/blender/walk.py SEED STEPS FOLDER        (an environment with bpy)

After each step every panel is drawn, the view layer updated, and panel, viewport and files compared. Ends with 0 and
``survived`` when nothing crashed, raised or disagreed; each step is printed, so the last line tells where it ended.
"""

from __future__ import annotations

import faulthandler
import os
import random
import shutil
import sys
import time
import traceback
from pathlib import Path

import bpy
import synthetic
from layouts import draw

import mgf_blender
from mgf_blender.common import runner
from mgf_blender.common.errors import UserError
from mgf_blender.common.job import DONE
from mgf_blender.drawings.panel import MGF_PT_drawings
from mgf_blender.drawings.sections import find_sections
from mgf_blender.georef.panel import MGF_PT_control_points, MGF_PT_georef
from mgf_blender.georef.properties import set_mark
from mgf_blender.jobs import import_status
from mgf_blender.prompts import files
from mgf_blender.prompts.panel import MGF_PT_masks, MGF_PT_prompts
from mgf_blender.reconstruct import preview_image, start
from mgf_blender.reconstruct.panel import MGF_PT_mark, MGF_PT_options, MGF_PT_reconstruct
from mgf_blender.results import async_import, surface, view_mode
from mgf_blender.results.panel import MGF_PT_results
from mgf_blender.scene_import.crop import crop_text
from mgf_blender.scene_import.imported_scene import KINDS, ImportedScene
from mgf_blender.scene_import.panel import MGF_PT_placement, MGF_PT_scene, MGF_PT_source
from mgf_blender.scene_keys import scene_of

PANELS = (MGF_PT_scene, MGF_PT_placement, MGF_PT_source, MGF_PT_mark, MGF_PT_reconstruct, MGF_PT_options,
          MGF_PT_results, MGF_PT_prompts, MGF_PT_masks, MGF_PT_drawings, MGF_PT_georef,
          MGF_PT_control_points)  # fmt: skip


class Walk:
    """The walker: its dice, its files, and a method for each kind of step."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.dice = random.Random(seed)
        self.folder = folder
        self.house = synthetic.write_house(folder / "house")
        self.plain = synthetic.write_house(folder / "plain", tilt=False)
        self.blends: list[Path] = []
        os.environ["FAKE_RESULT"] = str(shutil.copytree(self.house.job, folder / "finished"))
        os.environ["FAKE_PHOTOS"] = "|".join(sorted(self.house.poses)[:4])
        os.environ["FAKE_GEOREF"] = str(folder / "georef.json")
        (folder / "georef.json").write_text(_GEOREF)
        for house in (self.house, self.plain):
            synthetic.write_png(house.folder / "preview.png", synthetic._gradient(8, 6))
        self.steps = {name.removeprefix("step_"): getattr(self, name) for name in dir(self) if name.startswith("step_")}
        self.weights = [_WEIGHTS.get(name, 2) for name in self.steps]

    def go(self) -> str:
        """One step; returns its name."""
        (name,) = self.dice.choices(list(self.steps), self.weights)
        print(name, end=" ", flush=True)
        try:
            self.steps[name]()
        except (RuntimeError, UserError) as error:  # an operator that says why not, or whose poll does
            text = str(error)
            if "Traceback" in text or "made a mistake" in text:
                raise
            print(f"({text.strip().splitlines()[-1][:60]})", end=" ")
        return name

    def a_house(self) -> synthetic.House:
        return self.dice.choice((self.house, self.house, self.plain))

    def call(self, operator: str, /, **properties: object) -> None:
        getattr(bpy.ops.mgf, operator)("EXEC_DEFAULT", True, **properties)

    def step_import(self) -> None:
        self.call("import_colmap", filepath=str(self.a_house().folder), replace=self.dice.random() < 0.7)

    def step_again(self) -> None:
        self.call("reload_scene")

    def step_result(self) -> None:
        self.call("import_result", directory=str(self.a_house().job))

    def step_arrive(self) -> None:
        """In any scene, with a step of the user's in between."""
        async_import.begin(self.dice.choice(bpy.data.scenes), self.a_house().job)
        if self.dice.random() < 0.5:
            for _ in range(self.dice.randrange(6)):
                async_import.pump()
            self.dice.choice((self.step_undo, self.step_switch, self.step_delete, self.step_cube))()

    def step_reconstruct(self) -> None:
        scene = bpy.context.scene
        if len(scene.mgf.photos):
            files.add_click(scene.mgf.photos[0], 9, 9, False, "building")
            bpy.ops.ed.undo_push(message="click")
        if scene.mgf.source and not runner.live_job(scene.mgf.key or "none"):
            runner.submit(start.make_job(scene))

    def step_camera(self) -> None:
        self.call("look_through", step=self.dice.randrange(-1, 3))

    def step_show(self) -> None:
        self.call("show_in_camera", kind=self.dice.choice(view_mode.KINDS))

    def step_paint(self) -> None:
        self.call("paint_mesh", kind=self.dice.choice(list(surface.KINDS)))

    def step_axis(self) -> None:
        self.call("set_up_axis", axis=self.dice.choice(("CAMERAS", "X", "NEG_Y", "Z")))

    def step_scale(self) -> None:
        self.call("set_scale", distance=self.dice.uniform(0.5, 2.0))

    def step_crop(self) -> None:
        self.call(self.dice.choice(("add_crop_box", "select_crop_box", "remove_crop_box")))

    def step_section(self) -> None:
        """A plane of ours, one of the user's, or none any more."""
        names = [o.name for o in find_sections(bpy.context.scene)]
        if names and self.dice.random() < 0.4:
            self.call("remove_section", name=self.dice.choice(names))
        elif self.dice.random() < 0.7:
            self.call("add_section", axis=self.dice.choice(("LEVEL", "FRONT", "SIDE")))
        else:
            self.call("use_as_section")

    def step_drawings(self) -> None:
        self.call("make_drawings")

    def step_points(self) -> None:
        """Read the points, mark one, look at the next photo, run."""
        scene = bpy.context.scene
        scene.mgf.georef.control_file = "//points.csv"
        if len(scene.mgf.photos):
            set_mark(scene, "P1", scene.mgf.photos[0].name, (9, 9))
        bpy.ops.ed.undo_push(message="mark")
        self.call(self.dice.choice(("predict_places", "next_marked_photo", "georeference", "place_scene")))

    def step_photo(self) -> None:
        self.call(self.dice.choice(("next_photo", "add_photo", "remove_photo", "clear_clicks", "reset_options")))

    def step_preview(self) -> None:
        """As the engine's message does: no undo step; then shown in an Image Editor."""
        preview_image.show(self.a_house().folder / "preview.png")
        area = max(bpy.context.window.screen.areas, key=lambda a: a.width * a.height)
        if self.dice.random() < 0.5 and area.type == "IMAGE_EDITOR":
            area.spaces.active.image = bpy.data.images[preview_image.NAME]

    def step_editor(self) -> None:
        area = max(bpy.context.window.screen.areas, key=lambda a: a.width * a.height)
        area.type = self.dice.choice(("VIEW_3D", "IMAGE_EDITOR"))

    def step_undo(self) -> None:
        for _ in range(self.dice.choice((1, 1, 1, 2, 3, 6))):
            bpy.ops.ed.undo()

    def step_redo(self) -> None:
        for _ in range(self.dice.choice((1, 1, 2, 4))):
            bpy.ops.ed.redo()

    def step_scene(self) -> None:
        if len(bpy.data.scenes) < 4:
            bpy.ops.scene.new("EXEC_DEFAULT", True, type=self.dice.choice(("NEW", "EMPTY", "LINK_COPY", "FULL_COPY")))
            bpy.ops.ed.undo_push(message="scene")
        elif self.dice.random() < 0.5:
            bpy.ops.scene.delete("EXEC_DEFAULT", True)
            bpy.ops.ed.undo_push(message="scene")

    def step_switch(self) -> None:
        bpy.context.window.scene = self.dice.choice(bpy.data.scenes)
        bpy.ops.ed.undo_push(message="switch")

    def step_cube(self) -> None:
        if bpy.context.mode == "OBJECT":
            bpy.ops.mesh.primitive_cube_add("EXEC_DEFAULT", True)

    def step_mode(self) -> None:
        layer = bpy.context.view_layer
        if bpy.context.mode == "OBJECT" and len(layer.objects):
            layer.objects.active = self.dice.choice(layer.objects)
        active = layer.objects.active
        if active is not None and active.type == "MESH":
            bpy.ops.object.mode_set("EXEC_DEFAULT", True, mode=self.dice.choice(("OBJECT", "OBJECT", "EDIT", "SCULPT")))

    def step_delete(self) -> None:
        """Objects, one after the other or with all of a collection."""
        if bpy.context.mode != "OBJECT" or not len(bpy.context.view_layer.objects):
            return
        chosen = self.dice.choice(bpy.context.view_layer.objects)
        parts = chosen.users_collection[0].objects if self.dice.random() < 0.3 else [chosen]
        for obj in list(parts):
            bpy.data.objects.remove(obj)
        bpy.ops.ed.undo_push(message="delete")

    def step_save(self) -> None:
        path = self.folder / f"{len(self.blends)}.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        self.blends.append(path)

    def step_open(self) -> None:
        if self.blends:
            bpy.ops.wm.open_mainfile(filepath=str(self.dice.choice(self.blends)), load_ui=self.dice.random() < 0.5)
        else:
            bpy.ops.wm.read_homefile(use_empty=True)
        bpy.ops.ed.undo_push(message="open")  # as a window does


_GEOREF = """{"to_local": [[0, -2, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]], "offset": [691234, 5334876, 0],
 "crs": "EPSG:25832", "unit": "metre", "north_known": true, "origin": [48.1, 11.6, 500]}"""
_WEIGHTS = {"undo": 12, "redo": 6, "result": 4, "arrive": 4, "show": 4, "paint": 3, "open": 1, "save": 1, "mode": 3,
            "reconstruct": 1}  # fmt: skip


def pump() -> None:
    """What the timers do between two steps of the user."""
    for timer in (runner._tick, async_import._tick):
        timer()


def check() -> None:
    """Panel, viewport and files agree in every scene."""
    for scene in bpy.data.scenes:
        scene.view_layers[0].update()
        imported = ImportedScene.find(scene)
        crop_text(imported)
        if imported is None:
            continue
        counts = {kind: len(imported.objects(kind)) for kind in KINDS}
        assert counts["Mesh"] <= 1, counts
        for obj in (o for kind in KINDS for o in imported.objects(kind)):
            assert obj.name and obj.parent in (imported.root, *imported.objects("Cameras"), None), obj.name
        check_viewports(scene, imported)
        for camera in imported.objects("Cameras"):
            check_camera(camera)
    for cls in PANELS:
        draw(cls)
    for job in runner.jobs():
        scene = scene_of(job.scene_key)
        assert not any("mistake" in text for text in (job.text, *job.warnings)), (job.text, job.warnings)
        assert job.live or job.status == DONE, (job.status, job.text)
        assert scene is None or runner.jobs(scene.mgf.key or job.scene_key)
    assert not any("mistake" in text for text in import_status._problems.values()), import_status._problems.values()


def check_viewports(scene: bpy.types.Scene, imported: ImportedScene) -> None:
    """Viewports of the window that draw our colours draw what the mesh is painted with."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas if window.scene == scene and imported.objects("Mesh") else ():
            drawn = area.spaces.active.shading.color_type if area.type == "VIEW_3D" else ""
            if drawn in {"TEXTURE", "VERTEX"}:
                assert (drawn == "TEXTURE") == imported.shows_texture, drawn


def check_camera(camera: bpy.types.Object) -> None:
    """A camera shows what the panel says of it, and no picture is of a file that a job never had."""
    slots = [s for s in camera.data.background_images if s.image is not None]
    kinds = [s.image.get("mgf_image") for s in slots]
    assert len(set(kinds)) == len(kinds), kinds
    shown = [s.image.get("mgf_image") for s in slots if s.show_background_image]
    kind = camera.get("mgf_shown")
    if kind in {"PHOTO", "RENDER", "ERROR"}:
        assert shown == [kind.lower()], (kind, shown)


def main(seed: int, count: int, folder: Path) -> None:
    """Walk."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.use_global_undo = True
    bpy.context.preferences.view.show_splash = False
    mgf_blender.register()
    start.in_background = lambda: False  # results arrive by steps, as in the window
    bpy.ops.ed.undo_push(message="start")
    walk = Walk(seed, folder)
    for number in range(count):
        print(f"\n{number}", end=" ", flush=True)
        walk.go()
        pump()
        check()
    end = time.monotonic() + 20
    while (runner.pump() or async_import.pump()) and time.monotonic() < end:
        time.sleep(0.01)
    check()
    assert not any(job.live for job in runner.jobs()) and not async_import._imports


if __name__ == "__main__":
    faulthandler.enable()
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    try:
        main(int(words[0]), int(words[1]), Path(words[2]))
    except BaseException:
        traceback.print_exc(file=sys.stdout)
        sys.stdout.flush()
        os._exit(1)
    runner.stop_all()
    print("\nsurvived", flush=True)
    os._exit(0)
