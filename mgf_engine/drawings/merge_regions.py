# SPDX-License-Identifier: GPL-3.0-or-later
"""Merge regions of a drawing whose border is none on the building.

The mesh of one wall can have several planes, some of them fitted to its noise, and between a wall and the eaves that
overhang it the mesh goes round gently, for photos from above do not show the underside. A region is merged with a
larger one beside it if its surface parts from that one's plane by no more than the error of stereo, and an underside
with what is below it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from mgf_engine.drawings.model import LEANING, Array, Survey
from mgf_engine.drawings.project import GridBuffers
from mgf_engine.drawings.regions import LOOSE, NOTHING, RegionMap, boxes_of_labels
from mgf_engine.options.algorithms import parameter

Box = tuple[slice, slice]


@dataclass(frozen=True)
class RegionMergingOptions:
    """Options of the merging of regions whose border is none on the building."""

    parted: float = parameter(
        3.0, "Distance from a plane beside it that a tenth of a region has to exceed to stay a region", "ground px"
    )
    parted_tilted: float = parameter(4.0, "The same if its own plane is tilted against that plane", "ground px")
    tilted: float = parameter(9.0, "Angle between two planes from which they are tilted", "degrees", high=180)
    border: float = parameter(4.0, "Minimum length of the border between two regions that are merged", "ground px")
    downwards: float = parameter(
        9.0, "Angle by which a surface faces downwards from which it is an underside", "degrees", high=90
    )
    underside: float = parameter(
        30.0, "Largest mean height of an underside in an elevation; higher ones are walls that lean", "ground px"
    )
    rounds: int = parameter(6, "Maximum number of rounds of merging", low=0)


@dataclass(frozen=True)
class RegionPart:
    """A connected part of a region: its label, box in the map, pixels in that box, and the rest of what is known."""

    label: int
    box: Box
    own: NDArray[np.bool_]
    size: int


def merge_regions(
    regions: RegionMap, seen: GridBuffers, survey: Survey, options: RegionMergingOptions = RegionMergingOptions()
) -> None:
    """Merge regions of a map with others beside them.

    Args:
        regions: of a drawing; their labels are changed in place.
        seen: the mesh at the pixels of the same map.
        survey: of the mesh, local frame.
        options: what is merged.
    """
    label, slope = regions.label, regions.slope
    grid = seen.grid
    pixel = survey.working_pixel
    up = survey.normals[:, 2][np.maximum(seen.face, 0)] if abs(grid.frame.normal[2]) < LEANING else None
    long_enough = options.border * pixel / grid.resolution
    for _ in range(options.rounds):
        parts, borders = _parts(label)
        new = {}
        for k, part in enumerate(parts):
            beside = [parts[other] for other, n in borders.get(k, {}).items() if n >= long_enough]
            target = _underside_of(part, label, up, pixel / grid.resolution, options) if up is not None else None
            if target is None and part.label != LOOSE:
                target = _alike(part, beside, slope, seen, pixel, options)
            if target is not None:
                new[k] = target
        for k, target in new.items():
            label[parts[k].box][parts[k].own] = target
        if not new:
            return


def _parts(label: NDArray[np.int32]) -> tuple[list[RegionPart], dict[int, dict[int, int]]]:
    """Return the connected parts of all regions, and for each the others beside it with the length of their border."""
    number = np.zeros(label.shape, np.int32)
    parts = list[RegionPart]()
    for value, box in boxes_of_labels(label):
        if value == NOTHING:
            continue
        _, part = cv2.connectedComponents((label[box] == value).astype(np.uint8), connectivity=4)
        for k, inner in enumerate(find_objects(part), start=1):
            rows, columns = (slice(a.start + b.start, a.start + b.stop) for a, b in zip(box, inner, strict=True))
            own = part[inner] == k
            parts.append(RegionPart(value, (rows, columns), own, int(own.sum())))
            number[rows, columns][own] = len(parts)
    borders: dict[int, dict[int, int]] = {}
    for one, other in ((number[:, 1:], number[:, :-1]), (number[1:], number[:-1])):
        differ = (one != other) & (one > 0) & (other > 0)
        pairs, counts = np.unique(np.stack([one[differ], other[differ]], 1), axis=0, return_counts=True)
        for (a, b), n in zip((pairs - 1).tolist(), counts.tolist(), strict=True):
            for x, y in ((a, b), (b, a)):
                borders.setdefault(x, {})[y] = borders.get(x, {}).get(y, 0) + n
    return parts, borders


def _alike(
    part: RegionPart,
    beside: list[RegionPart],
    slope: Array,
    seen: GridBuffers,
    pixel: float,
    options: RegionMergingOptions,
) -> int | None:
    """Return the label of the larger plane beside a part that its surface parts from least, None where all part."""
    best, found = np.inf, None
    depth = seen.before[part.box]
    rows, columns = np.nonzero(part.own & np.isfinite(depth))
    if not len(rows):
        return None
    corner = np.array([part.box[1].start, part.box[0].start])
    at = seen.grid.places(np.stack([columns, rows], 1) + corner + 0.5)
    a0, b0, _ = slope[part.label - 1]
    for label in {other.label for other in beside if other.size > part.size and other.label != LOOSE} - {part.label}:
        a, b, c = slope[label - 1]
        off = np.abs(a * at[:, 0] + b * at[:, 1] + c - depth[rows, columns]) / np.sqrt(a * a + b * b + 1)
        cosine = (a * a0 + b * b0 + 1) / np.sqrt((a * a + b * b + 1) * (a0 * a0 + b0 * b0 + 1))
        tilted = cosine < np.cos(np.radians(options.tilted))
        share = float(np.quantile(off, 0.9)) / (pixel * (options.parted_tilted if tilted else options.parted))
        if share <= min(best, 1.0):
            best, found = share, label
    return found


def _underside_of(
    part: RegionPart, label: NDArray[np.int32], up: NDArray[np.float64], pixel: float, options: RegionMergingOptions
) -> int | None:
    """Return the label below a part that is an underside, None where it is none or nothing is below.

    Args:
        part: of a region.
        label: of the regions, [H, W].
        up: component of the normals upwards, [H, W].
        pixel: a ground pixel, pixels of the map.
        options: what an underside is.
    """
    if float(up[part.box][part.own].mean()) > -np.sin(np.radians(options.downwards)):
        return None
    if part.size > options.underside * pixel * int(part.own.any(0).sum()):
        return None
    rows, columns = (s.start for s in part.box)
    last = part.own.shape[0] - 1 - part.own[::-1].argmax(0)
    wide = np.flatnonzero(part.own.any(0))
    below = label[np.minimum(last[wide] + rows + 1, len(label) - 1), wide + columns]
    values, counts = np.unique(below[(below != NOTHING) & (below != LOOSE) & (below != part.label)], return_counts=True)
    return int(values[counts.argmax()]) if counts.sum() > 0.5 * len(wide) else None
