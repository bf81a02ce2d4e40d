# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundle adjustment with control points: cameras and sparse points of a COLMAP model move so that the points fit, too.

COLMAP's own adjustment (Ceres) of its tracks, with the marks as further observations and the known coordinates of the
control points as observations weighted by their accuracy; pyceres adds the latter to COLMAP's problem, in a process of
its own, whose crash is no end of the job. Check points take no part. The model stays in its own frame, only its shape
changes.
"""

from __future__ import annotations

import logging
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.georef.bundle_worker import KNOWN
from mgf_engine.georef.control_points import CONTROL, ControlPoints
from mgf_engine.georef.crs import SURVEY
from mgf_engine.georef.fit_control import ControlFit, mark_error
from mgf_engine.georef.options import ControlAdjustmentOptions, GeoreferenceOptions
from mgf_engine.georef.triangulate import TriangulatedPoint
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.scene.adjust import choose_observations
from mgf_engine.scene.adjust_task import RESULT, TASK, AdjustmentTask, read_result, write_task
from mgf_engine.scene.colmap_bundle import projection_errors, transform_model
from mgf_engine.scene.sparse import SparseModel
from mgf_engine.system.machine import is_installed
from mgf_engine.system.subprocesses import run_worker

Array = NDArray[np.float64]
log = logging.getLogger("mgf")
_MEDIAN_OF_RAYLEIGH = 1.1774  # of lengths of errors, whose x and y have standard deviation 1
COMMAND = (sys.executable, "-m", "mgf_engine.georef.bundle_worker")


@dataclass(frozen=True)
class PlacedControl:
    """Control points and where they lie in a scene.

    Attributes:
        control: points and marks of the user.
        placed: the points in the normalised frame, by name.
        fit: similarity of the scene to the points.
    """

    control: ControlPoints
    placed: dict[str, TriangulatedPoint]
    fit: ControlFit


@dataclass(frozen=True)
class AdjustedControlPoint:
    """A control point in the adjustment.

    Attributes:
        target: its place in the world less the offset of the fit, [3].
        sd: of each coordinate, [3].
        position: where it is now, in the same frame.
        marks: index of the image in the model, and keypoint in pixels of its COLMAP camera.
    """

    target: Array
    sd: Array
    position: Array
    marks: tuple[tuple[int, Array], ...]


def _check_installed() -> None:
    """Raise BadInput where the package that adjusts is missing."""
    if not is_installed("pyceres"):
        raise BadInput(
            f"Moving the cameras to control points needs the package pyceres, which is not installed; get it by "
            f"{SURVEY}, or give --no-control-adjust."
        )


def adjust_to_control(
    model: SparseModel,
    scene: Scene,
    points: PlacedControl,
    resolution: int,
    reporter: Reporter,
    options: GeoreferenceOptions = GeoreferenceOptions(),
    *,
    robust: bool = False,
) -> SparseModel:
    """Adjust the shape of a model to the control points that fit; it stays in its own frame.

    Where the adjustment fails the model stays as it is, and a warning says so.

    Args:
        model: cameras, poses, points and tracks.
        scene: made of the model; its views are the model's images, in the same order.
        points: the control points.
        resolution: longest side of the working photos, in whose pixels errors are counted.
        reporter: for the warning and the request to cancel.
        options: accuracies and losses.
        robust: points far from their places count less, relative to the median distance of all.

    Raises:
        BadInput: the package for it is missing.
    """
    _check_installed()
    to_world = _similarity(points.fit, scene)
    with np.errstate(all="ignore"):  # points behind cameras
        in_world = transform_model(model, to_world)
        errors = projection_errors(in_world, resolution)
    chosen = choose_observations(in_world, np.isfinite(errors) & (errors < options.adjustment.outlier))
    sigma = _sigma(errors[chosen], options.adjustment)
    known = _known_points(model, scene, points, sigma, options.point.mark_accuracy)
    if not len(chosen) or len(known) < 3:
        return model
    larger, first = _with_points(in_world, known)
    observations = np.concatenate([chosen, np.arange(first, len(larger.points.image_ids))])
    task = AdjustmentTask(larger, resolution, observations, np.arange(len(larger.points.ids)), sigma)
    found = _in_a_process(task, known, _losses(known, sigma, options.adjustment, robust), reporter)
    if found is None:
        return model
    result = transform_model(_without_points(found, in_world), to_world.inverse())
    after = projection_errors(result, resolution)[chosen]
    log.info(
        "georeference: bundle adjustment with %d control points and %d observations; median error %.2f, then %.2f px",
        len(known), len(chosen), float(np.median(errors[chosen])), float(np.median(after)),
    )  # fmt: skip
    return result


def _sigma(errors: Array, options: ControlAdjustmentOptions) -> float:
    """Estimate the standard deviation of an observation from lengths of errors [N], working pixels."""
    return max(options.least_sigma, float(np.median(errors)) / _MEDIAN_OF_RAYLEIGH) if len(errors) else 0.0


def _losses(
    known: Sequence[AdjustedControlPoint], sigma: float, options: ControlAdjustmentOptions, robust: bool
) -> tuple[float, float]:
    """Return the scales of Cauchy's loss: of observations in working pixels, of coordinates in standard deviations."""
    off = np.array([np.abs((k.position - k.target) / k.sd).max() for k in known])
    control = max(options.control_loss, float(np.median(off))) if robust else np.inf
    return max(options.least_loss, options.loss * sigma), control


