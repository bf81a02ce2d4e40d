# SPDX-License-Identifier: GPL-3.0-or-later
"""Where marked points lie in the scene: rays of their marks, wrong marks found by the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.georef.control import Mark
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.cameras import from_original, to_original

Array = NDArray[np.float64]
#: A mark is wrong when it lies farther than this from where the others put it, pixels of the photo as taken per 1000
#: pixels of its longest side: clicks are off by a pixel or two, cameras by another, a wrong photo by hundreds.
WRONG = 12.0
_LEAST_ANGLE = np.radians(1.0)  # between two rays, below which depth is guesswork
_MOST_PAIRS = 200


@dataclass(frozen=True)
class Placed:
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


def place_points(scene: Scene, marks: Sequence[Mark]) -> tuple[dict[str, Placed], dict[str, str]]:
    """Every marked point that can be placed, by name; and why the others cannot."""
    placed, failed = dict[str, Placed](), dict[str, str]()
    for name in dict.fromkeys(mark.point for mark in marks):
        own = tuple(mark for mark in marks if mark.point == name)
        found = place(scene, own)
        if isinstance(found, str):
            failed[name] = found
        else:
            placed[name] = found
    return placed, failed


def place(scene: Scene, marks: tuple[Mark, ...]) -> Placed | str:
    """One point from its marks, or why not."""
    if len({mark.view for mark in marks}) < 2:
        return "marked in one photo only"
    views = [scene.views[mark.view] for mark in marks]
    rays = np.array([ray_of(view, mark.pixel) for view, mark in zip(views, marks, strict=True)])
    centres = np.array([view.centre for view in views])
    if not np.isfinite(rays).all():
        return "marked outside of what the lens shows"
    best, cost = None, np.inf
    pairs = list(combinations(range(len(marks)), 2))
    step = max(1, len(pairs) // _MOST_PAIRS)
    for pair in pairs[::step]:
        angle = np.arccos(np.clip(rays[pair[0]] @ rays[pair[1]], -1, 1))
        if not _LEAST_ANGLE < angle < np.pi - _LEAST_ANGLE:
            continue
        position = meeting(centres[list(pair)], rays[list(pair)])
        away = np.linalg.norm(residuals_of(views, marks, position), axis=1) / limits(views)
        now = float(np.minimum(away, 1.0) @ np.minimum(away, 1.0))
        if now < cost:
            best, cost = position, now
    if best is None:
        return "marked in photos from nearly the same place only"
    good = np.linalg.norm(residuals_of(views, marks, best), axis=1) < limits(views)
    for _ in range(3):
        if good.sum() < 2:
            return "its marks contradict each other"
        best = refined(best, views, marks, good)
        good = np.linalg.norm(residuals_of(views, marks, best), axis=1) < limits(views)
    return Placed(marks[0].point, best, marks, residuals_of(views, marks, best), good)


def limits(views: Sequence[View]) -> Array:
    """Pixels beyond which a mark of each view is wrong, [V]."""
    return np.array([WRONG * max(view.original_width, view.original_height) / 1000 for view in views])


def ray_of(view: View, pixel: tuple[float, float]) -> Array:
    """Unit direction [3] in the normalised frame of a pixel of the photo as taken; NaN beyond the lens."""
    u, v = from_original(view, np.array([pixel]))[0]
    local = np.array([(u - view.cx) / view.fx, (v - view.cy) / view.fy, 1.0])
    return np.asarray(view.rotation.T @ local / np.linalg.norm(local))


def meeting(centres: Array, rays: Array) -> Array:
    """The place [3] nearest to all rays [N, 3] from ``centres`` [N, 3]."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    return np.asarray(np.linalg.solve(across.sum(0), (across @ centres[:, :, None]).sum(0)[:, 0]))


def residuals_of(views: Sequence[View], marks: Sequence[Mark], position: Array) -> Array:
    """Projection less mark, pixels of the photos as taken, [M, 2]; far off where the point is behind a camera."""
    rows = []
    for view, mark in zip(views, marks, strict=True):
        uv, depth = view.project(position[None])
        at = to_original(view, uv)[0] if depth[0] > 0 else np.full(2, np.nan)
        rows.append(at - mark.pixel)
    return np.nan_to_num(np.array(rows), nan=1e9)


def refined(position: Array, views: Sequence[View], marks: Sequence[Mark], good: NDArray[np.bool_]) -> Array:
    """The place with the least squares of the good marks' residuals (two steps of Gauss-Newton's)."""
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
    """Where a point (normalised frame) appears in the photo as taken; None where it does not."""
    uv, depth = view.project(position[None])
    if depth[0] <= 0:
        return None
    x, y = to_original(view, uv)[0]
    inside = np.isfinite(x) and 0 <= x <= view.original_width and 0 <= y <= view.original_height
    return (float(x), float(y)) if inside else None
