# SPDX-License-Identifier: GPL-3.0-or-later
"""Every operator of the add-on in every odd state, for a process of its own: none may raise, or fail half done.

    export BLENDER_USER_RESOURCES=FOLDER/user
    python tests/blender/odd_states.py SEED CALLS FOLDER                      (an environment with bpy)
    blender -b --python tests/blender/odd_states.py -- SEED CALLS FOLDER

CALLS is how many calls are drawn at random, some in two states at once; 0 makes every operator's call in every state.
Before and after each call all panels are drawn; an operator that fails has to say so in one sentence and leave
Blender's data as they were. Faults are printed, with what makes them again; ends with 0 and ``survived`` without any.
"""

from __future__ import annotations

import collections
import contextlib
import faulthandler
import io
import json
import math
import os
import random
import re
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
import bpy
import finished_work
import synthetic
from jobs import write_engine
from layouts import Recorder, draw
from mathutils import Matrix

import mgf_blender
from mgf_blender.common import runner
from mgf_blender.common.errors import UserError
from mgf_blender.engine import operators as engine_operators
from mgf_blender.georef.files import places_path
from mgf_blender.georef.properties import set_mark
from mgf_blender.prompts import files, preview
from mgf_blender.reconstruct.start import make_job
from mgf_blender.results import async_import
from mgf_blender.scene_import.crop import find_crop_box
from mgf_blender.scene_import.tree import ROLE_KEY, Tree

WORK, PURE = "work", "pure"  # what is on disk during a call, and as it was made
#: They open programs of the system, or install.
SKIPPED = {"open_engine_log", "install_engine", "show_preferences"}
BASES = ("empty", "imported", "finished")


def operators() -> list[str]:
    """The add-on's operators."""
    return [name for name in dir(bpy.ops.mgf) if name not in SKIPPED]


