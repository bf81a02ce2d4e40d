# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of a drawing that the planes of the mesh know: planes seen edge on, and silhouettes where two planes meet.

A silhouette wanders with the noise of single faces, while the planes on both sides are fitted to thousands: the end
wall that a front elevation sees edge on, a roof in the elevation of its gable, the ridge. Borders of regions near such
a line are drawn on it (:mod:`mgf_engine.drawings.straighten`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import Array, DrawingFrame, Survey
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PlaneLineOptions:
    """Options of the lines that planes give."""

    edge_on: float = parameter(3.0, "Largest angle of a plane that is seen edge on to the rays", "degrees", high=45)
    least_angle: float = parameter(20.0, "Smallest angle between two planes that meet", "degrees", high=90)
    least_area: float = parameter(1500.0, "Minimum area of a plane that gives lines", "ground px²")
    apart: float = parameter(8.0, "Largest distance of two planes that meet from each other", "ground px")


def plane_lines(
    survey: Survey, planes: Planes, frame: DrawingFrame, options: PlaneLineOptions = PlaneLineOptions()
) -> Array:
    """Return the lines that the planes of a mesh give in a drawing: ``a x + b y + c = 0`` with (a, b) of length 1, and
    where along (b, -a) each begins and ends, drawing coordinates [K, 5].

    Args:
        survey: mesh in the local frame.
        planes: of its faces.
        frame: what the drawing shows.
        options: which planes count.
    """
    pixel = survey.working_pixel
    axes = np.stack([frame.x, frame.y, frame.normal])
    normals, offsets = planes.normals @ axes.T, planes.offsets - planes.normals @ frame.origin
    rows = np.flatnonzero(planes.label >= 0)
    area = np.bincount(planes.label[rows], survey.areas[rows], len(normals))
    large = np.flatnonzero(area >= options.least_area * pixel**2)
    boxes = _boxes(survey, planes, frame, large)
    found = _edge_on(normals, offsets, large, boxes, options)
    found += _meetings(normals, offsets, large, boxes, pixel, options)
    return np.array(found).reshape(-1, 5)


def _boxes(survey: Survey, planes: Planes, frame: DrawingFrame, large: NDArray[np.int64]) -> Array:
    """Return lowest and highest corner of the faces of planes, drawing coordinates and depth, [P, 2, 3]."""
    at = frame.to_drawing(survey.mesh.vertices)
    boxes = np.zeros((len(planes.normals), 2, 3))
    for k in large:
        corners = at[survey.mesh.faces[planes.label == k]].reshape(-1, 3)
        boxes[k] = np.percentile(corners, (1, 99), axis=0)
    return boxes


def _edge_on(
    normals: Array, offsets: Array, large: NDArray[np.int64], boxes: Array, options: PlaneLineOptions
) -> list[Array]:
    """Return the lines of planes seen edge on, where they are nearest to whoever looks and farthest away."""
    found = list[Array]()
    for k in large[np.abs(normals[large, 2]) < np.sin(np.radians(options.edge_on))]:
        length = float(np.hypot(*normals[k, :2]))
        for depth in boxes[k, :, 2]:
            line = np.array([*normals[k, :2], normals[k, 2] * depth - offsets[k]]) / length
            found.append(_within(line, boxes[k, :, :2]))
    return found


def _meetings(
    normals: Array, offsets: Array, large: NDArray[np.int64], boxes: Array, pixel: float, options: PlaneLineOptions
) -> list[Array]:
    """Return the lines of the silhouettes where two planes meet that touch each other, such as ridges."""
    found = list[Array]()
    for a, k in enumerate(large):
        for j in large[a + 1 :]:
            hidden = normals[k, 2] * normals[j, 2] < 0  # one is seen, the other faces away: their edge is a silhouette
            if not hidden or abs(float(normals[k] @ normals[j])) > np.cos(np.radians(options.least_angle)):
                continue
            low = np.maximum(boxes[k, 0], boxes[j, 0]) - options.apart * pixel
            high = np.minimum(boxes[k, 1], boxes[j, 1]) + options.apart * pixel
            line = normals[k] * normals[j, 2] - normals[j] * normals[k, 2]  # its depth is eliminated
            length = float(np.hypot(*line[:2]))
            if (low > high).any() or length < 1e-3:
                continue
            offset = offsets[k] * normals[j, 2] - offsets[j] * normals[k, 2]
            found.append(_within(np.array([*line[:2], -offset]) / length, np.stack([low, high])[:, :2]))
    return found


def _within(line: Array, box: Array) -> Array:
    """Return a line (a, b, c) with its begin and end in the rectangle between two corners [2, 2], [5]."""
    a, b, c = line
    (left, low), (right, high) = box
    at = np.array([left, right]) if abs(b) > abs(a) else np.array([low, high])
    other = -(c + a * at) / b if abs(b) > abs(a) else -(c + b * at) / a
    x, y = (at, other) if abs(b) > abs(a) else (other, at)
    along = np.sort(b * x - a * y)
    return np.array([a, b, c, *along])
