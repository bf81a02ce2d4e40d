# SPDX-License-Identifier: GPL-3.0-or-later
"""Segment a drawing into regions: each pixel belongs to a plane of the mesh, to no plane, or to nothing.

Regions begin with the planes of the mesh and grow over pixels near these planes. RANSAC fits further planes to the
pixels left over; small regions and holes are merged with the region around them, and a majority filter smooths borders.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from mgf_engine.drawings.model import Array, DrawingFrame, Survey
from mgf_engine.drawings.project import Grid, GridBuffers, plan_grid, render_grid
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.mesh.plane_detection import Planes, planes_of
from mgf_engine.options.algorithms import parameter

NOTHING, LOOSE = 0, 1 << 20


@dataclass(frozen=True)
class RegionOptions:
    """Options of the regions of a drawing."""

    pixel: float = parameter(0.5, "Size of a pixel of the map of regions", "ground px", low=0.05)
    longest_side: int = parameter(3000, "Longest side of the map of regions", "px", low=16)
    plane_distance: float = parameter(
        2.5, "Largest distance from a plane of a surface that the plane grows over", "ground px"
    )
    least_plane: float = parameter(
        500.0, "Minimum area of a further plane, fitted to what is in no plane of the mesh", "ground px²"
    )
    largest_slope: float = parameter(4.0, "Slope against the drawing's plane from which no further plane is fitted")
    trials: int = parameter(150, "Number of samples of RANSAC, and of further planes", low=1)
    sample: int = parameter(3000, "Number of pixels that RANSAC fits a plane to", low=3)
    least_region: float = parameter(
        120.0, "Minimum area of a region; smaller ones are merged with what is around", "ground px²"
    )
    least_hole: float = parameter(
        1600.0, "Minimum area of a hole; smaller ones are merged with what is around", "ground px²"
    )
    smoothing: float = parameter(2.0, "Radius of the majority filter that smooths borders", "ground px")
    reach: float = parameter(0.3, "Distance that a plane grows beyond its bounding box, as a share of that box")


@dataclass(frozen=True)
class RegionMap:
    """A map of regions.

    Attributes:
        grid: where its pixels lie.
        label: int32 [H, W]: 0 nothing, k + 1 the k-th plane, :data:`LOOSE` everything else.
        slope: float64 [P, 3]: the k-th plane lies ``a x + b y + c`` before the drawing's plane.
    """

    grid: Grid
    label: NDArray[np.int32]
    slope: Array

    def before(self, label: int, at: Array) -> Array:
        """Return the distances of a plane's points at drawing coordinates [n, 2] before the drawing's plane, [n]."""
        a, b, c = self.slope[label - 1]
        return np.asarray(a * at[:, 0] + b * at[:, 1] + c)

    def normal(self, label: int) -> Array:
        """Return unit normal of a plane in drawing coordinates, towards whoever looks, [3]."""
        a, b, _ = self.slope[label - 1]
        return np.asarray(np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1))


def survey_planes(survey: Survey, options: PlanarOptions = PlanarOptions()) -> Planes:
    """Return the planes of the survey's mesh, local frame."""
    return planes_of(survey.mesh, survey.working_pixel, options)


def find_regions(
    survey: Survey, planes: Planes, frame: DrawingFrame, options: RegionOptions = RegionOptions()
) -> RegionMap:
    """Find the regions that a frame shows.

    Args:
        survey: mesh in the local frame.
        planes: of its faces.
        frame: what the drawing shows.
        options: least sizes of regions.
    """
    pixel = survey.working_pixel
    resolution = max(options.pixel * pixel, float(frame.size.max()) / options.longest_side)
    seen = render_grid(survey, plan_grid(frame, resolution))
    slope = _slopes(planes, frame)
    plane = planes.label[np.maximum(seen.face, 0)]
    label = np.where(seen.face < 0, NOTHING, np.where(plane >= 0, plane + 1, LOOSE)).astype(np.int32)
    regions = RegionMap(seen.grid, label, slope)
    square = (pixel / resolution) ** 2
    _grow(regions, seen, options.plane_distance * pixel, options)
    regions = _further_planes(regions, seen, options.plane_distance * pixel, options.least_plane * square, options)
    _merge_small(regions, options.least_region * square, options.least_hole * square)
    _smooth(regions.label, max(1, round(options.smoothing * pixel / resolution)))
    _merge_small(regions, options.least_region * square, options.least_hole * square)
    return regions


