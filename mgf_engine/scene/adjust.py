# SPDX-License-Identifier: GPL-3.0-or-later
"""Adjust cameras that disagree with the sparse points by bundle adjustment, before the photos are undistorted.

A COLMAP model that was edited, exported half done or given another lens contradicts itself: its points do not project
to where its photos saw them. What the photos saw is still there, so COLMAP's bundle adjustment finds poses, focal
lengths and points anew, which are aligned to the old ones. A model that agrees with itself is never touched, nor one
that adjusting hardly improves.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter, log
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.adjust_task import RESULT, TASK, AdjustmentTask, read_result, write_task
from mgf_engine.scene.colmap_bundle import (
    centres,
    colmap_camera,
    projection_errors,
    transform_model,
)
from mgf_engine.scene.sparse import SparseModel, check_model
from mgf_engine.system.subprocesses import run_worker

Indices = NDArray[np.int64]
COMMAND = (sys.executable, "-m", "mgf_engine.scene.adjust_worker")


@dataclass(frozen=True)
class AdjustOptions:
    """Options of adjusting cameras that disagree with the sparse points."""

    adjust: bool = parameter(True, "Adjust cameras that disagree with the sparse points; off takes the model as it is")
    from_error: float = parameter(
        0.4, "Median reprojection error from which adjusting is tried; sound models stay below 0.35", "px"
    )
    better: float = parameter(
        0.6, "Maximum share of the error that may be left; a model adjusted before cannot lose as much", high=1
    )
    most_photos: int = parameter(600, "Number of photos beyond which the model is taken as it is", low=3)
    most_points: int = parameter(
        3000, "Maximum number of points in the bundle adjustment, beside those of points_per_photo", low=8
    )
    points_per_photo: int = parameter(60, "Number of points in the bundle adjustment that each photo should see", low=1)
    rounds: int = parameter(
        AdjustmentTask.rounds, "Number of bundle adjustments, each with a smaller loss scale, while that falls", low=1
    )
    least_scale: float = parameter(
        AdjustmentTask.least_scale, "Minimum scale of Cauchy's loss in bundle adjustment", "px", low=1e-3
    )
    outlier: float = parameter(
        4.0, "Minimum reprojection error of an outlier; outlier_factor times the first decile is added", "px"
    )
    outlier_factor: float = parameter(3.0, "Factor on the first decile of all reprojection errors, added to outlier")


def adjust_if_inconsistent(
    model: SparseModel, resolution: int, reporter: Reporter, options: AdjustOptions = AdjustOptions()
) -> SparseModel:
    """Adjust a model where its cameras and points disagree, with a warning; return it as it is elsewhere.

    Args:
        model: cameras, points and observations as the user gave them.
        resolution: longest side of the working photos; errors are measured in their pixels.
        reporter: for the warning and the request to cancel.
        options: whether to adjust, from which error, and how much better the result must be.
    """
    if not options.adjust or not _valid(model):
        return model  # a model that is not valid is refused where the photos are planned
    with np.errstate(all="ignore"):  # a damaged model may overflow; what results is refused
        before, after, adjusted = _adjusted(model, resolution, reporter, options)
    if adjusted is model:
        return model
    change = max(abs(new.params[0] / model.cameras[i].params[0] - 1) for i, new in adjusted.cameras.items())
    reporter.warning(
        f"The COLMAP model had a reprojection error of {before:.1f} working pixels; bundle adjustment reduced it "
        f"to {after:.1f} and changed focal lengths by up to {change:.1%}. Building it again with the right "
        "camera model would be safer."
    )
    return adjusted


def _adjusted(
    model: SparseModel, resolution: int, reporter: Reporter, options: AdjustOptions
) -> tuple[float, float, SparseModel]:
    """Return the disagreement before and after, working pixels, and the better model: the same one where it is not much
    better.

    It is the median error of the observations of points that are not stray.
    """
    errors = projection_errors(model, resolution)
    sound = ~far_points(errors, model.points.start, options)[model.points.track_point] & np.isfinite(errors)
    before = float(np.median(errors[sound])) if sound.any() else 0.0
    chosen = choose_observations(model, sound, options)
    if before <= options.from_error or not 3 <= len(model.images) <= options.most_photos or not len(chosen):
        return before, before, model
    frame = _frame(model)
    used = np.unique(model.points.track_point[chosen])
    task = AdjustmentTask(
        transform_model(model, frame), resolution, chosen, used, before, options.rounds, options.least_scale
    )
    found = _in_a_process(task, reporter)
    if found is None or not _valid(found):
        return before, before, model
    result = transform_model(found, frame.inverse())
    after = float(np.median(projection_errors(result, resolution)[sound]))
    return (before, after, result) if after < options.better * before and _valid(result) else (before, before, model)


def far_points(
    distances: NDArray[np.float64], start: NDArray[np.int64], options: AdjustOptions = AdjustOptions()
) -> NDArray[np.bool_]:
    """Find the points that most of their photos see elsewhere, bool [P]. Holds while a sixth of them are sound.

    Args:
        distances: of each observation from its point's projection, working pixels, [T].
        start: observations of point i are ``start[i]:start[i + 1]``.
        options: which observations are outliers.
    """
    if not len(distances):
        return np.zeros(len(start) - 1, bool)
    limit = options.outlier + options.outlier_factor * float(np.percentile(distances, 10))
    far = np.concatenate([[0], np.cumsum(distances > limit)])
    return np.asarray(far[start[1:]] - far[start[:-1]] > 0.5 * np.diff(start))


def choose_observations(
    model: SparseModel, sound: NDArray[np.bool_], options: AdjustOptions = AdjustOptions()
) -> Indices:
    """Choose the observations that settle the cameras: points that most photos see, and some for every photo.

    Args:
        model: cameras and points.
        sound: observations that are no outliers, bool [T].
        options: numbers of points.

    Returns:
        Indices of observations, int64.
    """
    owner = model.points.track_point
    seen = np.bincount(owner[sound], minlength=len(model.points.ids))
    rank = np.empty(len(seen), np.int64)
    rank[np.argsort(-seen, kind="stable")] = np.arange(len(seen))
    taken = rank < options.most_points
    for index in range(len(model.images)):
        mine = model.observations(index)
        own = owner[mine[sound[mine]]]
        taken[own[np.argsort(rank[own], kind="stable")[: options.points_per_photo]]] = True
    return np.flatnonzero(sound & (taken & (seen >= 2))[owner])


def _in_a_process(task: AdjustmentTask, reporter: Reporter) -> SparseModel | None:
    """Return the adjusted model from :mod:`adjust_worker`; None where COLMAP failed on it."""
    with tempfile.TemporaryDirectory(prefix="mgf-") as name:
        folder = Path(name)
        write_task(task, folder / TASK)
        code = run_worker([*COMMAND, name], reporter.check)
        if code != 0:
            log.info("scene: cameras could not be adjusted (COLMAP ended with code %d)", code)
            return None
        return read_result(folder / RESULT, task.model)


def _frame(model: SparseModel) -> pycolmap.Sim3d:
    """Return the frame from the model's coordinates, which may be a map's, to some with the cameras around the origin,
    1 away."""
    places = centres(model)
    middle = places.mean(0)
    size = float(np.sqrt(((places - middle) ** 2).sum(1).mean())) or 1.0
    return pycolmap.Sim3d(1.0 / size, pycolmap.Rotation3d(), -middle / size)


def _valid(model: SparseModel) -> bool:
    try:
        check_model(model)
    except BadInput:
        return False
    return all(colmap_camera(camera).verify_params() for camera in model.cameras.values())
