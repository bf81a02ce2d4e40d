# SPDX-License-Identifier: GPL-3.0-or-later
"""Borders of named parts (windows, doors ...) on a drawing, by the vote of all photos at each pixel."""

from __future__ import annotations

import re
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import PART, Array, Polyline, Survey
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.project import Grid, GridBuffers
from mgf_engine.drawings.straighten import StraightenOptions, straighten
from mgf_engine.drawings.trace import trace
from mgf_engine.model.pixels import sample_pixels
from mgf_engine.openings.detection import align_edges
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.painting import Painting


@dataclass(frozen=True)
class PartOutlineOptions:
    """Options of the outlines of named parts."""

    least_area: float = parameter(40.0, "Minimum area of a part", "px²")
    rectangle: float = parameter(
        0.85, "Overlap (intersection over union) with its rectangle from which a part is drawn as one", high=1
    )
    aligned: float = parameter(2.0, "Distance within which edges of rectangles are put on one line", "px")
    majority: float = parameter(0.5, "Share of the photos that must call a pixel part of it", high=1)
    facing: float = parameter(0.35, "Smallest cosine between surface and drawing where parts are read", high=1)
    straightening: StraightenOptions = StraightenOptions()


def part_shares(
    survey: Survey,
    painting: Painting,
    visibility: Visibility,
    seen: GridBuffers,
    options: PartOutlineOptions = PartOutlineOptions(),
) -> dict[str, NDArray[np.float32]]:
    """Compute, for each named part, the share of the photos which see a pixel that call it that part, [H, W].

    Args:
        survey: mesh and masks of the job.
        painting: photos that may vote.
        visibility: of the photos.
        seen: faces and depths at the pixels, [H, W].
        options: limits.
    """
    normals = survey.normals @ seen.grid.frame.normal
    pixel = np.flatnonzero((seen.face.ravel() >= 0) & (normals[np.maximum(seen.face.ravel(), 0)] > options.facing))
    if not survey.parts or not len(pixel):
        return {}
    points = survey.normalise(seen.points(pixel))
    facing = survey.normals_normalised[seen.face.ravel()[pixel]]
    total = np.zeros(len(pixel), np.float32)
    votes = {name: np.zeros(len(pixel), np.float32) for name in survey.parts}
    showing = {view for elements in survey.parts.values() for view in elements}
    for k, view in enumerate(painting.chosen):
        if view not in showing:
            continue
        size, clear = visibility(k, points, facing)
        rows = np.flatnonzero(clear)
        if not len(rows):
            continue
        at = painting.views[k].project(points[rows])[0]
        weight = size[rows].astype(np.float32)
        total[rows] += weight
        for name, elements in survey.parts.items():
            shown = np.isin(survey.masks.labels[view], elements.get(view, [])).astype(np.float32)
            votes[name][rows] += weight * sample_pixels(shown, at)
    result = {}
    for name, vote in votes.items():
        share = np.zeros(seen.face.size, np.float32)
        share[pixel] = vote / np.maximum(total, 1e-12)
        result[name] = share.reshape(seen.face.shape)
    return result


def part_lines(
    shares: dict[str, NDArray[np.float32]], grid: Grid, options: PartOutlineOptions = PartOutlineOptions()
) -> list[Polyline]:
    """Return the outlines of all parts: rectangles, aligned where they differ by noise only, else polygons."""
    boxes, others = part_shapes(shares, options)
    lines = [Polyline(_polygon(own, x, y, grid, options.straightening), layer_of(name)) for name, own, x, y in others]
    for name, (left, top, right, bottom) in boxes:
        ring = np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
        lines.append(Polyline(grid.places(ring), layer_of(name)))
    return lines


def part_shapes(
    shares: dict[str, NDArray[np.float32]],
    options: PartOutlineOptions = PartOutlineOptions(),
) -> tuple[list[tuple[str, Array]], list[tuple[str, NDArray[np.bool_], int, int]]]:
    """Return parts that are rectangles: name, and left, top, right, bottom in pixels, with edges in line.

    And the others: name, pixels of the part, and where their picture begins in the grid.
    """
    boxes: list[tuple[str, Array]] = []
    others: list[tuple[str, NDArray[np.bool_], int, int]] = []
    for name, share in shares.items():
        count, part, stats, _ = cv2.connectedComponentsWithStats(
            (share > options.majority).astype(np.uint8), connectivity=4
        )
        for k in range(1, count):
            if stats[k, cv2.CC_STAT_AREA] < options.least_area:
                continue
            x, y, w, h = stats[k, :4].tolist()
            own = part[y : y + h, x : x + w] == k
            box = _rectangle(share, own, x, y, options)
            if box is not None:
                boxes.append((name, box))
            else:
                others.append((name, own, x, y))
    corners = align_edges(np.array([box for _, box in boxes]).reshape(-1, 4), options.aligned)
    return [(name, box) for (name, _), box in zip(boxes, corners, strict=True)], others


def layer_of(name: str) -> str:
    """Return the layer of a part: what DXF allows of its name."""
    return PART + (re.sub(r"[^A-Z0-9_-]+", "_", name.upper()).strip("_") or "OTHER")


def _rectangle(
    share: NDArray[np.float32], own: NDArray[np.bool_], x: int, y: int, options: PartOutlineOptions
) -> Array | None:
    """Measure a part's rectangle: left, top, right, bottom in pixels, to a part of one; None for what is no
    rectangle."""
    filled = cv2.morphologyEx(own.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0
    rows, columns = filled.sum(1), filled.sum(0)
    high, wide = np.flatnonzero(rows > 0.5 * rows.max()), np.flatnonzero(columns > 0.5 * columns.max())
    top, bottom, left, right = int(high[0]), int(high[-1]) + 1, int(wide[0]), int(wide[-1]) + 1
    box = (bottom - top) * (right - left)
    inside = int(filled[top:bottom, left:right].sum())
    if inside < options.rectangle * (box + int(filled.sum()) - inside):
        return None
    across = _profile(share[y + top : y + bottom], x + left, x + right, options)
    down = _profile(share[:, x + left : x + right].T, y + top, y + bottom, options)
    return np.array([across[0], down[0], across[1], down[1]])


def _profile(band: NDArray[np.float32], begin: int, end: int, options: PartOutlineOptions) -> tuple[float, float]:
    """Find where the median over rows of a band [n, W] crosses the majority near two columns, upwards and downwards."""
    mean = np.median(band, axis=0)
    return _crossing(mean - options.majority, begin), _crossing(options.majority - mean, end)


def _crossing(rising: NDArray[np.float32], at: int) -> float:
    """Find where values of pixels cross 0 upwards near the border before pixel ``at``; ``at`` where they do not."""
    for k in (at, at - 1, at + 1, at - 2, at + 2):
        if 1 <= k < len(rising) and rising[k - 1] <= 0 < rising[k]:
            return k - 0.5 + float(rising[k - 1] / (rising[k - 1] - rising[k]))
    return float(at)


def _polygon(own: NDArray[np.bool_], x: int, y: int, grid: Grid, options: StraightenOptions) -> Array:
    chains = trace(np.pad(own.astype(np.int32), 1))
    outer = max(chains, key=lambda chain: len(chain.corners))
    corners = grid.places(outer.corners + np.array([x - 1.0, y - 1.0]))
    return straighten(corners, (0, 0), grid.resolution, options=options).points
