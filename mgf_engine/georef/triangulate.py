# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangulate marked points by the rays of their marks, and find wrong marks by the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.georef.control_points import Mark
from mgf_engine.georef.options import MarkOptions
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.cameras import from_original, to_original

Array = NDArray[np.float64]
_MOST_PAIRS = 200  # of marks that are tried, for a bounded time


@dataclass(frozen=True)
class TriangulatedPoint:
    """A marked point in the scene.

    Attributes:
        name: of the point.
        position: float64 [3], normalised frame.
        marks: all its marks.
        residuals: pixels of the photos as taken from each mark to the point's projection, [M, 2].
        good: marks that count, bool [M].
    """

    name: str
    position: Array
    marks: tuple[Mark, ...]
    residuals: Array
    good: NDArray[np.bool_]

    @property
    def rms(self) -> float:
        """Root mean square distance of the marks that count, pixels."""
        return float(np.sqrt((self.residuals[self.good] ** 2).sum(1).mean()))


def place_points(
    scene: Scene, marks: Sequence[Mark], options: MarkOptions = MarkOptions()
) -> tuple[dict[str, TriangulatedPoint], dict[str, str]]:
    """Triangulate every marked point.

    Returns:
        The placed points by name, and for the others why they cannot be placed.
    """
    placed, failed = dict[str, TriangulatedPoint](), dict[str, str]()
    for name in dict.fromkeys(mark.point for mark in marks):
        own = tuple(mark for mark in marks if mark.point == name)
        found = triangulate(scene, own, options)
        if isinstance(found, str):
            failed[name] = found
        else:
            placed[name] = found
    return placed, failed


def triangulate(scene: Scene, marks: tuple[Mark, ...], options: MarkOptions = MarkOptions()) -> TriangulatedPoint | str:
    """Triangulate one point from its marks, or return why that cannot be done."""
    if len({mark.view for mark in marks}) < 2:
        return "marked in one photo only"
    views = [scene.views[mark.view] for mark in marks]
    rays = np.array([ray_of(view, mark.pixel) for view, mark in zip(views, marks, strict=True)])
    centres = np.array([view.centre for view in views])
    if not np.isfinite(rays).all():
        return "marked outside of what the lens shows"
    limit, least_angle = outlier_limits(views, options), np.radians(options.least_angle)
    best, cost = None, np.inf
    pairs = list(combinations(range(len(marks)), 2))
    step = max(1, len(pairs) // _MOST_PAIRS)
    for pair in pairs[::step]:
        angle = np.arccos(np.clip(rays[pair[0]] @ rays[pair[1]], -1, 1))
        if not least_angle < angle < np.pi - least_angle:
            continue
        position = meeting(centres[list(pair)], rays[list(pair)])
        away = np.linalg.norm(residuals_of(views, marks, position), axis=1) / limit
        now = float(np.minimum(away, 1.0) @ np.minimum(away, 1.0))
        if now < cost:
            best, cost = position, now
    if best is None:
        return "marked in photos from nearly the same place only"
    good = np.linalg.norm(residuals_of(views, marks, best), axis=1) < limit
    for _ in range(3):
        if good.sum() < 2:
            return "its marks contradict each other"
        best = refine_point(best, views, marks, good)
        good = np.linalg.norm(residuals_of(views, marks, best), axis=1) < limit
    return TriangulatedPoint(marks[0].point, best, marks, residuals_of(views, marks, best), good)


def outlier_limits(views: Sequence[View], options: MarkOptions = MarkOptions()) -> Array:
    """Return the reprojection error from which a mark is an outlier, pixels of each photo as taken, [V]."""
    return np.array([options.outlier * max(view.original_width, view.original_height) / 1000 for view in views])


def ray_of(view: View, pixel: tuple[float, float]) -> Array:
    """Return the unit direction [3] in the normalised frame of a pixel of the photo as taken; NaN beyond the lens."""
    u, v = from_original(view, np.array([pixel]))[0]
    local = np.array([(u - view.cx) / view.fx, (v - view.cy) / view.fy, 1.0])
    return np.asarray(view.rotation.T @ local / np.linalg.norm(local))


def meeting(centres: Array, rays: Array) -> Array:
    """Return the point [3] nearest to all rays [N, 3] from ``centres`` [N, 3]."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    return np.asarray(np.linalg.solve(across.sum(0), (across @ centres[:, :, None]).sum(0)[:, 0]))


def residuals_of(views: Sequence[View], marks: Sequence[Mark], position: Array) -> Array:
    """Compute projection less mark, pixels of the photos as taken, [M, 2]; 1e9 for a point behind the camera."""
    rows = []
    for view, mark in zip(views, marks, strict=True):
        uv, depth = view.project(position[None])
        at = to_original(view, uv)[0] if depth[0] > 0 else np.full(2, np.nan)
        rows.append(at - mark.pixel)
    return np.nan_to_num(np.array(rows), nan=1e9)


def refine_point(position: Array, views: Sequence[View], marks: Sequence[Mark], good: NDArray[np.bool_]) -> Array:
    """Minimise the squared residuals of the good marks by up to four Gauss-Newton steps; returns the point [3].

    Args:
        position: where to begin, [3], normalised frame.
        views: of the marks.
        marks: pixels of the photos as taken.
        good: marks that count, bool [M].
    """
    chosen = [(view, mark) for view, mark, ok in zip(views, marks, good, strict=True) if ok]
    own, theirs = [view for view, _ in chosen], [mark for _, mark in chosen]
    size = 1e-6 * float(np.mean([np.linalg.norm(position - view.centre) for view in own]))
    for _ in range(4):
        now = residuals_of(own, theirs, position).ravel()
        slope = np.stack(
            [(residuals_of(own, theirs, position + size * axis).ravel() - now) / size for axis in np.eye(3)], 1
        )
        step = np.linalg.lstsq(slope, now, rcond=None)[0]
        position = position - step
        if np.linalg.norm(step) < 1e-3 * size:
            break
    return position


def project_point(view: View, position: Array) -> tuple[float, float] | None:
    """Project a point [3] (normalised frame) into the photo as taken, px; None outside of the photo."""
    uv, depth = view.project(position[None])
    if depth[0] <= 0:
        return None
    x, y = to_original(view, uv)[0]
    inside = np.isfinite(x) and 0 <= x <= view.original_width and 0 <= y <= view.original_height
    return (float(x), float(y)) if inside else None
