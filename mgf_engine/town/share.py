# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene stage of a building's job out of the town's: working photos are linked, not made once more."""

from __future__ import annotations

import os
import shutil
import time
from dataclasses import replace
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job import Job
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.colmap import find_model, find_photos, read_model
from mgf_engine.scene.load import build_scene
from mgf_engine.scene.photos import plan_photos
from mgf_engine.scene.store import FILE, read_saved_scene, save_scene
from mgf_engine.system.machine import cpu_seconds

_SAME = 1e-6  # of intrinsics in pixels, relative


def take_scene(job: Job, shared: Path) -> bool:
    """Finish the scene stage of a job with what the scene stage of the whole town left.

    The frame is the building's own: photos, exposures and working sizes are the town's.

    Args:
        job: open; its scene is a part of the town's (:mod:`mgf_engine.town.submodel`).
        shared: the ``scene`` folder of the town's scene stage.

    Returns:
        Whether it could be taken; where not (another resolution, a photo that was lost), the job's own stage makes it.
    """
    if job.done("scene") or not (shared / FILE).is_file():
        return False
    began, cpu = time.perf_counter(), cpu_seconds()
    try:
        whole = {view.name: view for view in read_saved_scene(shared).views}
        model_folder = find_model(job.source, job.folder)
        if model_folder is None:
            return False
        model = read_model(model_folder)
        paths = find_photos([image.name for image in model.images], model_folder, job.source, job.folder)
        if not all(path.is_file() for path in paths):
            return False
        photos = plan_photos(model, paths, job.config.resolution, Reporter())
        scene = build_scene(model, photos, job.path("scene"), job.config)
    except BadInput:
        return False  # the stage itself says what is wrong
    if job.config.max_photos and len(scene.views) > job.config.max_photos:
        return False
    if not all(view.name in whole and _alike(view, whole[view.name]) for view in scene.views):
        return False
    key = job.begin("scene")
    shutil.rmtree(job.path("scene"), ignore_errors=True)
    job.path("scene", "images").mkdir(parents=True)
    for view in scene.views:
        _link(shared / whole[view.name].file, job.path("scene", view.file))
    save_scene(_with_gains(scene, whole))
    figures = {"photos": len(scene.views), "points": len(scene.points)}
    job.finish("scene", key, time.perf_counter() - began, cpu_seconds() - cpu, 0, figures, [])
    return True


def _alike(one: View, other: View) -> bool:
    """Tell whether two working photos are the same one."""
    sizes = (one.width, one.height, one.orientation) == (other.width, other.height, other.orientation)
    pairs = zip((one.fx, one.fy, one.cx, one.cy), (other.fx, other.fy, other.cx, other.cy), strict=True)
    return sizes and one.lens == other.lens and all(abs(a - b) <= _SAME * abs(b) for a, b in pairs)


def _with_gains(scene: Scene, whole: dict[str, View]) -> Scene:
    return replace(scene, views=tuple(replace(view, gain=whole[view.name].gain) for view in scene.views))


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links, or another one
        shutil.copyfile(source, target)
