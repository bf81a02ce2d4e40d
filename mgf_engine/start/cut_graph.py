# SPDX-License-Identifier: GPL-3.0-or-later
"""The graph of the minimum cut: nodes are tetrahedra, edges their common faces, with a capacity per direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.mesh import Mesh
from mgf_engine.native.library import call
from mgf_engine.start.evidence import Evidence
from mgf_engine.start.options import MinimumCutOptions
from mgf_engine.start.tetrahedra import FACE_CORNERS, Tetrahedra

ONE = 1024.0  # what the kernels count as 1: their sums are whole numbers

Array = NDArray[np.float64]


class CutGraph:
    """The graph of the minimum cut: tetrahedra as nodes, their common faces as edges with a capacity per direction.

    Faces are enumerated in chunks on demand: a list of all of them takes as much memory as the tetrahedra.
    """

    def __init__(
        self,
        tetrahedra: Tetrahedra,
        rays: NDArray[np.int32],
        evidence: Evidence,
        pixel: float,
        options: MinimumCutOptions,
    ) -> None:
        self.tetrahedra, self.strength = tetrahedra, StrongestPlane(evidence, len(tetrahedra.points))
        self.flow = Flow(tetrahedra.neighbours)
        for chunk in tetrahedra.chunks():
            cell, k, other = _pairs(tetrahedra, chunk)
            back = np.argmax(tetrahedra.neighbours[other] == cell[:, None], 1)
            faces = _corners_of(tetrahedra, cell, k)
            with np.errstate(divide="ignore"):
                factor = np.minimum(1.0, options.flat / self.strength(faces) ** options.slope)
            cost = options.area * (_areas(tetrahedra.points, faces) / pixel**2) * factor
            self.flow.residual[cell, k] = rays[cell, k] / ONE + cost
            self.flow.residual[other, back] = rays[other, back] / ONE + cost

    def surface(self, inside: NDArray[np.bool_]) -> tuple[Mesh, NDArray[np.float32]]:
        """Extract the faces between inside and outside, oriented outward, and the strength of their planes, [F]."""
        found = []
        for chunk in self.tetrahedra.chunks():
            cell, k, other = _pairs(self.tetrahedra, chunk)
            cut = inside[cell] != inside[other]
            faces = _corners_of(self.tetrahedra, cell[cut], k[cut])
            turned = inside[other[cut]]
            faces[turned] = faces[turned][:, ::-1]
            found.append(faces)
        faces = np.concatenate(found)
        kept, index = np.unique(faces, return_inverse=True)
        colors = np.zeros((len(kept), 3), np.uint8)
        mesh = Mesh(self.tetrahedra.points[kept], index.reshape(-1, 3).astype(np.int32), colors)
        return mesh, self.strength(faces).astype(np.float32)


class Flow:
    """Maximum flow through cells from the source (outside) to the sink (inside), and its residual graph.

    Attributes:
        neighbours: the cells beyond each of four faces, each cell once at most, -1 for none, int32 [N, 4].
        residual: residual capacity to each neighbour, [N, 4].
        excess: residual capacity from the source; negative: to the sink, [N].
        value: of the flow so far.
    """

    def __init__(self, neighbours: NDArray[np.int32]) -> None:
        self.neighbours, self.residual = neighbours, np.zeros(neighbours.shape)
        self.excess, self.value = np.zeros(len(neighbours)), 0.0

    def add(self, source: Array, sink: Array) -> None:
        """Add capacities [N] from the source (outside) and to the sink (inside)."""
        source, sink = source + np.maximum(self.excess, 0), sink + np.maximum(-self.excess, 0)
        self.value += float(np.minimum(source, sink).sum())
        self.excess = source - sink

    def cut(self) -> NDArray[np.bool_]:
        """Find the inside cells by the minimum cut, bool [N] (kernel ``mgf_cut_tetrahedra``).

        Cells from which the sink can be reached in the residual graph are inside. The flow of an earlier cut stays
        valid, so that a second one only augments it.
        """
        count, added = len(self.excess), np.zeros(1)
        inside, parent = np.empty(count, np.uint8), np.empty(count, np.int8)
        work = np.empty((4, count), np.int32)
        call(
            "mgf_cut_tetrahedra", count, self.neighbours, self.residual, self.excess, inside, added, parent, *work
        )  # fmt: skip
        self.value += float(added[0])
        return inside.astype(bool)


class StrongestPlane:
    """Finds the strength of the strongest plane that faces lie on.

    Args:
        evidence: planes of the first points, and their strength.
        points: number of points, those of the box around the evidence included.
    """

    def __init__(self, evidence: Evidence, points: int) -> None:
        order = np.argsort(-evidence.strength, kind="stable")
        self.by_rank = np.r_[evidence.strength[order], 0.0]
        on = np.packbits(evidence.on_planes[:, order], axis=1)
        self.on = np.pad(on, ((0, points - len(on)), (0, 0)))

    def __call__(self, faces: NDArray[np.int32]) -> Array:
        """Find the strength of the strongest plane that all three corners of faces [F, 3] lie on, 0 for none, [F]."""
        if len(self.by_rank) == 1:
            return np.zeros(len(faces))
        common = self.on[faces[:, 0]] & self.on[faces[:, 1]] & self.on[faces[:, 2]]
        rows = np.flatnonzero(common.any(1))
        byte = (common[rows] != 0).argmax(1)
        rank = np.full(len(faces), len(self.by_rank) - 1)
        rank[rows] = 8 * byte + np.unpackbits(common[rows, byte][:, None], axis=1).argmax(1)
        return self.by_rank[rank]


def _pairs(tetrahedra: Tetrahedra, chunk: slice) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """List the faces from the tetrahedra of a chunk to those with higher numbers.

    Returns:
        Number of the tetrahedron, its corner opposite of the face, and number of the other one, [F] each.
    """
    neighbours = tetrahedra.neighbours[chunk]
    cell, k = np.nonzero(neighbours > np.arange(chunk.start, chunk.stop)[:, None])
    return cell + chunk.start, k, neighbours[cell, k]


def _corners_of(tetrahedra: Tetrahedra, cell: NDArray[np.int64], k: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the corners of faces by their tetrahedra and the corners opposite of them, outward, [F, 3]."""
    return np.take_along_axis(tetrahedra.corners[cell], FACE_CORNERS[k], 1)


def _areas(points: Array, faces: NDArray[np.int32]) -> Array:
    """Compute the areas of faces [F, 3], [F]."""
    a, b, c = (points[faces[:, n]] for n in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