def _slopes(planes: Planes, frame: DrawingFrame) -> Array:
    """Return planes as functions of drawing coordinates, [P, 3]; level with the view where they are seen edge on."""
    along = planes.normals @ np.stack([frame.x, frame.y, frame.normal]).T
    level = planes.offsets - planes.normals @ frame.origin
    facing = np.where(np.abs(along[:, 2]) < 1e-3, np.inf, along[:, 2])
    return np.stack([-along[:, 0] / facing, -along[:, 1] / facing, level / facing], 1)


def _offsets(regions: RegionMap, seen: GridBuffers, label: int, box: tuple[slice, slice]) -> NDArray[np.float32]:
    """Compute the distance of the surface at pixels of a box from a plane, along its normal; NaN without surface."""
    a, b, c = regions.slope[label - 1]
    grid, (rows, columns) = regions.grid, box
    x = grid.left + (np.arange(columns.start, columns.stop) + 0.5) * grid.resolution
    y = grid.top - (np.arange(rows.start, rows.stop) + 0.5) * grid.resolution
    off = seen.before[box] - (a * x + c).astype(np.float32) - (b * y).astype(np.float32)[:, None]
    return np.asarray(np.abs(off) * np.float32(1 / np.sqrt(a * a + b * b + 1)))


def _grow(regions: RegionMap, seen: GridBuffers, near: float, options: RegionOptions) -> None:
    """Give the loose pixels near planes that hang together with them to the nearest plane."""
    label = regions.label
    best, taken = np.full(label.shape, near, np.float32), np.zeros(label.shape, np.int32)
    loose = label == LOOSE
    for index, own_box in enumerate(find_objects(np.where(loose, 0, label))):
        if own_box is None:
            continue
        box = _wider(own_box, label.shape, options.reach)
        value, own = index + 1, label[box] == index + 1
        off = _offsets(regions, seen, value, box)
        fits = own | (loose[box] & (off < best[box]))
        _, part = cv2.connectedComponents(fits.astype(np.uint8), connectivity=4)
        touched = np.zeros(int(part.max()) + 1, bool)
        touched[part[own]] = True
        touched[0] = False
        better = touched[part] & ~own
        best[box][better], taken[box][better] = off[better], value
    label[taken > 0] = taken[taken > 0]


def _wider(box: tuple[slice, ...], shape: tuple[int, ...], share: float) -> tuple[slice, slice]:
    """Widen a box by so much of itself on every side, as far as the image reaches."""
    add = [int(share * (s.stop - s.start)) + 1 for s in box]
    rows, columns = (slice(max(0, s.start - a), min(n, s.stop + a)) for s, n, a in zip(box, shape, add, strict=True))
    return rows, columns


def _further_planes(
    regions: RegionMap, seen: GridBuffers, near: float, least: float, options: RegionOptions
) -> RegionMap:
    """Find planes through large loose parts, one after the other."""
    rng, tried = np.random.default_rng(0), 0
    for box, own in list(_parts(regions.label, LOOSE)):
        left = own.copy()
        while left.sum() >= least and tried < options.trials:
            tried += 1
            slope = _plane_through(regions, seen, box, left, near, rng, options)
            if slope is None:
                break
            grown = replace(regions, slope=np.concatenate([regions.slope, slope[None]]))
            label = len(grown.slope)
            fits = left & (_offsets(grown, seen, label, box) < near)
            _, part, stats, _ = cv2.connectedComponentsWithStats(fits.astype(np.uint8), connectivity=4)
            if len(stats) < 2 or stats[1:, cv2.CC_STAT_AREA].max() < least:
                break
            largest = part == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
            regions.label[box][largest] = label
            regions, left = grown, left & ~largest
    return regions


