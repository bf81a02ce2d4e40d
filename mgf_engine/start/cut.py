# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface between inside and outside tetrahedra, by a visibility-weighted s-t cut (after Labatut et al. 2007).

Rays from points to the views that saw them are free, what lies behind a point is inside, whatever projects outside of
the masks is outside, the rest of the visual hull is weakly inside. Faces cost their area, so that what nothing speaks
about is spanned by few large ones, and less where they lie on a plane that carries lines. Mask pixels that the surface
leaves uncovered then pull what lies on their rays inside, and the cut is made again.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry.delaunay import begun
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.masks import building
from mgf_engine.model.mesh import Mesh
from mgf_engine.native.library import parallel
from mgf_engine.start.options import CutOptions
from mgf_engine.start.segments import pixel_rays
from mgf_engine.start.views import StartViews

with contextlib.suppress(ModuleNotFoundError):  # no wheel for Linux on ARM
    import maxflow

log = logging.getLogger("mgf")
#: Corners of the face opposite of each corner, outward: the tetrahedra have positive volume.
_CORNERS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
_ONE = 1024.0  # the kernels' sums are whole numbers
_SURE = 1e9  # capacity that nothing exceeds
_PAD = 0.5  # of the points' box, to the outermost points
_SAMPLES = np.array([[0.25] * 4, *(np.eye(4) * 0.6 + 0.1)])  # places in a tetrahedron that are compared with the masks
_BLOCK = 1 << 17  # tetrahedra whose faces are looked at together, which bounds the memory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """Points [N, 3] the surface may pass.

    Attributes:
        seen: positions of the views that saw each; none for points that only shape the tetrahedra.
        weight: of each point's rays, [N].
        planes: uint64 [N], bit k is set for points on plane k.
        strength: 0..1 of each plane, [K].
    """

    points: Array
    seen: Sequence[NDArray[np.int64]]
    weight: Array
    planes: NDArray[np.uint64]
    strength: Array


@dataclass(frozen=True)
class Tetrahedra:
    """Delaunay tetrahedra [T, 4] of points [N, 3], positive volume, and what the kernels ask of them."""

    points: Array
    corners: NDArray[np.int32]

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """[T, 4], opposite of each corner, -1 at the rim."""
        return face_neighbours(self.corners, len(self.points))

    @cached_property
    def planes(self) -> Array:
        """Outward unit normals and offsets of the faces, [T, 4, 4]."""
        result = np.empty((len(self.corners), 4, 4))
        for k, corners in enumerate(_CORNERS):
            a, b, c = (self.points[self.corners[:, n]] for n in corners)
            n = np.cross(b - a, c - a)
            n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
            result[:, k, :3], result[:, k, 3] = n, -(n * a).sum(1)
        return result

    @cached_property
    def volumes(self) -> Array:
        """[T]."""
        a, b, c, d = (self.points[self.corners[:, k]] for k in range(4))
        return np.asarray(np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)) / 6)

    @cached_property
    def table(self) -> Any:
        """As ``native/csrc/mesh/tetra_rays.c`` takes them (struct Tetrahedra); holds on to its arrays."""
        flat = self.corners.ravel()
        order = np.argsort(flat, kind="stable")
        around = np.searchsorted(flat[order], np.arange(len(self.points) + 1)).astype(np.int64)
        arrays = self.corners, self.neighbours, self.planes, self.points, around, (order // 4).astype(np.int32)
        names = ("corner", "neighbour", "plane", "points", "around", "list")
        kinds = [*((name, ctypes.c_void_p) for name in names), ("count", ctypes.c_int64)]
        table = type("TetraTable", (ctypes.Structure,), {"_fields_": kinds})(
            *(a.ctypes.data for a in arrays), len(self.corners)
        )
        table.arrays = arrays
        return table

    @property
    def reference(self) -> ctypes.c_void_p:
        """The table's address."""
        return ctypes.c_void_p(ctypes.addressof(self.table))