class Stage:
    """The files, and Blender's data as .blend files that states begin with."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.work = folder, folder / WORK
        pure = folder / PURE
        house = synthetic.write_house(pure / "house")
        plain = synthetic.write_house(pure / "plain", tilt=False)
        finished_work.write_models(house.job / "models")
        finished_work.write_town(pure / "Ostviertel", house.job)
        self.photos = sorted(house.poses)
        synthetic.write_png(pure / "house" / "picture.png", synthetic._gradient(8, 6))
        shutil.copytree(plain.job, pure / "other job")
        write_engine(folder / "engine home")
        _write_job_files(house.job, pure / "house" / "picture.png", self.photos)
        (pure / "prompts.json").write_text(json.dumps({self.photos[0]: {"positive": [[50, 60]], "negative": []}}))
        (pure / "marks.csv").write_text(f"name,photo,x,y\nP1,{self.photos[1]},20,30\n")
        (pure / "points.csv").write_text("name,east,north,height\nP1,1,2,3\nP2,4,5,6\n")
        (pure / "noise.bin").write_bytes(random.Random(1).randbytes(2000))
        (pure / "empty").mkdir()
        environment = {"MGF_ENGINE_PYTHON": folder / "engine home" / "python", "FAKE_RESULT": pure / "house" / "job",
                       "FAKE_MODELS": house.job / "models", "FAKE_MODEL": house.model,
                       "FAKE_GEOREF": house.job / "georef.json", "FAKE_PHOTOS": "|".join(self.photos[:4])}  # fmt: skip
        os.environ.update({name: str(value) for name, value in environment.items()})
        self.environment = dict(os.environ)
        self.reset_files()
        self._write_bases()

    def reset_files(self) -> None:
        """Put what is on disk back."""
        if self.work.exists() and self._on_disk() == self._made:
            return
        if self.work.exists():
            os.chmod(self.work, 0o755)
            for path in self.work.rglob("*"):
                if path.is_dir() and not path.is_symlink():
                    path.chmod(0o755)
            shutil.rmtree(self.work)
        shutil.copytree(self.folder / PURE, self.work)
        self._made = self._on_disk()

    def _on_disk(self) -> list[tuple[object, ...]]:
        found = []
        for folder, _, names in os.walk(self.work):
            for path in (folder, *(os.path.join(folder, name) for name in names)):
                facts = os.lstat(path)
                found.append((path, facts.st_mode, facts.st_size, facts.st_mtime_ns))
        return found

    def begin(self, base: str) -> None:
        """Begin a call: files, environment, no job, and the data of a base."""
        runner.stop_all()
        async_import.unregister()
        async_import.register()
        async_import._problems.clear()
        preview.forget()
        engine_operators.forget()
        os.environ.clear()
        os.environ.update(self.environment)
        self.reset_files()
        bpy.ops.wm.open_mainfile(filepath=str(self.folder / f"{base}.blend"), load_ui=False)
        bpy.ops.ed.undo_push(message="begin")

    def _write_bases(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.preferences.edit.use_global_undo = True
        mgf_blender.register()
        bpy.ops.wm.save_as_mainfile(filepath=str(self.folder / "empty.blend"))
        ops, scene = bpy.ops.mgf, bpy.context.scene
        ops.import_colmap(filepath=str(self.work / "house"))
        scene.mgf.job_folder = str(self.work / "house" / "job")
        for photo in scene.mgf.photos:
            files.add_click(photo, 90, 80, False, "building")
            files.add_click(photo, 9, 9, True, "building", proposed=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(self.folder / "imported.blend"))
        ops.import_result(directory=str(self.work / "house" / "job"))
        ops.import_lods()
        ops.add_section(axis="FRONT")
        ops.add_crop_box()
        ops.import_town(directory=str(self.work / "Ostviertel"))
        state = scene.mgf.georef
        state.control_file = str(self.work / "points.csv")
        ops.take_control_points()
        set_mark(scene, "P1", self.photos[0], (9, 9))
        ops.place_scene()
        bpy.data.objects["a"].select_set(True)
        bpy.data.images.load(str(self.work / "house" / "picture.png")).name = "MGF Preview"
        bpy.ops.wm.save_as_mainfile(filepath=str(self.folder / "library.blend"))  # no file can link from itself
        bpy.ops.wm.save_as_mainfile(filepath=str(self.folder / "finished.blend"))


def _write_job_files(job: Path, picture: Path, photos: list[str]) -> None:
    """What commands other than the reconstruction leave in a job folder."""
    matrix = [[0, -2, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]]
    place = {"to_local": matrix, "offset": [691234, 5334876, 0], "crs": "EPSG:25832", "unit": "metre",
             "north_known": True, "origin": [48.1, 11.6, 500]}  # fmt: skip
    (job / "georef.json").write_text(json.dumps(place))
    points = [{"name": name, "role": "control", "by": "", "pixels": None, "wrong": [],
               "photos": {photos[0]: [10, 10, 5]}} for name in ("P1", "P2")]  # fmt: skip
    places_path(job).write_text(json.dumps({"format": 1, "crs": "", "points": points}))
    (job / "drawings").mkdir()
    shutil.copyfile(picture, job / "drawings" / "orthophoto-A.png")
    index = {"format": 1, "unit": "metre", "files": {"orthophoto-A.png": {"kind": "orthophoto", "frame": "A"}}}
    (job / "drawings" / "drawings.json").write_text(json.dumps(index))
    for run in "123":
        (job / "runs" / run).mkdir(parents=True)
        (job / "runs" / run / "run.json").write_text("{}")
    (job / "job.json").write_text(json.dumps({"source": "", "given": {"iterations": 50}, "stages": {"scene": {}}}))
    (job / "log.txt").write_text("log\n")


# States: each changes what is on disk, or Blender's data, or the context, and is named by its function.


def _tree() -> Tree | None:
    return Tree.find(bpy.context.scene)


def _objects(kind: str) -> list[bpy.types.Object]:
    tree = _tree()
    return tree.objects(kind) if tree is not None else []


def _mesh() -> bpy.types.Object | None:
    return next(iter(_objects("Mesh")), None)


def as_it_is(stage: Stage) -> None: ...


def no_active_camera(stage: Stage) -> None:
    bpy.context.scene.camera = None


def foreign_camera(stage: Stage) -> None:
    camera = bpy.data.objects.new("mine", bpy.data.cameras.new("mine"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera


def camera_is_a_cube(stage: Stage) -> None:
    """Blender lets any object be the camera."""
    bpy.context.scene.camera = _cube()


def cameras_deleted(stage: Stage) -> None:
    bpy.data.batch_remove(_objects("Cameras"))


def origin_deleted(stage: Stage) -> None:
    if _tree() is not None:
        bpy.data.objects.remove(_tree().root)


def origin_scaled_to_zero(stage: Stage) -> None:
    if _tree() is not None:
        _tree().root.scale = 0, 0, 0


def origin_flattened(stage: Stage) -> None:
    if _tree() is not None:
        _tree().root.scale = 1, 0, 1


def origin_hung_elsewhere(stage: Stage) -> None:
    if _tree() is not None:
        _tree().root.parent = _cube()


def origin_locked_away(stage: Stage) -> None:
    """In a collection outside the scene."""
    if _tree() is not None:
        bpy.context.scene.collection.children.unlink(_tree().collection)


def collection_deleted(stage: Stage) -> None:
    if _tree() is not None:
        bpy.data.collections.remove(_tree().collection)


def collections_below_deleted(stage: Stage) -> None:
    if _tree() is not None:
        bpy.data.batch_remove(list(_tree().collection.children))


def collection_excluded(stage: Stage) -> None:
    for child in bpy.context.view_layer.layer_collection.children:
        child.exclude = True


def everything_hidden(stage: Stage) -> None:
    for obj in bpy.context.view_layer.objects:
        obj.hide_set(True)


def everything_selected(stage: Stage) -> None:
    for obj in bpy.context.view_layer.objects:
        obj.select_set(True)


def everything_unlinked(stage: Stage) -> None:
    for obj in list(bpy.data.objects):
        for collection in list(obj.users_collection):
            collection.objects.unlink(obj)


def mesh_deleted(stage: Stage) -> None:
    bpy.data.batch_remove(_objects("Mesh"))


def mesh_data_emptied(stage: Stage) -> None:
    if _mesh() is not None:
        _mesh().data.clear_geometry()


def mesh_without_colors_or_materials(stage: Stage) -> None:
    if _mesh() is not None:
        _mesh().data.materials.clear()
        for layer in list(_mesh().data.color_attributes):
            _mesh().data.color_attributes.remove(layer)


def materials_without_nodes(stage: Stage) -> None:
    for material in bpy.data.materials:
        if material.node_tree is not None:
            material.node_tree.nodes.clear()


def mesh_with_empty_slots(stage: Stage) -> None:
    if _mesh() is not None:
        _mesh().data.materials.append(None)


def mesh_duplicated(stage: Stage) -> None:
    for obj in (_mesh(), *_objects("Cameras")[:1], *_objects("Points")[:1]):
        if obj is not None:
            double = obj.copy()
            double.data = obj.data.copy()
            obj.users_collection[0].objects.link(double)


def tree_duplicated(stage: Stage) -> None:
    if _tree() is not None:
        double = _tree().collection.copy()
        bpy.context.scene.collection.children.link(double)


def second_import(stage: Stage) -> None:
    bpy.ops.mgf.import_colmap(filepath=str(stage.work / "plain"), replace=False)


def properties_of_ours_removed(stage: Stage) -> None:
    for obj in bpy.data.objects:
        for name in [n for n in sorted(obj.keys()) if n.startswith("mgf_") and n not in {"mgf_kind", ROLE_KEY}]:
            del obj[name]


def mesh_in_edit_mode(stage: Stage) -> None:
    _enter(_mesh(), "EDIT")


def mesh_in_sculpt_mode(stage: Stage) -> None:
    _enter(_mesh(), "SCULPT")


def mesh_in_vertex_paint(stage: Stage) -> None:
    _enter(_mesh(), "VERTEX_PAINT")


def points_in_edit_mode(stage: Stage) -> None:
    _enter(next(iter(_objects("Points")), None), "EDIT")


def cube_in_edit_mode(stage: Stage) -> None:
    _enter(_cube(), "EDIT")


def text_in_edit_mode(stage: Stage) -> None:
    text = bpy.data.objects.new("text", bpy.data.curves.new("text", "FONT"))
    bpy.context.scene.collection.objects.link(text)
    _enter(text, "EDIT")


def armature_in_pose_mode(stage: Stage) -> None:
    bones = bpy.data.objects.new("bones", bpy.data.armatures.new("bones"))
    bpy.context.scene.collection.objects.link(bones)
    _enter(bones, "POSE")


def two_meshes_selected(stage: Stage) -> None:
    for number in range(2):
        cube = _cube()
        cube.select_set(True)
        cube.location.x = number


def new_scene_shown(stage: Stage) -> None:
    _show(bpy.data.scenes.new("new"))


def full_copy_shown(stage: Stage) -> None:
    bpy.ops.scene.new(type="FULL_COPY")


def linked_copy_shown(stage: Stage) -> None:
    bpy.ops.scene.new(type="LINK_COPY")


def scene_removed(stage: Stage) -> None:
    """The one with the work; another is shown."""
    old = bpy.context.scene
    _show(bpy.data.scenes.new("other"))
    bpy.data.scenes.remove(old)


def collections_linked(stage: Stage) -> None:
    """From a file of another; the own scene is empty."""
    bpy.ops.wm.open_mainfile(filepath=str(stage.folder / "empty.blend"), load_ui=False)
    _append(stage, "collections")
    for collection in bpy.data.collections:
        if collection.library is not None and collection.get(ROLE_KEY) == "tree":
            bpy.context.scene.collection.children.link(collection)
    for collection in bpy.data.collections:
        if collection.library is not None and "mgf_town" in collection:
            bpy.context.scene.collection.children.link(collection)
    for obj in bpy.context.view_layer.objects:
        obj.select_set(True)


def collections_overridden(stage: Stage) -> None:
    collections_linked(stage)
    for child in list(bpy.context.scene.collection.children):
        child.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)


def linked_beside_own(stage: Stage) -> None:
    _append(stage, "collections")
    for collection in bpy.data.collections:
        if collection.library is not None and (collection.get(ROLE_KEY) == "tree" or "mgf_town" in collection):
            bpy.context.scene.collection.children.link(collection)


def linked_scene_shown(stage: Stage) -> None:
    _append(stage, "scenes")
    _show(next(scene for scene in bpy.data.scenes if scene.library is not None))


def photos_deleted(stage: Stage) -> None:
    for folder in ("house", "plain"):
        shutil.rmtree(stage.work / folder / "images")


def photos_are_texts(stage: Stage) -> None:
    for path in (stage.work / "house" / "images").rglob("*.png"):
        path.write_text("no picture")


def photo_list_emptied(stage: Stage) -> None:
    bpy.context.scene.mgf.photos.clear()


def photo_index_wild(stage: Stage) -> None:
    bpy.context.scene.mgf.photo_index = 10**6
    bpy.context.scene.mgf.georef.index = -5


def photos_of_no_size(stage: Stage) -> None:
    for photo in bpy.context.scene.mgf.photos:
        photo.width = photo.height = 0


def clicks_wild(stage: Stage) -> None:
    for photo in bpy.context.scene.mgf.photos:
        for click in photo.clicks:
            click.uv, click.part = (math.nan, math.inf), ' "\n\\'


def source_deleted(stage: Stage) -> None:
    shutil.rmtree(stage.work / "house")


def source_is_a_file(stage: Stage) -> None:
    bpy.context.scene.mgf.source = str(stage.work / "noise.bin")


def source_nowhere(stage: Stage) -> None:
    bpy.context.scene.mgf.source = "//../../nowhere/ü \t"


def source_without_job_folder(stage: Stage) -> None:
    bpy.context.scene.mgf.source, bpy.context.scene.mgf.job_folder = str(stage.work / "house"), ""


def model_cut(stage: Stage) -> None:
    path = stage.work / "house" / "sparse" / "0" / "images.bin"
    path.write_bytes(path.read_bytes()[:500])


def model_is_noise(stage: Stage) -> None:
    for path in (stage.work / "house" / "sparse" / "0").iterdir():
        shutil.copyfile(stage.work / "noise.bin", path)


def job_folder_deleted(stage: Stage) -> None:
    shutil.rmtree(stage.work / "house" / "job")


def job_folder_is_a_file(stage: Stage) -> None:
    job_folder_deleted(stage)
    (stage.work / "house" / "job").write_text("no folder")


def job_folder_is_root(stage: Stage) -> None:
    bpy.context.scene.mgf.job_folder = "/proc"


def job_folder_of_others(stage: Stage) -> None:
    bpy.context.scene.mgf.job_folder = str(stage.work / "other job")


def job_files_empty(stage: Stage) -> None:
    _each_job_file(stage, lambda path: path.write_bytes(b""))


def job_files_noise(stage: Stage) -> None:
    _each_job_file(stage, lambda path: shutil.copyfile(stage.work / "noise.bin", path))


def job_files_lists(stage: Stage) -> None:
    _each_job_file(stage, lambda path: path.write_text("[[1], null]") if path.suffix == ".json" else None)


def job_files_of_nulls(stage: Stage) -> None:
    _each_job_file(stage, _with_nulls)


def job_files_folders(stage: Stage) -> None:
    def swap(path: Path) -> None:
        path.unlink()
        path.mkdir()

    _each_job_file(stage, swap)


def job_files_cut(stage: Stage) -> None:
    _each_job_file(stage, lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3]))


def nothing_readable(stage: Stage) -> None:
    _each_file(stage, 0o000)


def nothing_writable(stage: Stage) -> None:
    _each_file(stage, 0o444)
    for path in (stage.work, *stage.work.rglob("*")):
        if path.is_dir():
            path.chmod(0o555)


def job_running(stage: Stage) -> None:
    os.environ["FAKE_ENGINE"] = "slow"
    if bpy.context.scene.mgf.source:
        runner.submit(make_job(bpy.context.scene))
        runner.pump()


def job_of_another_scene_running(stage: Stage) -> None:
    job_running(stage)
    _show(bpy.data.scenes.new("other"))


def job_failed(stage: Stage) -> None:
    os.environ["FAKE_ENGINE"] = "silent"
    if bpy.context.scene.mgf.source:
        runner.submit(make_job(bpy.context.scene))
        _finish_jobs()


def result_arriving(stage: Stage) -> None:
    async_import.begin(bpy.context.scene, stage.work / "house" / "job")
    for _ in range(3):
        async_import.pump()


def preview_running(stage: Stage) -> None:
    os.environ["FAKE_ENGINE"] = "slow"
    photos = bpy.context.scene.mgf.photos
    if len(photos):
        preview.start(bpy.context.scene, photos[0])


def engine_says_no(stage: Stage) -> None:
    os.environ["FAKE_ENGINE"] = "bad"


def engine_dies(stage: Stage) -> None:
    os.environ["FAKE_ENGINE"] = "silent"


def engine_babbles(stage: Stage) -> None:
    os.environ["FAKE_ENGINE"] = "noise"


def no_engine(stage: Stage) -> None:
    del os.environ["MGF_ENGINE_PYTHON"]


def engine_not_a_program(stage: Stage) -> None:
    os.environ["MGF_ENGINE_PYTHON"] = str(stage.work / "noise.bin")


def options_wild(stage: Stage) -> None:
    values = bpy.context.scene.mgf.options
    for prop in values.bl_rna.properties:
        if prop.type == "STRING" and not prop.is_readonly:
            setattr(values, prop.identifier, "= ' \" -- \n")


def nothing_chosen(stage: Stage) -> None:
    bpy.context.scene.mgf.drawings.kinds = set()
    bpy.context.scene.mgf.models.kinds = set()
    bpy.context.scene.mgf.part = " "


def town_deleted(stage: Stage) -> None:
    shutil.rmtree(stage.work / "Ostviertel")


def town_damaged(stage: Stage) -> None:
    (stage.work / "Ostviertel" / "buildings" / "b" / "light.ply").write_text("ply\n")
    (stage.work / "Ostviertel" / "buildings" / "a" / "job" / "mesh.ply").write_text("ply\n")


def images_without_files(stage: Stage) -> None:
    for image in bpy.data.images:
        image.filepath = "//gone.png"


def images_removed(stage: Stage) -> None:
    bpy.data.batch_remove([i for i in bpy.data.images if i.library is None])


def images_generated(stage: Stage) -> None:
    for image in bpy.data.images:
        image.source = "GENERATED"


def undo_off(stage: Stage) -> None:
    bpy.context.preferences.edit.use_global_undo = False


def unsaved(stage: Stage) -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def _cube() -> bpy.types.Object:
    mesh = bpy.data.meshes.new("cube")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    cube = bpy.data.objects.new("cube", mesh)
    bpy.context.scene.collection.objects.link(cube)
    return cube


def _enter(obj: bpy.types.Object | None, mode: str) -> None:
    if obj is None:
        return
    bpy.context.view_layer.update()
    if obj.name not in bpy.context.view_layer.objects:
        return
    obj.hide_set(False)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode=mode)


def _show(scene: bpy.types.Scene) -> None:
    bpy.context.window.scene = scene
    bpy.context.view_layer.update()


def _append(stage: Stage, kind: str) -> None:
    with bpy.data.libraries.load(str(stage.folder / "library.blend"), link=True) as (there, here):
        setattr(here, kind, list(getattr(there, kind)))


def _each_job_file(stage: Stage, change: Callable[[Path], object]) -> None:
    """Change every file in the job folder, and those beside it."""
    job = stage.work / "house" / "job"
    for path in [*(p for p in job.rglob("*") if p.is_file()), places_path(job)]:
        change(path)


def _with_nulls(path: Path) -> None:
    if path.suffix == ".json":
        path.write_text(re.sub(r"(?<=[:\[,] )[-\d.]+(?=[,\]}])", "null", path.read_text()))


def _each_file(stage: Stage, mode: int) -> None:
    for path in stage.work.rglob("*"):
        if path.is_file():
            path.chmod(mode)


def _finish_jobs(seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while (runner.pump() or async_import.pump()) and time.monotonic() < end:
        time.sleep(0.005)


STATES = {
    name: value
    for name, value in list(globals().items())
    if callable(value) and getattr(value, "__annotations__", {}).get("stage") == "Stage" and not name.startswith("_")
}


# Contexts that a call is made in.


@contextlib.contextmanager
def _editor(kind: str, image: str = "") -> Iterator[None]:
    window = bpy.context.window_manager.windows[0]
    area = max(window.screen.areas, key=lambda a: a.width * a.height)
    area.type = kind
    if kind == "IMAGE_EDITOR":
        area.spaces.active.image = next((i for i in bpy.data.images if i.get("mgf_image") == image), None)
    region = next((r for r in area.regions if r.type == "WINDOW"), area.regions[-1])
    with bpy.context.temp_override(window=window, area=area, region=region):
        yield
    area.type = "VIEW_3D"


CONTEXTS: dict[str, Callable[[], contextlib.AbstractContextManager[object]]] = {
    "here": contextlib.nullcontext,
    "viewport": lambda: _editor("VIEW_3D"),
    "photo": lambda: _editor("IMAGE_EDITOR", "photo"),
    "empty image editor": lambda: _editor("IMAGE_EDITOR"),
    "text editor": lambda: _editor("TEXT_EDITOR"),
    "no window": lambda: bpy.context.temp_override(window=None),
}


class Arguments:
    """Values for the properties of operators, good ones and others."""

    def __init__(self, dice: random.Random, stage: Stage) -> None:
        self.dice, self.stage = dice, stage

    def draw(self, operator: str) -> dict[str, object]:
        """Draw values for some of an operator's properties."""
        kind = getattr(bpy.ops.mgf, operator).get_rna_type()
        given = {}
        for prop in kind.properties:
            if prop.identifier != "rna_type" and not prop.is_readonly and self.dice.random() < 0.8:
                given[prop.identifier] = self._value(prop)
        return {name: value for name, value in given.items() if value is not None}

    def _value(self, prop: bpy.types.Property) -> object:
        dice, work = self.dice, self.stage.work
        if prop.type == "BOOLEAN":
            return dice.random() < 0.5
        if prop.type == "ENUM":
            return dice.choice([item.identifier for item in prop.enum_items]) if len(prop.enum_items) else None
        if prop.type == "INT":
            return dice.choice((0, 1, -1, 2, 2**31 - 1, -(2**31)))
        if prop.type == "FLOAT":
            values = dice.choices((9.0, 50.0, 0.0, -1.0, 1e30, math.nan, math.inf), (9, 9, 2, 2, 1, 1, 1), k=2)
            return values if prop.is_array else values[0]
        if prop.identifier == "directory":
            names = ("house", "house/job", "other job", "plain", "Ostviertel", "empty", "nowhere", "noise.bin", "")
        elif prop.identifier == "filepath":
            names = ("house", "prompts.json", "marks.csv", "noise.bin", "empty", "nowhere/x.json", "new.json", "")
        else:
            names = ("", "a", "Section", "log.txt", "orthophoto-A.png", "../../x", "nowhere", "\u00fc" * 300)
            return dice.choice(names)
        name = dice.choice(names)
        return str(work / name) if name else ""


