# SPDX-License-Identifier: GPL-3.0-or-later
"""Exchange the task and the result of camera adjustment between job and worker process, as npz files."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.scene.sparse import SparseCamera, SparseImage, SparseModel, SparsePoints

Indices = NDArray[np.int64]
TASK, RESULT = "task.npz", "result.npz"
_POINTS = ("ids", "xyz", "rgb", "errors", "start", "image_ids", "keypoint")


@dataclass(frozen=True)
class AdjustmentTask:
    """What is to be adjusted.

    Attributes:
        model: near the origin and about of size 1; cameras valid.
        resolution: longest side of the working photos.
        chosen: observations that settle poses and focal lengths, indices int64.
        used: the points of those.
        before: how far cameras and points disagree, working pixels.
        rounds: number of bundle adjustments at most.
        least_scale: of Cauchy's loss, working pixels.
    """

    model: SparseModel
    resolution: int
    chosen: Indices
    used: Indices
    before: float
    rounds: int = 3
    least_scale: float = 0.5


def write_task(task: AdjustmentTask, path: Path) -> None:
    """Write everything but the model's folder and rigs, which adjusting does not ask for."""
    model = task.model
    images = [[image.id, image.name, image.camera_id, len(image.keypoints)] for image in model.images]
    words = {"cameras": [asdict(camera) for camera in model.cameras.values()], "images": images}
    np.savez(
        path, words=np.frombuffer(json.dumps(words).encode(), np.uint8), chosen=task.chosen, used=task.used,
        numbers=np.array([task.resolution, task.before, task.rounds, task.least_scale]), **_poses(model),
        keypoints=np.concatenate([image.keypoints for image in model.images]),
        point_ids=np.concatenate([image.point_ids for image in model.images]),
        **{name: getattr(model.points, name) for name in _POINTS},
    )  # fmt: skip


def read_task(path: Path) -> AdjustmentTask:
    """Read what :func:`write_task` wrote."""
    with np.load(path, allow_pickle=False) as file:
        data = dict(file)
    words = json.loads(data["words"].tobytes())
    cameras = {c["id"]: SparseCamera(**{**c, "params": tuple(c["params"])}) for c in words["cameras"]}
    ends = np.cumsum([count for *_, count in words["images"]])[:-1]
    keypoints, point_ids = np.split(data["keypoints"], ends), np.split(data["point_ids"], ends)
    images = tuple(
        SparseImage(number, name, camera, *parts)
        for (number, name, camera, _), *parts in zip(
            words["images"], data["quaternions"], data["translations"], keypoints, point_ids, strict=True
        )
    )
    points = SparsePoints(**{name: data[name] for name in _POINTS})
    resolution, before, rounds, least_scale = data["numbers"].tolist()
    model = SparseModel(path.parent, cameras, images, points, None)
    return AdjustmentTask(model, int(resolution), data["chosen"], data["used"], before, int(rounds), least_scale)


def write_result(model: SparseModel, path: Path) -> None:
    """Write what the adjustment changes: poses, camera parameters, points."""
    params = np.concatenate([camera.params for camera in model.cameras.values()])
    np.savez(path, params=params, xyz=model.points.xyz, **_poses(model))


def read_result(path: Path, before: SparseModel) -> SparseModel:
    """Read the model ``before`` with what :func:`write_result` wrote."""
    with np.load(path, allow_pickle=False) as data:
        ends = np.cumsum([len(camera.params) for camera in before.cameras.values()])[:-1]
        params = np.split(data["params"], ends)
        cameras = {
            key: replace(camera, params=tuple(new.tolist()))
            for (key, camera), new in zip(before.cameras.items(), params, strict=True)
        }
        images = tuple(
            replace(image, quaternion=q, translation=t)
            for image, q, t in zip(before.images, data["quaternions"], data["translations"], strict=True)
        )
        return replace(before, cameras=cameras, images=images, points=replace(before.points, xyz=data["xyz"]))


def _poses(model: SparseModel) -> dict[str, Any]:
    return {
        "quaternions": np.array([image.quaternion for image in model.images]),
        "translations": np.array([image.translation for image in model.images]),
    }
