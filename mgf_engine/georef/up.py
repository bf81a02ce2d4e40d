# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way is up in a scene: from gravity tags of the photos, from level cameras, and from the edges of walls.

Tags and level cameras are right to a degree or two. Vertical edges of the building share one vanishing direction in
all photos, which is far sharper, once it is known roughly where to look for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.georef.similarity import Direction
from mgf_engine.masks.geometry.point_features import up_direction
from mgf_engine.model.scene import Scene, View

Array = NDArray[np.float64]
#: How far off rough directions may be: of gimbals' tags, and of cameras that people hold level.
_TAG_SD, _LEVEL_SD = np.radians(1.0), np.radians(2.0)
_NEAR = np.radians(10.0)  # from the rough direction: edges of walls
_INLIER, _LEAST_SD = np.radians(0.4), np.radians(0.05)
_LEAST_EDGES, _LEAST_VIEWS, _LEAST_SHARE = 24, 3, 0.25
_MOST_VIEWS, _SAMPLES = 40, 1500
_LEAST_LENGTH = 0.04  # of the photo's longest side


@dataclass(frozen=True)
class Upward:
    """The direction up.

    Attributes:
        direction: in the normalised frame, and how well it is known.
        how: ``walls``, ``tags`` or ``cameras``.
        edges: number of edges that show it.
    """

    direction: Direction
    how: str
    edges: int = 0

    @property
    def degrees(self) -> float:
        """How well it is known."""
        return float(np.degrees(self.direction.sd))


def find_up(scene: Scene, tags: Sequence[tuple[float, float, float] | None]) -> Upward:
    """Up in the normalised frame, by the best of what is there.

    Args:
        tags: up in each view's camera frame, as its photo says; None where it does not.
    """
    told = [view.rotation.T @ np.array(up) for view, up in zip(scene.views, tags, strict=True) if up is not None]
    if len(told) >= max(3, len(scene.views) // 4):
        rough = Upward(Direction(_unit(np.median(told, axis=0)), _TAG_SD), "tags")
    else:
        rough = Upward(Direction(up_direction(scene), _LEVEL_SD), "cameras")
    return walls_direction(scene, rough.direction.source) or rough


def walls_direction(scene: Scene, rough: Array) -> Upward | None:
    """Up by the vertical edges of what the photos show; None where too few agree."""
    step = max(1, -(-len(scene.views) // _MOST_VIEWS))
    normals, lengths, owner = [], [], []
    for index in range(0, len(scene.views), step):
        found, length = edge_planes(scene.views[index], scene.photo(index))
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
    return Upward(Direction(found, sd), "walls", int(good.sum()))


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