class Fault(Exception):
    """Something that must not happen; the message says what."""


class Call:
    """One call of an operator in a state.

    Args:
        base: of :data:`BASES`.
        states: names of :data:`STATES`.
        operator: its name.
        context: of :data:`CONTEXTS`.
        given: values of its properties.
    """

    def __init__(
        self, base: str, states: tuple[str, ...], operator: str, context: str, given: dict[str, object]
    ) -> None:
        self.base, self.states, self.operator, self.context, self.given = base, states, operator, context, given

    def __str__(self) -> str:
        given = ", ".join(f"{name}={value!r}"[:120] for name, value in self.given.items())
        return f"{self.base} / {' + '.join(self.states)} / {self.context}: {self.operator}({given})"

    def make(self, stage: Stage) -> str:
        """Make the call; returns its answer.

        Raises:
            Fault: something raised, was not said in a sentence, or failed half done.
        """
        stage.begin(self.base)
        for state in self.states:
            with contextlib.suppress(RuntimeError, UserError, OSError):  # the second does not fit the first
                STATES[state](stage)
        printed = io.StringIO()
        with contextlib.redirect_stderr(printed), _without_privileges():
            answer = self._make()
        if "Traceback" in printed.getvalue():
            raise Fault(printed.getvalue())
        return answer

    def _make(self) -> str:
        look()
        bpy.ops.ed.undo_push(message="before")
        before = content()
        text, outcome, in_editor = "", {"CANCELLED"}, self.context not in {"here", "no window"}
        with CONTEXTS[self.context]():
            try:
                # With undo, Blender 5.0 crashes in an editor that has no window to draw its redo panel.
                outcome = getattr(bpy.ops.mgf, self.operator)("EXEC_DEFAULT", not in_editor, **self.given)
            except RuntimeError as error:
                text = str(error).strip()
        check_sentence(text)
        if outcome == {"CANCELLED"} and text and not runner.jobs():  # a run of the engine may leave what it was given
            compare(before, content(), text)
        look()
        if in_editor and outcome == {"FINISHED"}:
            bpy.ops.ed.undo_push(message="after")
        for step in (bpy.ops.ed.undo, bpy.ops.ed.redo):
            if step.poll():
                step()
                look()
        _finish_jobs()
        for job in runner.jobs():
            for text_ in (job.text, *job.warnings):
                check_sentence(text_)
        for problem in async_import._problems.values():
            check_sentence(problem)
        look()
        return text or "".join(outcome)


