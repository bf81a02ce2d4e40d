# SPDX-License-Identifier: GPL-3.0-or-later
"""Odd states of files, jobs and the engine."""

from __future__ import annotations

import math
import os
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import bpy

from mgf_blender.common import runner
from mgf_blender.georef.files import places_path
from mgf_blender.prompts import preview
from mgf_blender.reconstruct.start import make_job
from mgf_blender.results import async_import
from odd.scene_states import show_scene
from odd.stage import Stage


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
    show_scene(bpy.data.scenes.new("other"))


def job_failed(stage: Stage) -> None:
    os.environ["FAKE_ENGINE"] = "silent"
    if bpy.context.scene.mgf.source:
        runner.submit(make_job(bpy.context.scene))
        finish_jobs()


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


def finish_jobs(seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while (runner.pump() or async_import.pump()) and time.monotonic() < end:
        time.sleep(0.005)
