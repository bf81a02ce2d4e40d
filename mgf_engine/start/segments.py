# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect straight edges in photos, with the colours beside them and the table that the kernels search."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.image_ops import dilate_square, rgb_to_lab
from mgf_engine.model.masks import BACKGROUND
from mgf_engine.native.parallel import parallel_map
from mgf_engine.start.options import SegmentOptions
from mgf_engine.start.views import StartViews, pixel_rays

_COLOR_SAMPLES = 3, 7  # number of samples of the colour beside an edge: away from it, and along it
_CELL = 8.0  # px, of the grid that lists the segments near each pixel
_POINTERS = ("ends", "sides", "rays", "normals", "view", "projection", "centre", "first", "grid", "cell", "near")


@dataclass(frozen=True)
class Segments:
    """Edges of all photos; ``S`` segments, ``V`` views, those of one photo beside each other.

    Attributes:
        ends: float64 [S, 4], x1 y1 x2 y2 in pixels, in the order that has the brighter side on the same hand.
        sides: float32 [S, 2, 3], Lab of the brighter and the darker side.
        rays: float64 [S, 2, 3], unit directions of the ends in the normalised frame.
        view: int32 [S].
        first: int32 [V + 1], where each photo's begin.
        views: the cameras.
        options: reach, colour and overlap are handed to the kernels.
    """

    ends: NDArray[np.float64]
    sides: NDArray[np.float32]
    rays: NDArray[np.float64]
    view: NDArray[np.int32]
    first: NDArray[np.int32]
    views: StartViews
    options: SegmentOptions

    @property
    def lengths(self) -> NDArray[np.float64]:
        """Lengths in pixels, [S]."""
        return np.hypot(*(self.ends[:, 2:] - self.ends[:, :2]).T)

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Unit normals of the planes through camera and segment, [S, 3]."""
        normals = np.cross(self.rays[:, 0], self.rays[:, 1])
        return np.ascontiguousarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))

    @cached_property
    def grid(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
        """Grids of cells that list the segments near each pixel.

        Returns:
            Columns, rows and number of the first cell of each photo's grid, [V, 3]; where each cell begins in the list
            of segments, [C + 1]; that list.
        """
        reach = self.options.reach + 0.5
        size = np.array([[np.ceil(v.width / _CELL), np.ceil(v.height / _CELL)] for v in self.views.views], np.int64)
        base = np.concatenate([[0], np.cumsum(size.prod(1))])
        steps = np.maximum(2, np.ceil(self.lengths).astype(int) + 1)
        owner = np.repeat(np.arange(len(self.ends)), steps)
        share = (np.arange(len(owner)) - np.repeat(np.cumsum(steps) - steps, steps)) / np.repeat(steps - 1, steps)
        at = self.ends[owner, :2] + share[:, None] * (self.ends[owner, 2:] - self.ends[owner, :2])
        keys = []
        for dx in (-reach, reach):
            for dy in (-reach, reach):
                cell = np.floor((at + np.array([dx, dy])) / _CELL).astype(np.int64)
                photo = self.view[owner]
                inside = (cell >= 0).all(1) & (cell < size[photo]).all(1)
                number = base[photo] + cell[:, 1] * size[photo, 0] + cell[:, 0]
                keys.append(number[inside] * len(self.ends) + owner[inside])
        key = np.unique(np.concatenate(keys))
        cell, near = np.divmod(key, max(len(self.ends), 1))
        start = np.searchsorted(cell, np.arange(base[-1] + 1)).astype(np.int32)
        return np.c_[size, base[:-1]].astype(np.int32), start, near.astype(np.int32)

    @cached_property
    def table(self) -> Any:
        """The ``struct Segments`` of ``native/csrc/image/segments.c``; it keeps its arrays alive."""
        grid, cell, near = self.grid
        arrays: tuple[NDArray[Any], ...] = (
            self.ends, self.sides, self.rays, self.normals, self.view, self.views.silhouettes.projections,
            self.views.centres, self.first, grid, cell, near,
        )  # fmt: skip
        arrays = tuple(np.ascontiguousarray(a) for a in arrays)
        settings = (_CELL, self.options.reach, self.options.color, self.options.overlap)
        numbers = (*(a.ctypes.data for a in arrays), len(self.views.views), *settings)
        kinds = [*((n, ctypes.c_void_p) for n in _POINTERS), ("views", ctypes.c_int64)]
        kinds += [(n, ctypes.c_double) for n in ("cell_size", "reach", "color", "overlap")]
        table = type("SegmentTable", (ctypes.Structure,), {"_fields_": kinds})(*numbers)
        table.arrays = arrays
        return table


def find_segments(views: StartViews, options: SegmentOptions, threads: int, blur: float = 0.0) -> Segments:
    """Detect the edges of all photos in and beside their masks.

    Args:
        views: photos, cameras and masks.
        options: of the edges.
        threads: number of worker threads.
        blur: standard deviation by which the photos are blurred first, px.
    """
    found = list(parallel_map(lambda n: _detect(views, n, options, blur), range(len(views.views)), threads))
    first = np.cumsum([0, *(len(ends) for ends, _ in found)]).astype(np.int32)
    ends = np.concatenate([ends for ends, _ in found])
    view = np.repeat(np.arange(len(found), dtype=np.int32), np.diff(first))
    rays = np.stack([pixel_rays(views, view, ends[:, 2 * e : 2 * e + 2]) for e in range(2)], 1)
    sides = np.ascontiguousarray(np.concatenate([s for _, s in found]), np.float32)
    return Segments(ends, sides, np.ascontiguousarray(rays), view, first, views, options)


def _detect(
    views: StartViews, number: int, options: SegmentOptions, blur: float
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Detect a photo's longest edges by LSD (von Gioi et al. 2010).

    Returns:
        Their ends, px [N, 4], and the Lab colours of both sides, the brighter one first, [N, 2, 3].
    """
    photo = views.photo(number)
    if blur > 0:
        photo = np.asarray(cv2.GaussianBlur(photo, (0, 0), blur), np.uint8)
    lab = rgb_to_lab(photo)
    grey = np.clip(lab[..., 0] * 2.55, 0, 255).astype(np.uint8)
    large = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)  # edges of one pixel are found, too
    detector = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD, scale=0.8, quant=1.0, ang_th=22.5)
    lines = detector.detect(large)[0]
    if lines is None:
        return np.zeros((0, 4)), np.zeros((0, 2, 3), np.float32)
    ends = (lines.reshape(-1, 4).astype(float) + 0.5) / 2
    along = ends[:, 2:] - ends[:, :2]
    length = np.hypot(*along.T)
    near = dilate_square(views.labels[number] != BACKGROUND, options.margin)
    middle = np.clip(((ends[:, :2] + ends[:, 2:]) / 2).astype(int), 0, [grey.shape[1] - 1, grey.shape[0] - 1])
    wanted = np.flatnonzero((length > options.shortest) & near[middle[:, 1], middle[:, 0]])
    wanted = wanted[np.argsort(-length[wanted], kind="stable")[: options.most]]
    ends, along = ends[wanted], along[wanted]
    across = np.stack([-along[:, 1], along[:, 0]], 1) / length[wanted, None]
    sides = np.stack([_side_colors(lab, ends, along, sign * across, options) for sign in (1, -1)], 1)
    flip = sides[:, 0, 0] < sides[:, 1, 0]
    ends[flip] = ends[flip][:, [2, 3, 0, 1]]
    sides[flip] = sides[flip][:, ::-1]
    return ends, sides


def _side_colors(
    lab: NDArray[np.float32],
    ends: NDArray[np.float64],
    along: NDArray[np.float64],
    across: NDArray[np.float64],
    options: SegmentOptions,
) -> NDArray[np.float32]:
    """Compute the median colours beside edges.

    Args:
        lab: the photo, [H, W, 3].
        ends: of the edges, px, [N, 4].
        along: from the first end to the second, [N, 2].
        across: unit vectors towards the side, [N, 2].
        options: where the colours are read.

    Returns:
        [N, 3].
    """
    if not len(ends):
        return np.zeros((0, 3), np.float32)
    away, share = (
        np.linspace(*span, count) for span, count in zip((options.side, options.along), _COLOR_SAMPLES, strict=True)
    )
    at = ends[:, None, None, :2] + share[None, :, None, None] * along[:, None, None]
    places = (at + away[None, None, :, None] * across[:, None, None]).reshape(len(ends), -1, 2).astype(np.float32)
    read = cv2.remap(lab, places[..., 0] - 0.5, places[..., 1] - 0.5, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(np.median(read, 1), np.float32)