def check_sentence(text: str) -> None:
    """Raise when an error is no sentence that a user can read."""
    if "The engine ended with code" in text:  # and its own last words
        return
    for bad in ("Traceback", "made a mistake", "Error(", "Errno", "<bpy", "NoneType"):
        if bad in text:
            raise Fault(f"not a sentence for users: {text}")


def compare(before: dict[str, object], after: dict[str, object], text: str) -> None:
    """Raise when a call that failed changed something."""
    for name in before:
        if before[name] != after[name]:
            raise Fault(f"failed ({text}) but changed {name}: {_difference(before[name], after[name])}")


def _difference(before: object, after: object) -> str:
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [k for k in {**before, **after} if before.get(k) != after.get(k)]
        return "; ".join(f"{k}: {before.get(k)!r} -> {after.get(k)!r}" for k in keys[:4])[:600]
    return f"{before!r} -> {after!r}"[:600]


def look() -> None:
    """Draw everything, as Blender does after each step."""
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    find_crop_box(Tree.find(scene))
    for cls in bpy.types.Panel.__subclasses__():
        if cls.__name__.startswith("MGF_PT_"):
            draw(cls)
    for cls in bpy.types.UIList.__subclasses__():
        if cls.__name__.startswith("MGF_UL_"):
            items = scene.mgf.photos if "photos" in cls.__name__ else scene.mgf.georef.points
            for item in items:
                cls.draw_item(None, bpy.context, Recorder(), None, item, 0, None, "")


