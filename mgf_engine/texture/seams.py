# SPDX-License-Identifier: GPL-3.0-or-later
"""Seam levelling: a smooth colour correction of each photo, so that both sides of a seam agree.

The correction g at the vertices of each photo's patches minimises the differences left across seams and the
differences of g along edges (Waechter, Moehrle, Goesele: Let There Be Color!, ECCV 2014, section 3.3), here with
Cauchy's weights on the seams, so that a seam through a misplaced edge is not smeared over the wall beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import cg

from mgf_engine.geometry.rasterize import corners, face_normals
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.pixels import sample_pixels
from mgf_engine.model.scene import View
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.model import NO_VIEW, painting_views

Array = NDArray[np.float64]
Photo = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True)
class Corrections:
    """Corrections that are added to the colours of the photos.

    Attributes:
        of_corner: int64 [F, 3], row of ``value`` for each corner of a face.
        value: float32 [M, 3], grey levels.
    """

    of_corner: NDArray[np.int64]
    value: NDArray[np.float32]


@dataclass(frozen=True)
class SeamOptions:
    """Options of seam levelling."""

    stiffness: float = parameter(0.2, "Weight of differences of the correction along edges; one on a seam weighs 1")
    damping: float = parameter(0.02, "Weight of the correction itself", low=1e-9)
    usual: float = parameter(15.0, "Difference of colours at a seam that is usual", "grey levels", low=1e-3)
    spacing: float = parameter(2.0, "Distance between samples along a seam", "px", low=0.1)
    most_samples: int = parameter(9, "Maximum number of samples of an edge", low=1)
    crease: float = parameter(
        0.1,
        "Cosine between two faces from which a seam is an edge of the building, where colours may change",
        high=0.999,
    )
    blur: float = parameter(1.0, "Blur (standard deviation) before colours are compared", "px", low=0.01)


def level_seams(
    mesh: Mesh,
    label: NDArray[np.int32],
    neighbours: NDArray[np.int64],
    views: Sequence[View],
    photo: Photo,
    options: SeamOptions = SeamOptions(),
) -> Corrections:
    """Compute the colour corrections at the vertices of each photo's patches.

    Args:
        mesh: normalised frame.
        label: view that paints each face, int32 [F].
        neighbours: pairs of faces that share an edge, [E, 2].
        views: cameras of the photos.
        photo: position in ``views`` -> working photo.
        options: weights of the levelling.
    """
    key = (label[:, None].astype(np.int64) + 1) * len(mesh.vertices) + mesh.faces
    node, of_corner = np.unique(key, return_inverse=True)
    of_corner = of_corner.reshape(-1, 3)
    sides = neighbours[label[neighbours[:, 0]] != label[neighbours[:, 1]]]
    ends = shared_edges(mesh.faces, sides)
    samples = _samples(mesh, ends, label[sides], views, options)
    difference = _differences(mesh, ends, samples, label[sides], views, photo, options)
    weight = samples * _flat(mesh, sides, options) / (1.0 + (np.abs(difference).max(1, initial=0) / options.usual) ** 2)
    first, second = (np.searchsorted(node, (label[sides[:, [k]]] + 1) * len(mesh.vertices) + ends) for k in (0, 1))
    seams = np.stack([first.T.ravel(), second.T.ravel()], 1)  # at one end of each edge, then at the other
    pull = np.tile(weight[:, None] * difference, (2, 1))
    right = np.zeros((len(node), 3))
    np.add.at(right, seams[:, 0], -pull)
    np.add.at(right, seams[:, 1], pull)
    edges = np.concatenate([of_corner[:, [0, 1]], of_corner[:, [1, 2]], of_corner[:, [2, 0]]])
    along = _laplacian(edges, np.full(len(edges), options.stiffness / 2), len(node))
    bare = node // len(mesh.vertices) - 1 == NO_VIEW  # painted with the colours of the vertices: stays as it is
    matrix = (
        _laplacian(seams, np.tile(weight, 2), len(node)) + along + sparse.diags(np.where(bare, 1e3, options.damping))
    )
    return Corrections(of_corner, _solve(matrix.tocsr(), right))


def shared_edges(faces: NDArray[np.int32], pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the two vertices that the faces of each pair share, [K, 2]."""
    first, second = faces[pairs[:, 0]], faces[pairs[:, 1]]
    shared = (first[:, :, None] == second[:, None]).any(2)
    shared &= np.cumsum(shared, axis=1) <= 2  # faces with the same three vertices share all
    return first[shared].reshape(-1, 2).astype(np.int64)