def _plane_through(
    regions: RegionMap,
    seen: GridBuffers,
    box: tuple[slice, slice],
    own: NDArray[np.bool_],
    near: float,
    rng: np.random.Generator,
    options: RegionOptions,
) -> Array | None:
    """Return the plane (a, b, c) that most of the pixels of a part lie in; None where it is seen edge on."""
    row, column = np.nonzero(own)
    some = rng.choice(len(row), min(options.sample, len(row)), replace=False)
    at = regions.grid.places(np.stack([column[some] + box[1].start, row[some] + box[0].start], 1) + 0.5)
    points = np.column_stack([at, seen.before[box][row[some], column[some]]])
    three = points[rng.integers(0, len(points), (options.trials, 3))]
    normal = np.cross(three[:, 1] - three[:, 0], three[:, 2] - three[:, 0])
    usable = np.abs(normal[:, 2]) * options.largest_slope > np.hypot(normal[:, 0], normal[:, 1])
    if not usable.any():
        return None
    normal, origin = normal[usable], three[usable, 0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = np.abs(points @ normal.T - (origin * normal).sum(1))
    k = int((off < near).sum(0).argmax())
    held = points[off[:, k] < near]
    terms = np.column_stack([held[:, :2], np.ones(len(held))])
    slope = np.linalg.lstsq(terms, held[:, 2], rcond=None)[0]
    return np.asarray(slope) if np.hypot(slope[0], slope[1]) < options.largest_slope else None


def _parts(label: NDArray[np.int32], value: int) -> Iterator[tuple[tuple[slice, slice], NDArray[np.bool_]]]:
    """Yield the box of each connected part of one label, and its pixels in it."""
    _, part = cv2.connectedComponents((label == value).astype(np.uint8), connectivity=4)
    for k, box in enumerate(find_objects(part), start=1):
        if box is not None:
            yield box, part[box] == k


def boxes_of_labels(label: NDArray[np.int32]) -> Iterator[tuple[int, tuple[slice, slice]]]:
    """Yield each label of a map and the box around its pixels."""
    loose = label == LOOSE
    last = int(label[~loose].max(initial=0)) + 1
    for value, box in enumerate(find_objects(np.where(loose, last, label) + 1)):
        if box is not None:
            yield LOOSE if value == last else value, box


def _merge_small(regions: RegionMap, least: float, hole: float) -> None:
    """Give connected regions and holes of fewer pixels the label of the nearest larger region."""
    label = regions.label
    small = np.zeros(label.shape, bool)
    for value, box in boxes_of_labels(label):
        own = (label[box] == value).astype(np.uint8)
        _, part, stats, _ = cv2.connectedComponentsWithStats(own, connectivity=4)
        drop = stats[:, cv2.CC_STAT_AREA] < (hole if value == NOTHING else least)
        drop[0] = False
        if value == NOTHING:  # around the building it is no hole
            drop[np.unique(np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]]))] = False
        small[box] |= drop[part]
    if not small.any() or small.all():
        return
    nearest = cv2.distanceTransformWithLabels(small.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]
    source = np.zeros(int(nearest.max()) + 1, np.int64)
    source[nearest[~small]] = np.flatnonzero(~small)
    label[small] = label.ravel()[source[nearest[small]]]


def _smooth(label: NDArray[np.int32], radius: int) -> None:
    """Give each pixel the label that most pixels of the square around it have."""
    most, winner = np.zeros(label.shape, np.float32), label.copy()
    size = (2 * radius + 1, 2 * radius + 1)
    for value, box in boxes_of_labels(label):
        wide = tuple(
            slice(max(0, s.start - radius), min(n, s.stop + radius)) for s, n in zip(box, label.shape, strict=True)
        )
        own = (label[wide] == value).astype(np.float32)
        votes = cv2.boxFilter(own, -1, size, normalize=False, borderType=cv2.BORDER_REPLICATE) + 0.5 * own
        better = votes > most[wide]
        most[wide][better], winner[wide][better] = votes[better], value
    label[:] = winner