def content() -> dict[str, object]:
    """What an operator can change in Blender's data, but for images that were loaded to be looked at."""
    stores = ("scenes", "objects", "collections", "meshes", "cameras", "materials")
    found: dict[str, object] = {name: {b.name_full: True for b in getattr(bpy.data, name)} for name in stores}
    found["mode"], scene = bpy.context.mode, bpy.context.scene
    found["scene"] = {"name": scene.name_full, "camera": scene.camera.name_full if scene.camera else None,
                      **{k: str(v) for k, v in scene.items() if k != "mgf"}}  # fmt: skip
    found["state"] = _values(scene.mgf)
    found["placed"] = {o.name_full: _facts(o) for o in bpy.data.objects}
    return found


def _facts(obj: bpy.types.Object) -> tuple[object, ...]:
    numbers = [round(v, 5) if math.isfinite(v) else str(v) for row in Matrix(obj.matrix_basis) for v in row]
    return (numbers, obj.parent.name_full if obj.parent else None, obj.hide_render, obj.data and obj.data.name_full,
            sorted(obj.keys()), [c.name_full for c in obj.users_collection],
            obj.hide_get() if obj.name in bpy.context.view_layer.objects else None)  # fmt: skip


def _values(group: bpy.types.PropertyGroup) -> object:
    found = {}
    for prop in group.bl_rna.properties:
        if prop.identifier in {"rna_type", "name", "key", "job_folder"}:  # the last is chosen when it is first needed
            continue
        value = getattr(group, prop.identifier)
        if prop.type == "POINTER":
            value = _values(value)
        elif prop.type == "COLLECTION":
            value = [_values(item) for item in value]
        elif getattr(prop, "is_array", False):
            value = str(list(value))
        elif isinstance(value, float):
            value = str(value)
        found[prop.identifier] = value
    return found


