# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers of what a job writes: its state, its scene, its masks and its checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.target import Target, small_field, small_scene, write_photos
from benchmarks.fuzz.uses import all_inside, use_field, use_masks, use_scene
from mgf_engine.model.masks import MaskSet


def _prepare_job(folder: Path) -> None:
    from mgf_engine.jobs.job import Job

    (folder / "photos").mkdir()
    with Job.start(folder / "job", folder / "photos", user_options={"seed": 3}) as job:
        for stage in ("scene", "masks"):
            job.finish(stage, job.begin(stage), 1.0, 2.0, 5, {"photos": 3}, ["a warning"])


def _read_job(folder: Path) -> Any:
    from mgf_engine.jobs.job import Job

    with Job.start(folder / "job", folder / "photos", resume=True) as job:
        return [job.done(stage) for stage in ("scene", "masks", "deliver")]


def _prepare_scene(folder: Path) -> None:
    from mgf_engine.scene.store import save_scene

    scene = small_scene(folder)
    write_photos(scene)
    save_scene(scene)


def _read_scene(folder: Path) -> Any:
    from mgf_engine.scene.store import read_saved_scene

    scene = read_saved_scene(folder)
    for index in range(len(scene.views)):
        if folder.resolve() not in (folder / scene.views[index].file).resolve().parents:
            raise AssertionError(f"leads out of the folder: {scene.views[index].file}")
    use_scene(scene, folder)
    return scene


def _prepare_saved_masks(folder: Path) -> None:
    from mgf_engine.masks.store import save_masks

    scene = small_scene(folder)
    write_photos(scene)
    labels = tuple(np.ones((12, 16), np.uint8) for _ in scene.views)
    clicks = (np.array([[3.5, 4.25], [6, 7]], np.float32), np.zeros((0, 2), np.float32))
    masks = MaskSet(labels, np.ones(2, bool), np.ones(2, np.float32), np.ones(3, bool), clicks)
    save_masks(masks, scene, folder, ["", ""])


def _read_saved_masks(folder: Path) -> Any:
    from mgf_engine.masks.store import read_masks
    from mgf_engine.mesh.parts import named_parts

    scene = small_scene(folder)
    named_parts(folder, scene)
    masks = read_masks(folder, scene)
    use_masks(masks, scene, folder)
    return masks


def _prepare_checkpoint(folder: Path) -> None:
    from mgf_engine.field.checkpoint import Checkpoint, write_checkpoint, write_field
    from mgf_engine.field.optimiser import Optimiser
    from mgf_engine.raster.api import RenderStats

    field = small_field()
    write_photos(small_scene(folder))
    write_field(field, folder / "field.npz")
    figures = {"start_gaussians": 6, "curve": [], "seconds": {"render": 1.0}}
    write_checkpoint(Checkpoint(Optimiser(field), RenderStats.zeros(6), 40, figures), folder / "training.npz")


def _read_checkpoint(folder: Path) -> Any:
    from mgf_engine.field.checkpoint import read_checkpoint, read_field

    scene = small_scene(folder)
    checkpoint = read_checkpoint(folder / "training.npz")
    if checkpoint is not None:
        dict(checkpoint.figures["seconds"])
        use_field(checkpoint.optimiser.field, scene, all_inside(scene), folder)
    field = read_field(folder / "field.npz")
    use_field(field, scene, all_inside(scene), folder)
    return field


JOB_TARGETS: dict[str, Target] = {
    "job": Target(_prepare_job, {"job/job.json": "json"}, _read_job, 0.5),
    "scene": Target(_prepare_scene, {"scene.npz": "npz", "images/0000_p0.png": "png"}, _read_scene, 0.5),
    "saved-masks": Target(
        _prepare_saved_masks,
        {"scores.json": "json", "parts.json": "json", "points.bin": "binary", "labels/p0.png": "png"},
        _read_saved_masks, 1.0,
    ),
    "checkpoint": Target(_prepare_checkpoint, {"training.npz": "npz", "field.npz": "npz"}, _read_checkpoint, 0.3),
}  # fmt: skip
