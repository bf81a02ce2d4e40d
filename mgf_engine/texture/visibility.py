# SPDX-License-Identifier: GPL-3.0-or-later
"""Visibility of the faces in the photos: which photos show a face, and how large."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import corners, face_normals, render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.pixels import sample_pixels
from mgf_engine.model.scene import View, most_pixels
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

_BYTES_PER_PIXEL, _BYTES_PER_FACE = 30, 60  # while a view is drawn


@dataclass(frozen=True)
class VisibilityOptions:
    """Options of which photos show which faces."""

    large: float = parameter(12.0, "Area from which a face is tested by pixels, smaller ones by corners", "px²")
    shown: float = parameter(0.75, "Share of a large face's area that must be visible inside the mask", high=1)
    other_color: float = parameter(
        25.0,
        "Difference from the blended vertex colours above which a photo shows something else (leaves, reflections)",
        "grey levels",
    )
    odd_weight: float = parameter(0.01, "Weight of a face's size in a photo that shows it in a deviating colour")
    border: float = parameter(1.5, "Width of the border of a photo that is not used for texture", "px")
    hidden: float = parameter(
        0.01, "Distance behind the visible surface from which a place is hidden, as a share of its depth"
    )
    rim: float = parameter(
        4.0, "Distance from what hides the building or lies behind it below which a face counts little", "px"
    )
    rim_share: float = parameter(0.2, "Share of a large face's area from which it counts as that near", high=1)
    rim_weight: float = parameter(0.1, "Weight of a face's size in a photo where it lies that near")
    least_cosine: float = parameter(
        0.15, "Cosine between a face's normal and the ray below which a photo does not paint it", high=1
    )
    least_size: float = parameter(
        0.25, "Size of a face in a photo, as a share of the largest, from which the photo may paint it", high=1
    )


@dataclass(frozen=True)
class FaceViews:
    """Pairs of a view and a face that it shows fairly large (``least_size`` of the options), ordered by view.

    Attributes:
        view: int32 [K], position among the views.
        face: int32 [K].
        size: float32 [K], pixels of the working photo that the face takes.
        faces: number of faces of the mesh.
    """

    view: NDArray[np.int32]
    face: NDArray[np.int32]
    size: NDArray[np.float32]
    faces: int


class ShownFaces:
    """Set of pairs of a face and a view that may texture it; called with faces and views [K], tells which are in it."""

    def __init__(self, face: NDArray[np.int32], view: NDArray[np.int32]) -> None:
        self._base = int(view.max(initial=0)) + 1
        self._keys = np.sort(face.astype(np.int64) * self._base + view)

    def __call__(self, face: NDArray[np.integer], view: NDArray[np.integer]) -> NDArray[np.bool_]:
        if not len(self._keys):
            return np.zeros(len(face), bool)
        key = face.astype(np.int64) * self._base + view
        at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        return np.asarray((self._keys[at] == key) & (view >= 0), bool)


def find_face_views(
    mesh: Mesh,
    views: Sequence[View],
    photo: Callable[[int], NDArray[np.uint8]],
    inside: Callable[[int], NDArray[np.bool_]],
    progress: Callable[[float], None] = lambda share: None,
    options: VisibilityOptions = VisibilityOptions(),
) -> FaceViews:
    """Find the faces that each view shows.

    Args:
        mesh: normalised frame.
        views: cameras of the photos.
        photo: position in ``views`` -> working photo, RGB uint8 [H, W, 3].
        inside: position in ``views`` -> bool [H, W], pixels that show the building.
        progress: called with the share of the views done.
        options: from which size on a view shows a face.
    """
    normals = face_normals(mesh)

    def find_shown(i: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        return _shown(mesh, normals, views[i], photo(i), inside(i), options)

    found = _FaceViewCollector(len(mesh.faces), options.least_size)
    each = _BYTES_PER_PIXEL * most_pixels(views) + _BYTES_PER_FACE * len(mesh.faces)
    for i, (faces, sizes) in enumerate(parallel_map(find_shown, range(len(views)), bytes_each=each)):
        progress(i / len(views))
        found.add(i, faces, sizes)
    return found.collect()


class _FaceViewCollector:
    """Collects the faces that views show, within bounded memory.

    Each photo shows about a tenth of the faces, so that those of hundreds of photos would fill the memory. Faces that
    are much smaller in a view than in another one would be dropped in the end; they are dropped underway.
    """

    def __init__(self, faces: int, least_size: float) -> None:
        self._least_size = least_size
        self._best = np.zeros(faces, np.float32)
        self._parts: list[tuple[int, NDArray[np.int32], NDArray[np.float32]]] = []
        self._count, self._limit = 0, 2 * faces

    def add(self, view: int, faces: NDArray[np.int32], sizes: NDArray[np.float32]) -> None:
        """Add what one view shows; views come in their order."""
        self._best[faces] = np.maximum(self._best[faces], sizes)
        self._parts.append((view, faces, sizes))
        self._count += len(faces)
        if self._count > self._limit:
            self._drop_small()
            self._limit = 2 * max(self._count, len(self._best))

    def collect(self) -> FaceViews:
        """Return all pairs of a view and a face that it shows fairly large."""
        self._drop_small()
        view = np.repeat(np.array([v for v, *_ in self._parts], np.int32), [len(f) for _, f, _ in self._parts])
        face = np.concatenate([np.zeros(0, np.int32), *(f for _, f, _ in self._parts)])
        size = np.concatenate([np.zeros(0, np.float32), *(s for *_, s in self._parts)])
        return FaceViews(view, face, size, len(self._best))

    def _drop_small(self) -> None:
        for number, (view, faces, sizes) in enumerate(self._parts):
            kept = sizes >= self._least_size * self._best[faces]
            self._parts[number] = view, faces[kept], sizes[kept]
        self._count = sum(len(faces) for _, faces, _ in self._parts)


def _shown(
    mesh: Mesh,
    normals: NDArray[np.float64],
    view: View,
    photo: NDArray[np.uint8],
    inside: NDArray[np.bool_],
    options: VisibilityOptions,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the faces that a view shows, and how large they are in it."""
    at = corners(mesh.vertices, view)
    buffers = render_mesh(mesh, view, at)
    u, v, inverse = at.T
    high, wide = view.height - options.border, view.width - options.border
    framed = (inverse > 0) & (u > options.border) & (v > options.border) & (u < wide) & (v < high)
    visible, off = _at_vertices(mesh, np.flatnonzero(framed), at, buffers.depth, photo, inside, options.hidden)
    drawn = np.bincount(buffers.face[(buffers.face >= 0) & inside], minlength=len(mesh.faces))
    at_corners = np.asarray(visible[mesh.faces].all(1))
    face = np.flatnonzero(at_corners | ((drawn > 0) & framed[mesh.faces].all(1)))
    area = _area(at[mesh.faces[face], :2])
    kept = np.where(area < options.large, at_corners[face], drawn[face] >= options.shown * area)
    kept &= (area > 0) & (_facing(mesh, normals, face, view) > options.least_cosine)
    face, area = face[kept], area[kept]
    area = np.where(off[mesh.faces[face]].mean(1) > options.other_color, options.odd_weight * area, area)
    near = _at_rim(buffers.depth, inside, options)
    of_pixels = np.bincount(buffers.face[near & inside & (buffers.face >= 0)], minlength=len(mesh.faces))[face]
    x, y = np.clip(at[mesh.faces[face], :2].astype(np.int64), 0, (view.width - 1, view.height - 1)).transpose(2, 0, 1)
    rim = np.where(area < options.large, near[y, x].any(1), of_pixels > options.rim_share * drawn[face])
    return face.astype(np.int32), np.where(rim, options.rim_weight * area, area).astype(np.float32)


