# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks as a person would set them, made from true masks: well inside large regions, on well-spread photos."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.atomic import write_json
from mgf_engine.geometry.sampling import farthest_point_sampling
from mgf_engine.model.masks import BACKGROUND, BUILDING


def click_prompts(path: Path, names: list[str], poses: NDArray[np.float64], labels: list[NDArray[np.uint8]],
                  positives: int = 3, negatives: int = 2) -> None:  # fmt: skip
    """Write ``prompts.json`` for a fifth of the photos.

    Args:
        poses: [N, 6] camera centres (scene frame) and viewing directions.
        labels: true level-one masks.
    """
    result = {}
    for index in spread_photos(poses, max(3, -(-len(names) // 5))):
        entry = {"positive": inside_points(labels[index] == BUILDING, positives),
                 "negative": inside_points(labels[index] == BACKGROUND, negatives)}  # fmt: skip
        result[names[index]] = entry
    write_json(path, result)


def spread_photos(poses: NDArray[np.float64], count: int) -> list[int]:
    """Farthest-point sampling on camera centre (scaled by the orbit) and viewing direction; sorted indices."""
    centres = poses[:, :3] - poses[:, :3].mean(0)
    feature = np.concatenate([centres / np.median(np.linalg.norm(centres, axis=1)), poses[:, 3:]], axis=1)
    return sorted(farthest_point_sampling(feature, count, [0]))


def inside_points(region: NDArray[np.bool_], count: int) -> list[list[float]]:
    """Return points well inside a region, far from its edge and from each other; pixels (u, v), at most ``count``."""
    padded = np.pad(region, 1).astype(np.uint8)
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
    if depth.max() < 2:
        return []
    v, u = np.nonzero(depth >= max(2.0, 0.35 * float(depth.max())))
    spots = np.stack([u, v], axis=1).astype(float)
    chosen = [int(depth[v, u].argmax())]
    gap = np.linalg.norm(spots - spots[chosen[0]], axis=1)
    while len(chosen) < count and gap.max() > 4:
        chosen.append(int(gap.argmax()))
        gap = np.minimum(gap, np.linalg.norm(spots - spots[chosen[-1]], axis=1))
    return [[float(spots[i, 0]) + 0.5, float(spots[i, 1]) + 0.5] for i in chosen]