def face_neighbours(corners: NDArray[np.int32], points: int) -> NDArray[np.int32]:
    """Of each face (opposite of each corner) of tetrahedra [T, 4] the tetrahedron beyond it, -1 for none, [T, 4]."""
    faces = np.sort(corners[:, _CORNERS].reshape(-1, 3).astype(np.int64), axis=1)
    key = (faces[:, 0] * points + faces[:, 1]) * points + faces[:, 2]
    if points**3 >= 2**63:
        key = np.unique(faces, axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    result = np.full(len(key), -1, np.int32)
    first, second = order[twin], order[twin + 1]
    result[first], result[second] = second // 4, first // 4
    return result.reshape(-1, 4)


def cut_surface(
    views: StartViews, evidence: Evidence, o: CutOptions, check: Callable[[], None]
) -> tuple[Mesh, NDArray[np.uint64]]:
    """The closed surface that the evidence speaks for, and of each face the planes it lies on (bits, uint64 [F]).

    Raises:
        BadInput: PyMaxflow is not installed.
        Cancelled: the user asked to stop.
    """
    if "maxflow" not in globals():
        raise BadInput("PyMaxflow is not installed; run 'pip install PyMaxflow', or choose the start 'dense'.")
    low, high = evidence.points.min(0), evidence.points.max(0)
    points = np.concatenate([evidence.points, _box(low, high)])
    with begun(points) as made:
        shape = Tetrahedra(points, _positive(points, made(check)))
    outside = _outside_share(views, shape, o)
    shut = (outside > o.outside_share) | (shape.corners >= len(evidence.points)).any(1)
    free, solid, face = _rays(views, shape, evidence, o)
    check()
    sink = solid / _ONE + o.volume * shape.volumes / views.pixel**3 * (1 - outside)
    source = np.where(shut, _SURE, free / _ONE)
    graph = _Graph(shape, face / _ONE, evidence, views.pixel, o)
    first, _ = graph.surface(graph.cut(source, sink))
    check()
    at, direction = _uncovered(views, first)
    begin = _entry(at, direction, low, high)
    hit = np.isfinite(begin)
    at = np.ascontiguousarray(at[hit] + begin[hit, None] * direction[hit])
    direction = np.ascontiguousarray(direction[hit])
    pulled = np.zeros(len(sink), np.int32)
    parallel(
        "mgf_pull_rays", len(at), shape.reference, at, direction, shut.astype(np.uint8), float(o.cover),
        float(o.short * views.pixel), pulled,
    )  # fmt: skip
    inside = graph.cut(np.zeros(len(sink)), pulled / _ONE)
    log.info(
        "start: %d points, %d tetrahedra, %d inside, %d mask pixels uncovered at first",
        len(points), len(sink), inside.sum(), len(at),
    )  # fmt: skip
    return graph.surface(inside)


def _box(low: Array, high: Array) -> Array:
    """26 points around a box, far enough away to be outside."""
    pad = _PAD * float((high - low).max())
    sides = np.stack([low - pad, (low + high) / 2, high + pad], 1)
    return np.delete(np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 3), 13, 0)


