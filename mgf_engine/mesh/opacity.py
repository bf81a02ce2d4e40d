# SPDX-License-Identifier: GPL-3.0-or-later
"""The opacity field O(x) (eq. 23-25): classify points as solid, free or unknown.

A point is free if the minimum over the views of the opacity in front of it is below the level (eq. 25). Views count
that have the point in front of them, in their frame and inside their mask, or anywhere in their frame, as eq. 25 is
printed (``every_view``). A point outside the visual hull is free whatever is in front of it; one that no view sees is
invalid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.sampling import farthest_point_sampling
from mgf_engine.mesh.depth_maps import Progress
from mgf_engine.mesh.hull import HullOptions, outside_hull
from mgf_engine.mesh.isosurface import FREE, INVALID, SOLID
from mgf_engine.mesh.tsdf import TsdfField
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.raster import points as kernel

CHUNK = 1 << 22  # number of points evaluated at a time, which limits the memory; each chunk projects the field again


@dataclass(frozen=True)
class OpacityOptions:
    """Options of the surface by opacity (``surface=opacity``)."""

    agree: int = parameter(
        1,
        "Number of photos that must look through to a point before it is free; 1 is the minimum of eq. 25",
        low=1,
        high=2,
    )
    every_view: bool = parameter(
        False, "Test a point in every photo in whose frame it lies, also where the mask shows background (eq. 25)"
    )
    calibration_points: int = parameter(50, "Minimum number of sparse points that calibrate the level", low=1)
    levels: tuple[float, float] = parameter((0.05, 0.95), "Bounds of the calibrated level", high=1)

    level: float = job_option("opacity_level")
    hull: HullOptions = HullOptions()


class OpacityField:
    """Opacity O(x) of a field over a set of views.

    Args:
        gaussians: the field, normalised frame.
        views: cameras of the trusted photos.
        masks: for each view uint8 [H, W] from :func:`mgf_engine.mesh.hull.silhouette_mask`.
        options: opacity of the surface (eq. 26), and the visual hull.
        evidence: fused depth maps of the same field, for :meth:`observations`; None for none.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        views: Sequence[View],
        masks: Sequence[NDArray[np.uint8]],
        options: OpacityOptions = OpacityOptions(),
        evidence: TsdfField | None = None,
    ) -> None:
        order = spread_order(np.array([v.centre for v in views]))
        self.views = [views[i] for i in order]
        self.masks = [np.ascontiguousarray(masks[i]) for i in order]
        self.voting_masks = [_without_background(mask) if options.every_view else mask for mask in self.masks]
        self.options, self.level, self.evidence = options, options.level, evidence
        self._kernel = kernel.PointOpacity(gaussians)

    def classify(self, points: NDArray[np.float64], progress: Progress = lambda share: None) -> NDArray[np.uint8]:
        """Classify points [N, 3] as FREE, SOLID or INVALID, uint8 [N], by the sign of O - level."""
        state = np.empty(len(points), np.uint8)
        for start in range(0, len(points), CHUNK):
            part = slice(start, min(start + CHUNK, len(points)))
            state[part] = self._classify(points[part], _share_of(progress, part, len(points)))
        return state

    def _classify(self, points: NDArray[np.float64], progress: Progress) -> NDArray[np.uint8]:
        points32 = np.ascontiguousarray(points, dtype=np.float32)
        state, seen = self._seen(points32)
        lowest = np.full((len(points), 2), 2.0, np.float32)
        for number, (view, mask) in enumerate(zip(self.views, self.voting_masks, strict=True)):
            progress(number / len(self.views))
            needed = np.minimum(self.options.agree, seen) - 1
            open_ = np.flatnonzero((state == SOLID) & (lowest[np.arange(len(points)), needed] >= self.level))
            if len(open_) == 0:
                break
            part = lowest[open_]
            self._kernel.lower(part, points32[open_], view, mask, 1.0 - self.level)
            lowest[open_] = part
        needed = np.clip(np.minimum(self.options.agree, seen) - 1, 0, 1)
        through = lowest[np.arange(len(points)), needed] < self.level
        state[(state == SOLID) & through] = FREE
        return state

    def signed(self, points: NDArray[np.float64], progress: Progress = lambda share: None) -> NDArray[np.float32]:
        """Return -inf for solid points [N, 3] and +inf for all others, [N]: this field has no distance."""
        return np.where(self.classify(points, progress) == SOLID, -np.inf, np.inf).astype(np.float32)

    def calibrate(self, points: NDArray[np.float64]) -> float:
        """Set the level to the median opacity (eq. 25) of triangulated surface points [N, 3]; return it.

        Points where the field is empty do not count: the surface is missing there, whatever the level.
        """
        points32 = np.ascontiguousarray(points, dtype=np.float32)
        state, _ = self._seen(points32)
        lowest = np.full((len(points), 2), 2.0, np.float32)
        for view, mask in zip(self.views, self.voting_masks, strict=True):
            self._kernel.lower(lowest, points32, view, mask)
        found = lowest[(state == SOLID) & (lowest[:, 0] >= self.options.levels[0]) & (lowest[:, 0] <= 1.0), 0]
        if len(found) >= self.options.calibration_points:
            self.level = float(np.clip(np.median(found), *self.options.levels))
        return self.level

    def observations(self, points: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        """Count the views that show a surface, see :meth:`mgf_engine.mesh.tsdf.TsdfField.observations`.

        All points [N, 3] are ``confirmed``: eq. 25 does not separate what views show from what none rules out. Without
        ``evidence`` there is nothing else.
        """
        if self.evidence is None:
            return {"confirmed": np.ones(len(points), bool)}
        # The level set of thick Gaussians may lie some pixels in front of their depth maps.
        return {**self.evidence.observations(points), "confirmed": np.ones(len(points), bool)}

    def _seen(self, points: NDArray[np.float32]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Return the state of each point from the masks alone, uint8 [N], and the number of views that see it, [N]."""
        background, seen = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
        for view, mask in zip(self.views, self.masks, strict=True):
            visibility = kernel.locate(points, view, mask).visibility
            background += visibility == kernel.BACKGROUND
            seen += visibility == kernel.SEEN
        state = np.full(len(points), SOLID, np.uint8)
        voting = seen + background if self.options.every_view else seen
        state[voting == 0] = INVALID
        if self.options.hull.carve:
            state[outside_hull(background, seen, self.options.hull)] = FREE
        return state, voting


def _without_background(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a mask of :func:`mgf_engine.mesh.hull.silhouette_mask` without its background."""
    return np.where(mask == kernel.OUTSIDE, kernel.INSIDE, mask).astype(np.uint8)


def _share_of(progress: Progress, part: slice, count: int) -> Progress:
    """Return a progress callback for a slice of ``count`` points."""
    return lambda share: progress((part.start + share * (part.stop - part.start)) / count)


def spread_order(centres: NDArray[np.float64]) -> list[int]:
    """Order centres [V, 3] by farthest-point sampling, the farthest from the mean first; returns indices [V]."""
    if len(centres) == 0:
        return []
    first = int(np.linalg.norm(centres - centres.mean(0), axis=1).argmax())
    return farthest_point_sampling(centres, len(centres), [first])
