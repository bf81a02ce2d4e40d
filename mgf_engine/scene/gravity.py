# SPDX-License-Identifier: GPL-3.0-or-later
"""The direction up (against gravity) in a scene: one function for masks, georeferencing, drawings and pictures.

In order of accuracy: the common vanishing direction of vertical edges of buildings (a tenth of a degree), the gravity
tags of the photos (1 degree), and the way people and drones hold cameras (2 degrees). Edges need one of the other two,
to know roughly where to look.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.scene import Scene, View
from mgf_engine.native.parallel import parallel_map

Array = NDArray[np.float64]
#: Accuracy of rough directions: of gimbals' tags, and of cameras that people hold level.
_TAG_SD, _LEVEL_SD = np.radians(1.0), np.radians(2.0)
_NEAR = np.radians(10.0)  # from the rough direction: edges of walls
_INLIER, _LEAST_SD = np.radians(0.4), np.radians(0.05)
_LEAST_EDGES, _LEAST_VIEWS, _LEAST_SHARE = 24, 3, 0.25
_MOST_VIEWS, _SAMPLES = 40, 1500
_LEAST_LENGTH = 0.04  # of the photo's longest side
#: A grid of photos straight down: number of photos, length of their mean viewing direction, width of the grid as a
#: share of its length.
_FEWEST_IN_GRID, _ALIKE, _GRID = 8, 0.97, 0.3


@dataclass(frozen=True)
class UpDirection:
    """The direction up.

    Attributes:
        vector: unit [3], normalised frame.
        sd: standard deviation, radians.
        method: ``walls``, ``tags`` or ``cameras``.
        edges: number of edges that show it.
    """

    vector: Array
    sd: float
    method: str
    edges: int = 0

    @property
    def degrees(self) -> float:
        """Standard deviation in degrees."""
        return float(np.degrees(self.sd))


def find_up(scene: Scene, tags: Sequence[tuple[float, float, float] | None] = (), threads: int = 1) -> UpDirection:
    """Find up by the most accurate evidence that a scene has.

    Args:
        tags: up in each view's camera frame, as its photo tells; None where it does not, () for no tags.
    """
    told = [view.rotation.T @ np.array(up) for view, up in zip(scene.views, tags, strict=False) if up is not None]
    if len(told) >= max(3, len(scene.views) // 4):
        rough = UpDirection(_unit(np.median(told, axis=0)), _TAG_SD, "tags")
    else:
        rough = UpDirection(up_from_cameras(scene), _LEVEL_SD, "cameras")
    return up_from_edges(scene, rough.vector, threads) or rough


def up_from_cameras(scene: Scene) -> Array:
    """Estimate up from how cameras are held: upright with a level horizon, or straight down; unit [3].

    Up is perpendicular to the x axes of level cameras. Where they look in too few directions to tell (a facade), the
    mean of what is up in the photos decides what they leave open.
    """
    down = looking_down(scene)
    if down is not None:
        return -down
    mean = -np.mean([view.rotation[1] for view in scene.views], axis=0)
    length = float(np.linalg.norm(mean))
    mean = mean / length if length > 1e-6 else np.array([0.0, -1.0, 0.0])
    right = np.array([view.rotation[0] for view in scene.views])
    matrix = right.T @ right / len(right)
    spread, axes = np.linalg.eigh(matrix)
    if not (spread[1] > 0.05 and spread[1] > 4 * spread[0]):
        axes = np.linalg.eigh(matrix - 0.05 * np.outer(mean, mean))[1]
    up = axes[:, 0] * np.sign(axes[:, 0] @ mean or 1.0)
    return np.asarray(up if up @ mean > 0.5 else mean)


def looking_down(scene: Scene) -> NDArray[np.float64] | None:
    """Return the common viewing direction of a grid of photos, [3]; None without one.

    Drones fly such grids straight down; upright photos of a front come in a row, or look at it from several sides.
    """
    axis = np.stack([v.rotation[2] for v in scene.views]).mean(0)
    length = np.linalg.norm(axis)
    if len(scene.views) < _FEWEST_IN_GRID or length < _ALIKE:
        return None
    axis /= length
    centres = np.stack([v.centre for v in scene.views])
    centres = centres - centres.mean(0)
    across = centres - np.outer(centres @ axis, axis)
    wide = np.linalg.svd(across, compute_uv=False)
    flat = np.linalg.norm(centres @ axis) < 0.5 * wide[1]
    return axis if flat and wide[1] > _GRID * wide[0] else None


def up_from_edges(scene: Scene, rough: Array, threads: int = 1) -> UpDirection | None:
    """Estimate up from vertical edges near a rough direction; None where too few agree."""
    step = max(1, -(-len(scene.views) // _MOST_VIEWS))
    normals, lengths, owner = [], [], []
    indices = range(0, len(scene.views), step)
    edges = parallel_map(lambda i: edge_planes(scene.views[i], scene.photo(i)), indices, threads)
    for index, (found, length) in zip(indices, edges, strict=True):
        near = np.abs(found @ rough) < np.sin(_NEAR)
        normals.append(found[near])
        lengths.append(length[near])
        owner += [index] * int(near.sum())
    planes, weights, views = np.concatenate(normals), np.concatenate(lengths), np.array(owner)
    if len(planes) < _LEAST_EDGES:
        return None
    found = common_direction(planes, weights, rough)
    good = np.abs(planes @ found) < _INLIER
    share = float(weights[good].sum() / weights.sum())
    if good.sum() < _LEAST_EDGES or len(set(views[good])) < _LEAST_VIEWS or share < _LEAST_SHARE:
        return None
    spread = float(np.sqrt(np.average((planes[good] @ found) ** 2, weights=weights[good])))
    sd = max(_LEAST_SD, 2 * spread / np.sqrt(len(set(views[good]))))  # edges of one photo err together
    return UpDirection(found, sd, "walls", int(good.sum()))


def edge_planes(view: View, photo: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Straight edges of a photo as unit normals [S, 3] (normalised frame) of planes with the camera, and pixels [S]."""
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    ends = np.zeros((0, 4)) if found is None else np.asarray(found, np.float64).reshape(-1, 4) + 0.5
    length = np.hypot(*(ends[:, 2:] - ends[:, :2]).T)
    kept = length > _LEAST_LENGTH * max(view.width, view.height)
    ends, length = ends[kept], length[kept]
    first, second = (
        np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones(len(x))], 1)
        for x, y in ((ends[:, 0], ends[:, 1]), (ends[:, 2], ends[:, 3]))
    )
    normals = np.cross(first, second) @ view.rotation
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12), length


def common_direction(normals: Array, weights: Array, rough: Array) -> Array:
    """The direction [3] near ``rough`` that lies in most planes [S, 3], by weight."""
    rng = np.random.default_rng(0)
    pairs = rng.choice(len(normals), (_SAMPLES, 2), p=weights / weights.sum())
    tried = np.cross(normals[pairs[:, 0]], normals[pairs[:, 1]])
    size = np.linalg.norm(tried, axis=1)
    tried = tried[size > 0.05] / size[size > 0.05, None]
    tried = tried * np.where(tried @ rough < 0, -1.0, 1.0)[:, None]
    tried = np.concatenate([rough[None], tried[tried @ rough > np.cos(_NEAR)]])
    away = np.minimum((normals @ tried.T / np.sin(_INLIER)) ** 2, 1.0)
    best = tried[int(np.argmin(weights @ away))]
    for _ in range(10):
        share = weights / (1.0 + (normals @ best / (0.5 * _INLIER)) ** 2)  # Cauchy's weights
        _, vectors = np.linalg.eigh((normals * share[:, None]).T @ normals)
        best = vectors[:, 0] * np.sign(vectors[:, 0] @ best)
    return np.asarray(best)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))