@contextlib.contextmanager
def _without_privileges() -> Iterator[None]:
    """As root, obey the permissions of files as everybody else does (Linux)."""
    if sys.platform != "linux" or os.geteuid() != 0:
        yield
        return
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    head = (ctypes.c_uint32 * 2)(0x20080522, 0)  # version 3 of the structure, this thread
    data = (ctypes.c_uint32 * 6)()
    libc.capget(head, data)
    before = data[0]
    data[0] = before & ~0b110  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
    libc.capset(head, data)
    try:
        yield
    finally:
        data[0] = before
        libc.capset(head, data)


def all_calls(dice: random.Random, arguments: Arguments) -> Iterator[Call]:
    """Every operator in every state of the finished work, and without arguments in one of another."""
    for state in STATES:
        for operator in operators():
            for base, given in (("finished", arguments.draw(operator)), (dice.choice(BASES), {})):
                yield Call(base, (state,), operator, dice.choice(list(CONTEXTS)), given)


def random_calls(dice: random.Random, arguments: Arguments, count: int) -> Iterator[Call]:
    """Some of all, in one or two states."""
    for _ in range(count):
        states = tuple(dice.sample(list(STATES), dice.choice((1, 1, 2))))
        operator = dice.choice(operators())
        yield Call(dice.choice((*BASES, "finished")), states, operator, dice.choice(list(CONTEXTS)),
                   arguments.draw(operator))  # fmt: skip


