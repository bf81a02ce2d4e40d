# SPDX-License-Identifier: GPL-3.0-or-later
"""Orthophotos: sample each pixel of a drawing in the original photos.

The texture's choice of photos, its seams and its exposure are used. Beyond it every pixel asks its own photo whether
it sees that very point; where something stands before it another photo paints, and what none sees stays transparent.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import Array, Survey
from mgf_engine.drawings.project import GridBuffers
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.masks import building
from mgf_engine.native.parallel import parallel_map
from mgf_engine.scene.photos import PhotoMemory
from mgf_engine.system.memory import share
from mgf_engine.texture.bake import barycentric, sample_reduced_photo
from mgf_engine.texture.painting import Painting

AROUND = np.ones((3, 3), np.uint8)
EDGE_WEIGHT = 1e-3  # what a photo counts where the point lies within a pixel of an outline: its colour is mixed there


_KEPT_SHARE, _KEPT_MOST = 0.15, 4 << 30  # of the memory budget, and bytes, for depth maps that are kept
_DepthRange = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]


class Visibility:
    """Tells which points each photo of a painting shows; depth maps of views are kept while they fit into memory."""

    def __init__(self, survey: Survey, painting: Painting) -> None:
        self._survey, self._painting = survey, painting
        self._kept: dict[int, _DepthRange] = {}
        self._room = share(_KEPT_SHARE, _KEPT_MOST)

    def __call__(self, view: int, points: Array, normals: Array) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Measure the size of points in a view, and tell which it shows away from outlines.

        Args:
            view: position among the views of the painting.
            points: [n, 3], normalised frame.
            normals: of the surface there, unit [n, 3].

        Returns:
            Size in pixels squared per unit of area, 0 for points that are not shown, :data:`EDGE_WEIGHT` times that
            within a pixel of the building's outline or of something nearer, [n]; and which points are away from those,
            bool [n].
        """
        camera = self._painting.views[view]
        border, hidden = self._painting.visibility.border, self._painting.visibility.hidden
        at, depth, inside = camera.project_into_frame(points, border)
        nearest, farthest, shown = self._depth_range(view)
        column, row = np.where(inside[:, None], at, 0).astype(np.int64).T
        ray = camera.centre - points
        facing = (ray * normals).sum(1) / np.maximum(np.linalg.norm(ray, axis=1), 1e-300)
        inside &= (farthest[row, column] * (1 + hidden) >= depth) & (shown[row, column] > 0)
        inside &= facing > self._painting.visibility.least_cosine
        clear = (nearest[row, column] * (1 + hidden) >= depth) & (shown[row, column] > 1)
        size = facing * (camera.fx / np.where(inside, depth, 1.0)) ** 2
        return np.where(inside, np.where(clear, size, EDGE_WEIGHT * size), 0.0), inside & clear

    def _depth_range(self, view: int) -> _DepthRange:
        """Return the least and largest depth within a pixel, and 2 if all pixels there are building, 1 if one is.

        Args:
            view: position among the views of the painting.

        Returns:
            three maps, [H, W] each.
        """
        if view in self._kept:
            return self._kept[view]
        camera, labels = self._painting.views[view], self._survey.masks.labels[self._painting.chosen[view]]
        depth, mask = render_mesh(self._survey.normalised, camera).depth, building(labels).astype(np.uint8)
        near, far = (np.asarray(f(depth, AROUND), np.float32) for f in (cv2.erode, cv2.dilate))
        found = near, far, np.asarray(cv2.dilate(mask, AROUND) + cv2.erode(mask, AROUND), np.uint8)
        size = sum(part.nbytes for part in found)
        if size <= self._room:  # views are asked for in turn: what does not fit is best made anew each time
            self._kept[view], self._room = found, self._room - size
        return found


