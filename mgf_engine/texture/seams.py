# SPDX-License-Identifier: GPL-3.0-or-later
"""Seams between photos made invisible: a smooth correction of each photo's colours, so that both sides agree.

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
from mgf_engine.mesh.colors import sample
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.texture.model import NO_VIEW, painting_views

STIFF = 0.2  # weight of the differences along edges, against one on seams
CALM = 0.02  # weight of the correction itself
USUAL = 15.0  # grey levels of difference at a seam that are nothing unusual
SPACING, MOST = 2.0, 9  # px between samples along a seam, and how many an edge has
CREASE = 0.1  # cosine between faces from which a seam is an edge of the building, where colours may change
BLUR = 1.0  # px (standard deviation) before colours are compared

Array = NDArray[np.float64]
Photo = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True)
class Corrections:
    """What is added to the colours of the photos.

    Attributes:
        of_corner: int64 [F, 3], row of ``value`` for each corner of a face.
        value: float32 [M, 3], grey levels.
    """

    of_corner: NDArray[np.int64]
    value: NDArray[np.float32]


def level_seams(
    mesh: Mesh, label: NDArray[np.int32], neighbours: NDArray[np.int64], views: Sequence[View], photo: Photo
) -> Corrections:
    """Corrections for the faces painted as ``label`` [F] says.

    Args:
        neighbours: pairs of faces that share an edge, [E, 2].
        photo: position in ``views`` -> working photo.
    """
    key = (label[:, None].astype(np.int64) + 1) * len(mesh.vertices) + mesh.faces
    node, of_corner = np.unique(key, return_inverse=True)
    of_corner = of_corner.reshape(-1, 3)
    sides = neighbours[label[neighbours[:, 0]] != label[neighbours[:, 1]]]
    ends = _shared_edges(mesh.faces, sides)
    samples = _samples(mesh, ends, label[sides], views)
    difference = _differences(mesh, ends, samples, label[sides], views, photo)
    weight = samples * _flat(mesh, sides) / (1.0 + (np.abs(difference).max(1, initial=0) / USUAL) ** 2)
    first, second = (np.searchsorted(node, (label[sides[:, [k]]] + 1) * len(mesh.vertices) + ends) for k in (0, 1))
    seams = np.stack([first.T.ravel(), second.T.ravel()], 1)  # at one end of each edge, then at the other
    pull = np.tile(weight[:, None] * difference, (2, 1))
    right = np.zeros((len(node), 3))
    np.add.at(right, seams[:, 0], -pull)
    np.add.at(right, seams[:, 1], pull)
    edges = np.concatenate([of_corner[:, [0, 1]], of_corner[:, [1, 2]], of_corner[:, [2, 0]]])
    along = _laplacian(edges, np.full(len(edges), STIFF / 2), len(node))
    bare = node // len(mesh.vertices) - 1 == NO_VIEW  # painted with the colours of the vertices: stays as it is
    matrix = _laplacian(seams, np.tile(weight, 2), len(node)) + along + sparse.diags(np.where(bare, 1e3, CALM))
    return Corrections(of_corner, _solve(matrix.tocsr(), right))


def _shared_edges(faces: NDArray[np.int32], pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """The two vertices that the faces of each pair share, [K, 2]."""
    first, second = faces[pairs[:, 0]], faces[pairs[:, 1]]
    shared = (first[:, :, None] == second[:, None]).any(2)
    shared &= np.cumsum(shared, axis=1) <= 2  # faces with the same three vertices share all
    return first[shared].reshape(-1, 2).astype(np.int64)


def _flat(mesh: Mesh, pairs: NDArray[np.int64]) -> Array:
    """1 where the faces of a pair lie in one plane, 0 from :data:`CREASE` on, [K]."""
    normals = face_normals(mesh)
    bend = (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(1)
    return np.clip((bend - CREASE) / (1 - CREASE), 0, 1)


def _samples(mesh: Mesh, ends: NDArray[np.int64], label: NDArray[np.int32], views: Sequence[View]) -> NDArray[np.int64]:
    """Return the number of samples of each seam, [K], by its length in the photos.

    Args:
        ends: vertices at the ends of the seams, [K, 2]; label: the views on both sides, [K, 2].
    """
    length = np.ones(len(ends))
    for index in painting_views(label):
        rows = np.flatnonzero((label == index).any(1))
        low, high = (corners(mesh.vertices[ends[rows, k]], views[index])[:, :2] for k in range(2))
        length[rows] = np.maximum(length[rows], np.linalg.norm(high - low, axis=1) / SPACING)
    return np.minimum(np.ceil(length), MOST).astype(np.int64)


def _differences(
    mesh: Mesh,
    ends: NDArray[np.int64],
    samples: NDArray[np.int64],
    label: NDArray[np.int32],
    views: Sequence[View],
    photo: Photo,
) -> Array:
    """Mean colour along each seam on its first side less that on its second, [K, 3]; arguments as above."""
    seam = np.repeat(np.arange(len(ends)), samples)
    rank = np.arange(len(seam)) - np.repeat(np.cumsum(samples) - samples, samples)
    share = ((rank + 0.5) / samples[seam])[:, None]

    def along(values: NDArray[Any]) -> Array:
        return np.asarray(values[ends[seam, 0]] * (1 - share) + values[ends[seam, 1]] * share)

    points, plain = along(mesh.vertices), along(mesh.colors)
    sides = np.stack([plain, plain], 1)
    for index in painting_views(label):
        rows, side = np.nonzero(label[seam] == index)
        sides[rows, side] = _colors(points[rows], views[index], photo(index))
    off = sides[:, 0] - sides[:, 1]
    return np.stack([np.bincount(seam, off[:, k], len(ends)) for k in range(3)], 1) / samples[:, None]


def _colors(points: Array, view: View, photo: NDArray[np.uint8]) -> Array:
    calm = np.asarray(cv2.GaussianBlur(photo, (0, 0), BLUR), np.uint8)
    return sample(calm, corners(points, view)[:, :2]).astype(np.float64)


def _laplacian(pairs: NDArray[np.int64], weight: Array, count: int) -> sparse.csr_matrix:
    """Of the quadratic form sum w (x_i - x_j)^2."""
    i, j = pairs.T
    off = sparse.coo_matrix((weight, (i, j)), (count, count))
    off = (off + off.T).tocsr()
    return (sparse.diags(np.asarray(off.sum(1)).ravel()) - off).tocsr()


def _solve(matrix: sparse.csr_matrix, right: Array) -> NDArray[np.float32]:
    inverse = sparse.diags(1.0 / matrix.diagonal())
    columns = [cg(matrix, right[:, k], rtol=1e-3, maxiter=500, M=inverse)[0] for k in range(3)]
    return np.stack(columns, 1).astype(np.float32)