def main(seed: int, count: int, folder: Path) -> int:
    """Make the calls; returns the number of faults."""
    os.chdir(folder)  # some names are relative
    stage, dice = Stage(folder), random.Random(seed)
    arguments = Arguments(dice, stage)
    calls = random_calls(dice, arguments, count) if count else all_calls(dice, arguments)
    answers: collections.Counter[str] = collections.Counter()
    faults = 0
    last = (folder / "last call.txt").open("w")
    for number, call in enumerate(calls):
        last.seek(0)
        last.truncate()
        last.write(f"{number} {call}\n")  # what a crash leaves
        last.flush()
        try:
            answers[call.make(stage)] += 1
        except Exception as error:
            faults += 1
            text = str(error) if isinstance(error, Fault) else traceback.format_exc()
            print(f"\nFAULT in call {number}: {call}\n{text}", flush=True)
    if os.environ.get("ODD_ANSWERS"):
        for text, times in answers.most_common():
            print(times, text)
    return faults


if __name__ == "__main__":
    faulthandler.enable()
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    try:
        faults = main(int(words[0]), int(words[1]), Path(words[2]).absolute())
    except BaseException:
        traceback.print_exc(file=sys.stdout)
        faults = 1
    runner.stop_all()
    print(f"\n{faults} faults" if faults else "\nsurvived", flush=True)
    os._exit(min(faults, 1))
