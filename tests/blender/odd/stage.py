# SPDX-License-Identifier: GPL-3.0-or-later
"""The files, and Blender's data, that odd states begin with."""

from __future__ import annotations

import json
import os
import random
import shutil
from pathlib import Path

import bpy
import finished_work
import synthetic
from jobs import write_engine

import mgf_blender
from mgf_blender.common import runner
from mgf_blender.engine import current_task
from mgf_blender.georef.files import places_path
from mgf_blender.georef.properties import set_mark
from mgf_blender.prompts import files, preview
from mgf_blender.results import async_import

WORK, PURE = "work", "pure"  # what is on disk during a call, and as it was made
BASES = ("empty", "imported", "finished")


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
        preview.forget()
        current_task.forget()
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
