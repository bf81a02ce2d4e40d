# SPDX-License-Identifier: GPL-3.0-or-later
"""Register a reconstruction with its truth before scoring: point-to-plane ICP with optional scale."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mgf_engine.evaluation.surfaces import Points, Surface


def align_to(source: Surface, target: Surface, scale: bool, rounds: int = 60, count: int = 20_000) -> Points:
    """Return the 4x4 similarity that moves ``source`` onto ``target``; starts from where it lies.

    Each round linearises the point-to-plane distance in rotation, translation and (if ``scale``) scale, with
    weights 1 / (1 + (r / c)^2) and c the median distance, so that parts without a counterpart pull little.

    Args:
        source: surface that moves.
        target: surface that stays.
        scale: whether the scale is adjusted, too.
        rounds: number of iterations.
        count: number of points sampled on ``source``.
    """
    return align_points(source.sample(count, np.random.default_rng(0))[0], target, scale, rounds)


def align_points(points: Points, target: Surface, scale: bool, rounds: int = 60) -> Points:
    """Return the same for points [n, 3], such as those of a laser scan.

    Args:
        points: [n, 3].
        target: surface that stays.
        scale: whether the scale is adjusted, too.
        rounds: number of iterations.
    """
    corners = target.vertices[target.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    total = np.eye(4)
    for _ in range(rounds):
        moved = points @ total[:3, :3].T + total[:3, 3]
        squared, face, spot = target.closest(moved)
        step = _plane_step(moved, spot, normals[face], np.sqrt(squared), scale)
        total = step @ total
        if np.abs(step - np.eye(4)).max() < 1e-9:
            break
    return total


def _plane_step(points: Points, spot: Points, normal: Points, gap: Points, scale: bool) -> Points:
    """Take one weighted Gauss-Newton step, as a 4x4 similarity."""
    middle = points.mean(0)
    local = points - middle
    size = float(np.sqrt((local**2).sum(1).mean()))
    columns = [np.cross(local, normal) / size, normal]
    if scale:
        columns.append((local * normal).sum(1, keepdims=True) / size)
    matrix = np.concatenate(columns, axis=1)
    residual = ((spot - points) * normal).sum(1)
    soft = max(float(np.median(gap)), 1e-12 * size)
    weight = np.sqrt(1.0 / (1.0 + (gap / soft) ** 2))
    x, *_ = np.linalg.lstsq(matrix * weight[:, None], residual * weight, rcond=None)
    turn = Rotation.from_rotvec(x[:3] / size).as_matrix() * (1.0 + (x[6] / size if scale else 0.0))
    step = np.eye(4)
    step[:3, :3] = turn
    step[:3, 3] = middle + x[3:6] - turn @ middle
    return step