def _positive(points: Array, corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """The tetrahedra, all turned so that volumes are positive. Of flat ones rounding decides the sign, so each alone
    cannot be asked: all are turned alike already."""
    a, b, c, d = (points[corners[:, k]] for k in range(4))
    total = np.einsum("ij,ij->", np.cross(b - a, c - a), d - a)
    return np.ascontiguousarray(corners if total > 0 else corners[:, [0, 1, 3, 2]])


def _outside_share(views: StartViews, shape: Tetrahedra, o: CutOptions) -> Array:
    """Share of each tetrahedron outside of the visual hull, [T]."""
    share = np.zeros(len(shape.corners))
    for begin in range(0, len(share), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        corners = shape.points[shape.corners[block]]
        for row in _SAMPLES:
            outside = views.outside_views(row @ corners, o.margin, o.outside_views)
            share[block] += outside >= o.outside_views
    return share / len(_SAMPLES)


def _rays(
    views: StartViews, shape: Tetrahedra, evidence: Evidence, o: CutOptions
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Cast the points' rays: free [T], solid [T] and face [T, 4], as ``mgf_cast_rays`` sums them."""
    point = np.repeat(np.arange(len(evidence.points), dtype=np.int32), [len(s) for s in evidence.seen])
    view = np.concatenate([np.zeros(0, np.int64), *evidence.seen]).astype(np.int32)
    weight = evidence.weight[point].astype(np.float32)
    behind = (o.behind * weight * _well_inside(views, evidence.points[point], view, o.well_inside)).astype(np.float32)
    free, solid = np.zeros(len(shape.corners), np.int32), np.zeros(len(shape.corners), np.int32)
    face = np.zeros((len(shape.corners), 4), np.int32)
    parallel(
        "mgf_cast_rays", len(point), shape.reference, point, view, views.centres, weight, behind,
        float(o.soft * views.pixel), float(o.depth * views.pixel), free, solid, face,
    )  # fmt: skip
    return free, solid, face


def _well_inside(views: StartViews, points: Array, number: NDArray[np.int32], margin: float) -> NDArray[np.bool_]:
    """Points [R, 3] more than ``margin`` px inside of the mask of their view [R]: others may only be grazed."""
    result = np.zeros(len(points), bool)
    for n, view in enumerate(views.views):
        rows = np.flatnonzero(number == n)
        into = cv2.distanceTransform(building(views.labels[n]).astype(np.uint8), cv2.DIST_L2, 5)
        uv = np.floor(view.project(points[rows])[0])
        column, row = np.clip(uv, 0, [view.width - 1, view.height - 1]).astype(int).T
        result[rows] = into[row, column] > margin
    return result


class _Graph:
    """The faces between tetrahedra with what they cost in either direction."""

    def __init__(self, shape: Tetrahedra, rays: Array, evidence: Evidence, pixel: float, o: CutOptions) -> None:
        self.points = shape.points
        blocks = [_faces_between(shape, rays, begin) for begin in range(0, len(shape.corners), _BLOCK)]
        self.cell, self.other, self.faces, area, there, back = map(np.concatenate, zip(*blocks, strict=True))
        faces, area = self.faces, area / pixel**2
        bits = np.r_[evidence.planes, np.zeros(len(self.points) - len(evidence.planes), np.uint64)]
        self.bits = bits[faces[:, 0]] & bits[faces[:, 1]] & bits[faces[:, 2]]
        factor = np.ones(len(faces))
        for n, strength in enumerate(evidence.strength):
            on = (self.bits >> np.uint64(n)) & np.uint64(1) == 1
            factor[on] = np.minimum(factor[on], min(1.0, o.flat / strength**o.slope))
        cost = o.area * area * factor
        self.graph = maxflow.Graph[float](len(shape.corners), len(self.cell))
        self.graph.add_nodes(len(shape.corners))
        self.graph.add_edges(self.cell, self.other, there + cost, back + cost)

    def cut(self, source: Array, sink: Array) -> NDArray[np.bool_]:
        """Add capacities [T] from outside and to inside, and find the inside tetrahedra by the minimum cut, bool [T].

        The flow of an earlier cut stays valid, so that a second one only adds what the added capacities let through.
        """
        every = np.arange(len(source))
        self.graph.add_grid_tedges(every, source, sink)
        self.graph.maxflow()
        return np.asarray(self.graph.get_grid_segments(every))

    def surface(self, inside: NDArray[np.bool_]) -> tuple[Mesh, NDArray[np.uint64]]:
        """The faces between inside and outside, outward."""
        cut = inside[self.cell] != inside[self.other]
        faces = self.faces[cut]
        turned = inside[self.other[cut]]
        faces[turned] = faces[turned][:, ::-1]
        kept, index = np.unique(faces, return_inverse=True)
        colors = np.zeros((len(kept), 3), np.uint8)
        return Mesh(self.points[kept], index.reshape(-1, 3).astype(np.int32), colors), self.bits[cut]


def _faces_between(shape: Tetrahedra, rays: Array, begin: int) -> tuple[NDArray[Any], ...]:
    """Faces from ``_BLOCK`` tetrahedra to those with higher numbers.

    Returns:
        Numbers of both tetrahedra [F], corners [F, 3], area [F], and what rays say against either direction, [F] each.
    """
    neighbours = shape.neighbours[begin : begin + _BLOCK]
    cell, k = np.nonzero(neighbours > np.arange(begin, begin + len(neighbours))[:, None])
    other, cell = neighbours[cell, k], cell + begin
    back = np.argmax(shape.neighbours[other] == cell[:, None], 1)
    faces = np.take_along_axis(shape.corners[cell], _CORNERS[k], 1)
    a, b, c = (shape.points[faces[:, n]] for n in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return cell.astype(np.int32), other, faces.astype(np.int32), area, rays[cell, k], rays[other, back]


def _uncovered(views: StartViews, mesh: Mesh) -> tuple[Array, Array]:
    """Camera centres and directions [M, 3] of mask pixels that the surface does not cover."""
    centres, rays = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for n, view in enumerate(views.views):
        wanted = cv2.erode(building(views.labels[n]).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        row, column = np.nonzero(wanted & (render_mesh(mesh, view).face < 0))
        found = pixel_rays(views, np.full(len(row), n), np.c_[column + 0.5, row + 0.5])
        rays.append(found)
        centres.append(np.broadcast_to(views.centres[n], found.shape))
    return np.concatenate(centres), np.concatenate(rays)


def _entry(at: Array, direction: Array, low: Array, high: Array) -> Array:
    """Distance at which rays enter a box a little larger than low..high, inf where they miss it, [M]."""
    pad = 0.1 * _PAD * float((high - low).max())
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - pad - at) / direction, (high + pad - at) / direction
    near, far = np.minimum(first, second).max(1), np.maximum(first, second).min(1)
    return np.where(far > np.maximum(near, 0), np.maximum(near, 0) + 1e-6, np.inf)