def _at_vertices(
    mesh: Mesh,
    framed: NDArray[np.int64],
    at: NDArray[np.float64],
    depth: NDArray[np.float32],
    photo: NDArray[np.uint8],
    inside: NDArray[np.bool_],
    hidden: float,
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Find the vertices a view shows, and the colour difference of the photo there (largest channel); [N] both."""
    around = np.ones((3, 3), np.uint8)  # vertices on a rim lie half beside it
    x, y = at[framed, :2].astype(np.int64).T
    near = cv2.dilate(depth, around)[y, x] * (1 + hidden) * at[framed, 2] >= 1
    visible, off = np.zeros(len(at), bool), np.zeros(len(at), np.float32)
    visible[framed] = near & (cv2.dilate(inside.astype(np.uint8), around)[y, x] > 0)
    off[framed] = np.abs(sample_pixels(photo, at[framed, :2]).astype(np.float32) - mesh.colors[framed]).max(1)
    return visible, off


def _at_rim(depth: NDArray[np.float32], inside: NDArray[np.bool_], options: VisibilityOptions) -> NDArray[np.bool_]:
    """Find the pixels near one beside the building or near a nearer part of it, [H, W].

    Surface and masks are a pixel or two off, so that leaves, sky or another wall may be painted there.
    """
    hides = cv2.erode(np.where(depth > 0, depth, np.float32(1e30)), np.ones((3, 3), np.uint8))
    clear = inside & (depth > 0) & (depth < hides * (1 + 3 * options.hidden))
    return np.asarray(cv2.distanceTransform(clear.astype(np.uint8), cv2.DIST_L2, 3) < options.rim)


def _area(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the area of triangles [N, 3, 2] in pixels; positive where their front is seen (rows run downwards)."""
    a, b, c = at[:, 0], at[:, 1], at[:, 2]
    return -0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))


def _facing(mesh: Mesh, normals: NDArray[np.float64], face: NDArray[np.int64], view: View) -> NDArray[np.float64]:
    """Compute the cosine between the outward normals of faces and the way to the camera."""
    toward = view.centre - mesh.vertices[mesh.faces[face, 0]]
    cosine: NDArray[np.float64] = (normals[face] * toward).sum(1) / np.linalg.norm(toward, axis=1)
    return cosine
