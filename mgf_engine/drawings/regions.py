# SPDX-License-Identifier: GPL-3.0-or-later
"""What a drawing shows as regions: each pixel belongs to a plane of the mesh, to something loose, or to nothing."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from mgf_engine.drawings.model import Array, Frame, Survey
from mgf_engine.drawings.project import Grid, Seen, see
from mgf_engine.mesh.planar import Planes, planes_of

FINE = 0.5  # of a photo's pixel: a pixel of the regions
LONGEST = 5000  # pixels of a region map
NEAR = 1.5  # working pixels from a plane within which loose faces beside it belong to it
REACH = 12.0  # working pixels along the drawing over which they do
LEAST = 60.0  # square working pixels of a region; smaller ones go to what is around
NOTHING = 0


@dataclass(frozen=True)
class Regions:
    """A map of regions.

    Attributes:
        grid: where its pixels lie.
        label: int32 [H, W]: 0 nothing, k + 1 the k-th plane, ``loose`` everything else.
        slope: float64 [P, 3]: the k-th plane lies ``a x + b y + c`` before the drawing's plane.
    """

    grid: Grid
    label: NDArray[np.int32]
    slope: Array

    @property
    def loose(self) -> int:
        return len(self.slope) + 1

    def before(self, label: int, at: Array) -> Array:
        """Distances of a plane's points at drawing coordinates [n, 2] before the drawing's plane, [n]."""
        a, b, c = self.slope[label - 1]
        return np.asarray(a * at[:, 0] + b * at[:, 1] + c)


def survey_planes(survey: Survey) -> Planes:
    """The planes of the survey's mesh, local frame."""
    return planes_of(survey.mesh, survey.working_pixel)


def find_regions(survey: Survey, planes: Planes, frame: Frame) -> Regions:
    """The regions that a frame shows, small ones merged into what is around them."""
    from mgf_engine.drawings.project import plan_grid

    resolution = max(FINE * survey.pixel, float(frame.size.max()) / LONGEST)
    seen = see(survey, plan_grid(frame, resolution, survey.unit))
    slope = _slopes(planes, frame)
    plane = planes.label[np.maximum(seen.face, 0)]
    label = np.where(seen.face < 0, NOTHING, np.where(plane >= 0, plane + 1, len(slope) + 1)).astype(np.int32)
    regions = Regions(seen.grid, label, slope)
    _absorb(regions, seen, survey.working_pixel)
    _merge_small(regions, LEAST * (survey.working_pixel / resolution) ** 2)
    return regions


def _slopes(planes: Planes, frame: Frame) -> Array:
    """Planes as functions of drawing coordinates, [P, 3]; level with the view where they are seen edge on."""
    axes = np.stack([frame.x, frame.y, frame.normal])
    along = planes.normals @ axes.T
    level = planes.offsets - planes.normals @ frame.origin
    facing = np.where(np.abs(along[:, 2]) < 1e-3, np.inf, along[:, 2])
    return np.stack([-along[:, 0] / facing, -along[:, 1] / facing, level / facing], 1)


def _absorb(regions: Regions, seen: Seen, pixel: float) -> None:
    """Loose pixels near a plane that shows beside them become part of it."""
    label, grid = regions.label, regions.grid
    loose = label == regions.loose
    known = (label > 0) & ~loose
    if not loose.any() or not known.any():
        return
    distance, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    source = np.zeros(int(nearest.max()) + 1, np.int64)
    source[nearest[known]] = np.flatnonzero(known)
    row, column = np.nonzero(loose & (distance * grid.resolution < REACH * pixel))
    plane = label.ravel()[source[nearest[row, column]]]
    at = grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5)
    a, b, c = regions.slope[plane - 1].T
    off = np.abs(a * at[:, 0] + b * at[:, 1] + c - seen.before[row, column])
    near = off < NEAR * pixel
    label[row[near], column[near]] = plane[near]


def _merge_small(regions: Regions, least: float) -> None:
    """Connected regions of fewer pixels take the label of the nearest larger one."""
    label = regions.label
    small = np.zeros(label.shape, bool)
    for value, box in enumerate(find_objects(label + 1)):
        if box is None:
            continue
        own = (label[box] == value).astype(np.uint8)
        _, part, stats, _ = cv2.connectedComponentsWithStats(own, connectivity=4)
        drop = stats[:, cv2.CC_STAT_AREA] < least
        drop[0] = False
        small[box] |= drop[part]
    if not small.any() or small.all():
        return
    nearest = cv2.distanceTransformWithLabels(small.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]
    source = np.zeros(int(nearest.max()) + 1, np.int64)
    source[nearest[~small]] = np.flatnonzero(~small)
    label[small] = label.ravel()[source[nearest[small]]]
