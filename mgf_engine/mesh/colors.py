# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour the vertices of a mesh: robust mean of the photos in which a vertex is visible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.geometry.rasterize import corners, render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.pixels import sample_pixels
from mgf_engine.model.scene import View, most_pixels
from mgf_engine.native.library import call
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

_BYTES_PER_PIXEL, _BYTES_PER_VERTEX = 30, 80  # while a view is drawn
CHUNK = 1 << 15  # vertices that are blended at a time


@dataclass(frozen=True)
class ColorOptions:
    """Options of vertex colours."""

    best: int = parameter(
        5, "Number of photos blended at a vertex: those that see it largest and most frontally", low=1
    )
    least_facing: float = parameter(0.1, "Minimum cosine of the angle at which a photo sees a vertex", high=1)
    outlier: float = parameter(
        40.0, "Difference from the median beyond which a photo is left out (reflections, passers-by)", "grey levels"
    )
    hidden: float = parameter(
        0.01, "Distance behind the visible surface from which a vertex is hidden, as a share of its depth"
    )


def color_from_photos(
    mesh: Mesh,
    views: Sequence[View],
    photo: Callable[[int], NDArray[np.uint8]],
    inside: Sequence[NDArray[np.bool_]],
    progress: Callable[[float], None] = lambda share: None,
    options: ColorOptions = ColorOptions(),
) -> Mesh:
    """Colour the vertices of a mesh from the photos that show them.

    Args:
        mesh: normalised frame.
        views: cameras whose photos may be used.
        photo: position in ``views`` -> RGB uint8 [H, W, 3].
        inside: per view, bool [H, W]: pixels that show the building.
        progress: called with the share of the views done.
        options: number of the samples, and which of them are left out.
    """
    weight = np.zeros((len(mesh.vertices), options.best), np.float32)
    shown = np.zeros((len(mesh.vertices), options.best, 3), np.uint8)
    normals, each = vertex_normals(mesh), _BYTES_PER_PIXEL * most_pixels(views) + _BYTES_PER_VERTEX * len(mesh.vertices)

    def seen(i: int) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.uint8]]:
        return _samples(mesh, normals, views[i], photo(i), inside[i], options)

    for i, (index, new_weight, new_shown) in enumerate(parallel_map(seen, range(len(views)), bytes_each=each)):
        progress(i / len(views))
        worst = weight[index].argmin(1)
        better = new_weight > weight[index, worst]
        weight[index[better], worst[better]] = new_weight[better]
        shown[index[better], worst[better]] = new_shown[better]
    starts = range(0, len(weight), CHUNK)

    def blend(start: int) -> NDArray[np.uint8]:
        return _blend(weight[start : start + CHUNK], shown[start : start + CHUNK], options.outlier)

    blended = parallel_map(blend, starts)
    colors = np.concatenate([np.zeros((0, 3), np.uint8), *blended])
    return replace(mesh, colors=_fill(mesh, colors, weight.max(1) > 0))


def _samples(
    mesh: Mesh,
    normals: NDArray[np.float64],
    view: View,
    photo: NDArray[np.uint8],
    inside: NDArray[np.bool_],
    options: ColorOptions,
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.uint8]]:
    """Return the vertices visible in a view, their weights, and their colours in the photo."""
    at = corners(mesh.vertices, view)
    # the largest depth around the pixel: a vertex on a rim must not be hidden by its own neighbours
    farthest = cv2.dilate(render_mesh(mesh, view, at).depth, np.ones((3, 3), np.uint8))
    index, weight = np.empty(len(at), np.int64), np.empty(len(at), np.float32)
    points, shown = np.ascontiguousarray(mesh.vertices, dtype=np.float64), np.ascontiguousarray(inside)
    camera = np.array([*view.centre, view.fx, options.least_facing])
    given = (len(at), at, points, normals, camera, farthest, shown, *farthest.shape, 1.0 + options.hidden)
    count = call("mgf_seen_vertices", *given, index, weight)
    return index[:count], weight[:count], sample_pixels(photo, at[index[:count], :2])


def _blend(weight: NDArray[np.float32], shown: NDArray[np.uint8], outlier: float) -> NDArray[np.uint8]:
    """Weighted mean over the samples [N, K, 3] that lie near their median."""
    known = np.where(weight[..., None] > 0, shown, np.nan).astype(np.float32)
    known[weight.max(1) <= 0] = 0
    median = np.nanmedian(known, axis=1, keepdims=True)
    near = np.abs(shown - median).max(2) <= outlier
    kept = np.where(near, weight, 0) + 1e-6 * weight
    total = np.maximum(kept.sum(1, keepdims=True), 1e-30)
    blended = (shown * kept[..., None]).sum(1) / total
    return np.clip(np.rint(blended), 0, 255).astype(np.uint8)


def _fill(mesh: Mesh, colors: NDArray[np.uint8], known: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Set the colour of vertices that no photo shows to that of the nearest coloured vertex."""
    if known.all():
        return colors
    if not known.any():
        return np.full_like(colors, 160)
    nearest = cKDTree(mesh.vertices[known]).query(mesh.vertices[~known])[1]
    colors = colors.copy()
    colors[~known] = colors[known][nearest]
    return colors
