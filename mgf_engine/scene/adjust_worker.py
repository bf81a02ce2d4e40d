# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's bundle adjustment in a process of its own: ``python -m mgf_engine.scene.adjust_worker FOLDER``.

Numbers that Ceres cannot bear end this process and not the job, and cancelling is ending it. The task and the result
lie in a folder that only the job and this process use. One thread and fixed seeds: the result is always the
same. Everything is measured in pixels of the working photos.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.scene.adjust_task import RESULT, TASK, AdjustmentTask, read_task, write_result
from mgf_engine.scene.colmap_bundle import (
    Bundle,
    centres,
    colmap_camera,
    projection_errors,
    transform_model,
    working_scale,
)
from mgf_engine.scene.sparse import SparseModel
from mgf_engine.system.subprocesses import end_with_the_job

Array = NDArray[np.float64]
#: Exit code when the cameras that were found lie nowhere near the old ones.
NOT_FOUND = 3
_BATCH = 20_000  # points refined at once: bounds the memory


def main(folder: Path) -> int:
    """Do the task in ``folder`` and write the adjusted model beside it; exit code 0, or NOT_FOUND without one."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    pycolmap.set_random_seed(0)
    task = read_task(folder / TASK)
    model = align_similarity(replaced_points(adjust(task), task.resolution, task.least_scale), task)
    if model is None:
        return NOT_FOUND
    write_result(model, folder / RESULT)
    return 0


def adjust(task: AdjustmentTask) -> SparseModel:
    """Improve poses, focal lengths and points of the chosen observations by COLMAP with Cauchy's loss."""
    model, last = task.model, np.inf
    for _ in range(task.rounds):
        scale = _scale(model, task)
        if scale >= last:
            break
        model, last = _solved(model, task, scale), scale
    return model


def replaced_points(model: SparseModel, resolution: int, least_scale: float) -> SparseModel:
    """Return all points placed where the rays of most of their observations meet, then refined; the cameras stay."""
    xyz = model.points.xyz.copy()
    for first in range(0, len(xyz), _BATCH):
        batch = np.arange(first, min(first + _BATCH, len(xyz)))
        start = model.points.start
        bundle = Bundle(model, resolution, np.arange(start[batch[0]], start[batch[-1] + 1]))
        bundle.triangulate()
        config = pycolmap.BundleAdjustmentConfig()
        for number in bundle.numbers.tolist():
            config.add_variable_point(number)
        bundle.solve(config, least_scale)
        xyz[bundle.used] = bundle.points()
    return replace(model, points=replace(model.points, xyz=xyz))


def align_similarity(model: SparseModel, task: AdjustmentTask) -> SparseModel | None:
    """Return the model moved, turned and scaled so that most cameras and chosen points lie where they lay.

    RANSAC counts those as inliers that move by fewer pixels, seen from the cameras, than the model and its photos
    disagree by.
    """
    source, target = (np.concatenate([centres(m), m.points.xyz[task.used]]) for m in (model, task.model))
    focal = [colmap_camera(c, working_scale(c, task.resolution)).mean_focal_length() for c in model.cameras.values()]
    distance = max(1.0, float(np.median(np.linalg.norm(task.model.points.xyz[task.used], axis=1))))
    options = pycolmap.RANSACOptions()
    options.random_seed, options.max_error = 0, task.before / float(np.median(focal)) * distance
    found: dict[str, Any] | None = pycolmap.estimate_sim3d_robust(source, target, options)  # type: ignore[assignment]
    return None if found is None else transform_model(model, found["tgt_from_src"])


def _solved(model: SparseModel, task: AdjustmentTask, scale: float) -> SparseModel:
    bundle = Bundle(model, task.resolution, task.chosen)
    config = pycolmap.BundleAdjustmentConfig()
    for number in range(1, len(model.images) + 1):
        config.add_image(number)
    bundle.solve(config, scale)
    return bundle.adjusted()


def _scale(model: SparseModel, task: AdjustmentTask) -> float:
    distances = projection_errors(model, task.resolution)[task.chosen]
    return max(task.least_scale, 2.0 * float(np.median(distances)))


if __name__ == "__main__":
    threading.Thread(target=end_with_the_job, daemon=True).start()
    sys.exit(main(Path(sys.argv[1])))