def paint(
    survey: Survey,
    painting: Painting,
    visibility: Visibility,
    seen: GridBuffers,
    progress: Callable[[float], None] = lambda share: None,
) -> NDArray[np.uint8]:
    """Return the orthophoto, RGBA uint8 [H, W, 4]; transparent where no photo shows what a pixel sees.

    Args:
        survey: mesh of the job, local frame.
        painting: photos and their colour corrections.
        visibility: of the photos.
        seen: faces and depths at the pixels, [H, W].
        progress: called with the share that is done, 0..1.
    """
    image = np.zeros((seen.face.size, 4), np.uint8)
    pixel, view = _assign(survey, painting, visibility, seen)
    order = np.argsort(view, kind="stable")
    used, start = np.unique(view[order], return_index=True)
    parts = np.split(pixel[order], start[1:])
    memory, face = PhotoMemory(), seen.face.ravel()

    def colors(k: int) -> NDArray[np.uint8]:
        index = int(used[k])
        camera, points = painting.views[index], survey.normalise(seen.points(parts[k]))
        size = np.median(camera.project(points)[1]) / camera.fx  # of a working pixel, normalised frame
        scale = size / (seen.grid.resolution * _shrink(survey))
        with memory.reserve(camera.original_width, camera.original_height):
            painted = sample_reduced_photo(camera, painting.source(index), points, float(scale)).astype(np.float64)
        painted += _correction(survey, painting, face[parts[k]], index, points)
        return np.clip(np.rint(painted), 0, 255).astype(np.uint8)

    for k, found in enumerate(parallel_map(colors, range(len(used)))):
        image[parts[k], :3], image[parts[k], 3] = found, 255
        progress((k + 1) / len(used))
    return image.reshape(*seen.face.shape, 4)


def _shrink(survey: Survey) -> float:
    """Return the normalised units per unit of the local frame."""
    return survey.scene.to_normalised.scale / survey.georeference.scale


def _assign(
    survey: Survey, painting: Painting, visibility: Visibility, seen: GridBuffers
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return pixels (flat indices) that some photo shows, and the view that paints each."""
    face = seen.face.ravel()
    pixel = np.flatnonzero(face >= 0)
    view = painting.label[face[pixel]].copy()
    best, clear = np.zeros(len(pixel)), np.zeros(len(pixel), bool)
    for index in np.unique(view[view >= 0]):
        rows = np.flatnonzero(view == index)
        best[rows], clear[rows] = _shown(survey, visibility, seen, int(index), pixel[rows])
    view[best <= 0] = -1
    rest = np.flatnonzero(~clear)
    for index in range(len(painting.views) if len(rest) else 0):
        size, _ = _shown(survey, visibility, seen, index, pixel[rest])
        better = size > best[rest]
        view[rest[better]], best[rest[better]] = index, size[better]
    good = view >= 0
    return pixel[good], view[good]


def _shown(
    survey: Survey, visibility: Visibility, seen: GridBuffers, view: int, pixel: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return :class:`Visibility` of what pixels see, [n]; in chunks, to keep memory small."""
    face, size, clear = seen.face.ravel(), np.empty(len(pixel)), np.empty(len(pixel), bool)
    for start in range(0, len(pixel), 1 << 20):
        chunk = pixel[start : start + (1 << 20)]
        points = survey.normalise(seen.points(chunk))
        part = slice(start, start + len(chunk))
        size[part], clear[part] = visibility(view, points, survey.normals_normalised[face[chunk]])
    return size, clear


def _correction(survey: Survey, painting: Painting, face: NDArray[np.int32], view: int, points: Array) -> Array:
    """Return the seam corrections of a photo's colours at points [n, 3] on faces [n], [n, 3]."""
    own = painting.label[face] == view
    result = np.zeros((len(face), 3))
    corners = survey.normalised.vertices[survey.normalised.faces[face[own]]]
    if len(corners):
        weight = _weights(corners, points[own])
        result[own] = (painting.corrections.value[painting.corrections.of_corner[face[own]]] * weight[..., None]).sum(1)
    return result


def _weights(corners: Array, points: Array) -> Array:
    """Return barycentric weights [n, 3] of points [n, 3] in triangles [n, 3, 3], along the axis they face most."""
    normal = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    axes = np.array([[1, 2], [2, 0], [0, 1]])[normal.argmax(1)]
    flat = np.take_along_axis(corners, axes[:, None, :].repeat(3, 1), 2)
    return np.clip(barycentric(flat, np.take_along_axis(points, axes, 1)), 0.0, 1.0)


def unseen_text(name: str, image: NDArray[np.uint8], seen: GridBuffers, least: float = 0.5) -> str | None:
    """Return a warning of an orthophoto most of which no photo shows; None if photos show enough.

    Args:
        name: of the facade.
        image: RGBA [H, W, 4], transparent where no photo shows anything.
        seen: the mesh at the pixels.
        least: share of the mesh's pixels that is enough.
    """
    surface = seen.face >= 0
    share = float((image[..., 3] > 0)[surface].mean()) if surface.any() else 0.0
    if share >= least:
        return None
    if share == 0:
        return f"No photo shows the facade {name}; its orthophoto is empty."
    return f"Photos show only {share:.0%} of the facade {name}; the rest of its orthophoto is transparent."
