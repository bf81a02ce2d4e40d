# SPDX-License-Identifier: GPL-3.0-or-later
"""Check the photo-consistency of stereo points: the share of photos expected to see a point that confirm it.

A pair of photos can agree on a reflection; photos from other directions contradict it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.normals import principal_normals, unit_vectors
from mgf_engine.model.masks import building
from mgf_engine.scene.depths import Depths
from mgf_engine.start.options import DenseOptions
from mgf_engine.start.views import StartViews

_CHUNK = 1 << 15  # points whose neighbours are queried at a time, which bounds the memory


def confirmed_share(
    views: StartViews,
    depths: Depths,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    seen: Sequence[NDArray[np.int64]],
    options: DenseOptions,
) -> NDArray[np.float64]:
    """Compute the share of the photos expected to see each point that confirm it.

    A photo is expected to see a point that projects into its mask, unless its viewing direction is far from that of
    the photos that see the point, or at a grazing angle, or its depth map has a surface in front of the point.

    Args:
        views: cameras and masks.
        depths: the depth maps.
        points: [N, 3], normalised frame.
        normals: unit vectors of either sign, [N, 3].
        seen: of each point, positions of the views that see it.
        options: angles from which a photo is not expected to see a point.

    Returns:
        [N], above 0, at most 1.
    """
    if not len(points):
        return np.zeros(0)
    count = np.array([len(s) for s in seen])
    towards = _mean_directions(points, np.concatenate(seen), count, views.centres)
    expected = np.zeros(len(points), np.int64)
    for number, centre in enumerate(views.centres):
        direction = unit_vectors(centre - points)
        aside = (direction * towards).sum(1) < np.cos(np.radians(options.largest_angle))
        grazing = np.abs((direction * normals).sum(1)) < np.cos(np.radians(options.grazing_angle))
        expected += _shows(views, depths, number, points) & ~aside & ~grazing
    return count / np.maximum(expected, count)


def surface_normals(points: NDArray[np.float64], neighbours: int, threads: int = 1) -> NDArray[np.float64]:
    """Compute unit normals of points [N, 3] by principal components of their neighbours, of either sign, [N, 3]."""
    tree, parts = cKDTree(points), [np.zeros((0, 3))]
    for begin in range(0, len(points), _CHUNK):
        near = tree.query(points[begin : begin + _CHUNK], min(neighbours, len(points)), workers=threads)[1]
        parts.append(principal_normals(points, near.reshape(len(near), -1)))
    return np.concatenate(parts)


def _mean_directions(
    points: NDArray[np.float64], view: NDArray[np.int64], count: NDArray[np.int64], centres: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the mean unit vectors from points to the views that see them.

    Args:
        points: [N, 3].
        view: positions of the views that see the points, those of one point beside each other.
        count: how many of them belong to each point, [N].
        centres: of the views, [V, 3].

    Returns:
        [N, 3].
    """
    owner = np.repeat(np.arange(len(points)), count)
    total = np.zeros_like(points)
    np.add.at(total, owner, unit_vectors(centres[view] - points[owner]))
    return unit_vectors(total)


def _shows(views: StartViews, depths: Depths, number: int, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points [N, 3] project into a view's mask and are not occluded in its depth map, bool [N]."""
    view, index = views.views[number], views.indices[number]
    uv, _, result = view.project_into_frame(points)
    column, row = uv[result].astype(np.int64).T
    result[result] = building(views.labels[number])[row, column]
    here = np.flatnonzero(result)
    result[here] = ~depths.hides(index, points[here])
    return result