def _flat(mesh: Mesh, pairs: NDArray[np.int64], options: SeamOptions) -> Array:
    """Return 1 where the faces of a pair lie in one plane, 0 from ``crease`` of the options on, [K]."""
    normals = face_normals(mesh)
    bend = (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(1)
    return np.clip((bend - options.crease) / (1 - options.crease), 0, 1)


def _samples(
    mesh: Mesh, ends: NDArray[np.int64], label: NDArray[np.int32], views: Sequence[View], options: SeamOptions
) -> NDArray[np.int64]:
    """Return the number of samples of each seam, [K], by its length in the photos.

    Args:
        ends: vertices at the ends of the seams, [K, 2]; label: the views on both sides, [K, 2].
    """
    length = np.ones(len(ends))
    for index in painting_views(label):
        rows = np.flatnonzero((label == index).any(1))
        low, high = (corners(mesh.vertices[ends[rows, k]], views[index])[:, :2] for k in range(2))
        length[rows] = np.maximum(length[rows], np.linalg.norm(high - low, axis=1) / options.spacing)
    return np.minimum(np.ceil(length), options.most_samples).astype(np.int64)


def _differences(
    mesh: Mesh,
    ends: NDArray[np.int64],
    samples: NDArray[np.int64],
    label: NDArray[np.int32],
    views: Sequence[View],
    photo: Photo,
    options: SeamOptions,
) -> Array:
    """Return the mean colour along each seam on its first side less that on its second, [K, 3]; arguments as above."""
    seam = np.repeat(np.arange(len(ends)), samples)
    rank = np.arange(len(seam)) - np.repeat(np.cumsum(samples) - samples, samples)
    share = ((rank + 0.5) / samples[seam])[:, None]

    def along(values: NDArray[Any]) -> Array:
        return np.asarray(values[ends[seam, 0]] * (1 - share) + values[ends[seam, 1]] * share)

    points, plain = along(mesh.vertices), along(mesh.colors)
    sides = np.stack([plain, plain], 1)
    for index in painting_views(label):
        rows, side = np.nonzero(label[seam] == index)
        sides[rows, side] = _colors(points[rows], views[index], photo(index), options)
    off = sides[:, 0] - sides[:, 1]
    return np.stack([np.bincount(seam, off[:, k], len(ends)) for k in range(3)], 1) / samples[:, None]


def _colors(points: Array, view: View, photo: NDArray[np.uint8], options: SeamOptions) -> Array:
    """Return the colours of a photo at points [n, 3] (normalised frame), after a blur, [n, 3]."""
    blurred = np.asarray(cv2.GaussianBlur(photo, (0, 0), options.blur), np.uint8)
    return sample_pixels(blurred, corners(points, view)[:, :2]).astype(np.float64)


def _laplacian(pairs: NDArray[np.int64], weight: Array, count: int) -> sparse.csr_matrix:
    """Return the matrix of the quadratic form sum w (x_i - x_j)^2."""
    i, j = pairs.T
    off = sparse.coo_matrix((weight, (i, j)), (count, count))
    off = (off + off.T).tocsr()
    return (sparse.diags(np.asarray(off.sum(1)).ravel()) - off).tocsr()


def _solve(matrix: sparse.csr_matrix, right: Array) -> NDArray[np.float32]:
    inverse = sparse.diags(1.0 / matrix.diagonal())
    columns = [cg(matrix, right[:, k], rtol=1e-3, maxiter=500, M=inverse)[0] for k in range(3)]
    return np.stack(columns, 1).astype(np.float32)