def _in_a_process(
    task: AdjustmentTask, known: Sequence[AdjustedControlPoint], losses: tuple[float, float], reporter: Reporter
) -> SparseModel | None:
    """Adjust the model by :mod:`bundle_worker`; None where that failed, after a warning."""
    with tempfile.TemporaryDirectory(prefix="mgf-") as name:
        folder = Path(name)
        write_task(task, folder / TASK)
        targets, sd = np.array([k.target for k in known]), np.array([k.sd for k in known])
        np.savez(folder / KNOWN, targets=targets, sd=sd, loss=np.array(losses))
        code = run_worker([*COMMAND, name], reporter.check)
        if code != 0:
            reporter.warning(
                f"The bundle adjustment with control points ended with code {code}; the cameras stay as "
                "they are, and the scene is only aligned to the points."
            )
            return None
        return read_result(folder / RESULT, task.model)


def _similarity(fit: ControlFit, scene: Scene) -> pycolmap.Sim3d:
    """Return the similarity from the model's frame to the world less the offset of the fit."""
    frame, scale = scene.to_normalised, float(np.cbrt(np.linalg.det(fit.matrix[:3, :3])))
    turn = fit.matrix[:3, :3] / scale @ frame.rotation
    place = fit.matrix[:3, :3] @ frame.translation + fit.matrix[:3, 3]
    return pycolmap.Sim3d(scale * frame.scale, pycolmap.Rotation3d(turn), place)


def _known_points(
    model: SparseModel, scene: Scene, points: PlacedControl, sigma: float, mark_accuracy: float
) -> list[AdjustedControlPoint]:
    """Prepare the control points that took part in the fit.

    COLMAP's problem weighs marks like its own observations (``sigma`` working pixels); the part by which they are worse
    is added to the accuracy of the coordinates.

    Args:
        model: whose images and cameras hold the marks.
        scene: made of the model.
        points: the control points.
        sigma: standard deviation of an observation, working pixels.
        mark_accuracy: standard deviation of a mark, pixels of the photos as taken.
    """
    fit = points.fit
    scale = float(np.cbrt(np.linalg.det(fit.matrix[:3, :3])))
    used = {row.point.name for row in fit.rows if row.used}
    found = []
    for point in (p for p in points.control.points if p.role == CONTROL and p.name in used):
        own, marks = points.placed[point.name], []
        for mark, good in zip(own.marks, own.good, strict=True):
            view, camera = scene.views[mark.view], model.cameras[model.images[mark.view].camera_id]
            factor = np.array([camera.width / view.original_width, camera.height / view.original_height])
            if good:
                marks.append((mark.view, np.array(mark.pixel) * factor))
        position = fit.matrix[:3, :3] @ own.position + fit.matrix[:3, 3]
        target = np.array(point.position) - fit.offset
        view = scene.views[own.marks[0].view]
        worse = np.sqrt(max(0.0, mark_accuracy**2 - (sigma * view.original_width / view.width) ** 2))
        sd = np.hypot(point.accuracy, scale * mark_error(scene, own, worse))
        found.append(AdjustedControlPoint(target, sd, position, tuple(marks)))
    return found


def _with_points(model: SparseModel, known: Sequence[AdjustedControlPoint]) -> tuple[SparseModel, int]:
    """Return the model with the control points as its last points, and where their observations begin."""
    points, extra = model.points, {index: list[Array]() for index in range(len(model.images))}
    image_ids, keypoint, counts = [], [], []
    for item in known:
        for index, pixel in item.marks:
            image_ids.append(model.images[index].id)
            keypoint.append(len(model.images[index].keypoints) + len(extra[index]))
            extra[index].append(pixel)
        counts.append(len(item.marks))
    images = tuple(
        replace(
            image, keypoints=np.concatenate([image.keypoints, np.array(extra[i]).reshape(-1, 2)]),
            point_ids=np.concatenate([image.point_ids, np.full(len(extra[i]), -1)]),
        )
        for i, image in enumerate(model.images)
    )  # fmt: skip
    count, begin = len(known), len(points.image_ids)
    larger = replace(
        points, ids=np.concatenate([points.ids, points.ids.max(initial=0) + 1 + np.arange(count)]),
        xyz=np.concatenate([points.xyz, [item.position for item in known]]),
        rgb=np.concatenate([points.rgb, np.zeros((count, 3), points.rgb.dtype)]),
        errors=np.concatenate([points.errors, np.zeros(count)]),
        start=np.concatenate([points.start, begin + np.cumsum(counts)]),
        image_ids=np.concatenate([points.image_ids, np.array(image_ids, np.int64)]),
        keypoint=np.concatenate([points.keypoint, np.array(keypoint, np.int64)]),
    )  # fmt: skip
    return replace(model, images=images, points=larger), begin


def _without_points(model: SparseModel, before: SparseModel) -> SparseModel:
    """Return the model that an enlarged one was made of, with the cameras, poses and points of the latter."""
    images = tuple(
        replace(image, quaternion=now.quaternion, translation=now.translation)
        for image, now in zip(before.images, model.images, strict=True)
    )
    points = replace(before.points, xyz=model.points.xyz[: len(before.points.xyz)])
    return replace(before, cameras=model.cameras, images=images, points=points)
