# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect the planes of a mesh by region growing from faces with similar normals, with a robust fit.

A wall that is bowed by less than the error of stereo comes out as several planes, which are merged. The noise of each
plane is estimated from the mesh. Curved surfaces are rejected: those where a paraboloid, or the means
over larger cells, deviate from the plane by more than the low-frequency error of stereo depths.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.geometry.clean import face_areas, face_neighbours
from mgf_engine.geometry.components import label_components
from mgf_engine.geometry.divide import divide_long_edges
from mgf_engine.geometry.morton import arrange, cells_of, morton
from mgf_engine.geometry.normals import unit_vectors
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.model.mesh import Mesh

#: Cutoff of pseudo-inverses of the normals of several planes, as a share of the largest singular value: planes that are
#: nearly parallel meet in no line that can be trusted.
PARALLEL = 0.15


@dataclass(frozen=True)
class Planes:
    """Planes and the faces in them.

    Attributes:
        normals: unit, outward, [P, 3].
        offsets: ``normals @ x = offsets`` in the mesh's units, [P].
        noise: standard deviation of the vertices of these faces, in ground pixels, [P].
        area: of these faces, in square ground pixels, [P].
        label: the plane of each face, -1 for none, int32 [F].
    """

    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    noise: NDArray[np.float64]
    area: NDArray[np.float64]
    label: NDArray[np.int32]

    def distances(self, points: NDArray[np.float64], plane: NDArray[np.integer]) -> NDArray[np.float64]:
        """Compute signed distances of points [K, 3] from the planes with these numbers [K], in the mesh's units."""
        return np.asarray(np.einsum("ij,ij->i", points, self.normals[plane]) - self.offsets[plane])


@dataclass(frozen=True)
class MeshFaces:
    """Faces of a mesh as region growing needs them.

    Attributes:
        centre: in the mesh's units, [F, 3].
        normal: unit, from smoothed vertex normals, [F, 3].
        pixel: size of a ground pixel in the mesh's units, [F].
        area: in square ground pixels, [F].
        pairs: faces that share an edge, [2, E].
    """

    mesh: Mesh
    centre: NDArray[np.float64]
    normal: NDArray[np.float64]
    pixel: NDArray[np.float64]
    area: NDArray[np.float64]
    pairs: NDArray[np.int64]

    def distances(self, plane: Plane, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        """Compute signed distances of the centres of faces [K] from a plane, ground pixels [K]."""
        return np.asarray((self.centre[rows] @ plane.normal - plane.offset) / self.pixel[rows])


class Plane(NamedTuple):
    """The points with ``normal @ x = offset``; the normal is a unit vector [3]."""

    normal: NDArray[np.float64]
    offset: float

    def facing(self, direction: NDArray[np.float64]) -> Plane:
        """Return the plane with its normal to the side that a direction [3] points to."""
        return self if direction @ self.normal > 0 else Plane(-self.normal, -self.offset)


def measure_faces(mesh: Mesh, pixel: NDArray[np.float64], options: PlanarOptions) -> MeshFaces:
    """Measure centres, smoothed normals, sizes of a ground pixel, areas and neighbours of faces."""
    at = np.ascontiguousarray(mesh.vertices)
    normal = unit_vectors(mesh.adjacency.vertex_normals(at))
    for _ in range(options.normal_rounds):
        normal = mesh.adjacency.smooth(normal, np.zeros(len(at), bool))
    pairs = np.ascontiguousarray(face_neighbours(mesh.faces).T)
    size = pixel[mesh.faces].mean(1)
    area = face_areas(mesh) / size**2
    return MeshFaces(mesh, at[mesh.faces].mean(1), unit_vectors(normal[mesh.faces].sum(1)), size, area, pairs)


def planes_of(mesh: Mesh, pixel: float, options: PlanarOptions = PlanarOptions()) -> Planes:
    """Find the planes of a finished mesh; large faces are divided, and their own normals count.

    Args:
        pixel: size of a ground pixel in the mesh's units.
    """
    vertices, parts, origin = divide_long_edges(
        np.asarray(mesh.vertices, np.float64), mesh.faces, options.seed_side * pixel
    )
    fine = Mesh(vertices, parts, np.zeros((len(vertices), 3), np.uint8))
    faces = measure_faces(fine, np.full(len(vertices), pixel), options)
    large = (face_areas(mesh) / (options.seed_area * pixel**2))[origin, None]
    planes = find_planes(
        replace(faces, normal=unit_vectors(faces.normal + large * face_normals(mesh)[origin])), options
    )
    label = np.full(len(mesh.faces), -1, np.int32)
    label[origin] = planes.label  # of its last part; parts of one face lie in one plane
    return replace(planes, label=label)


def find_planes(faces: MeshFaces, options: PlanarOptions, known: Sequence[Plane] = ()) -> Planes:
    """Find planes of at least ``least_area``, starting at the flattest faces.

    Args:
        faces: of the mesh.
        options: of the planes.
        known: planes that edges in the photos lie on, of either side, in the mesh's units. They replace those that
            begin on the surface where they hold more of it: a plain wall that sinks towards its windows comes out as
            several planes that lean.
    """
    label = np.full(len(faces.area), -1, np.int32)
    found: list[tuple[Plane, float]] = []
    refused: list[Plane] = []
    tree = cKDTree(faces.centre)
    for seed in _seeds(faces, options):
        rows = seed[label[seed] < 0]
        if faces.area[rows].sum() < options.seed_area:
            continue
        at, pixel = faces.centre[rows].mean(0), float(np.median(faces.pixel[rows]))
        local = _begin(faces, rows, tree, label, options)
        if local is None or _same(local, refused, at, pixel, options):
            continue
        free = np.flatnonzero(label < 0)
        free = free[faces.normal[free] @ local.normal > np.cos(np.radians(options.turn))]
        whole = _refit(faces, free, local, options)
        grown = (
            None if whole is None or _same(whole, refused, at, pixel, options) else _grow(faces, whole, free, options)
        )
        if grown is None:
            refused += [local] if whole is None else [local, whole]
            continue
        label[grown[1]] = len(found)
        found.append(grown[0])
    found, label = _take_known(faces, known, *_merge(faces, found, label, options), options)
    normals = np.array([plane.normal for plane, _ in found]).reshape(-1, 3)
    offsets = np.array([plane.offset for plane, _ in found])
    inside = label >= 0
    area = np.asarray(np.bincount(label[inside], faces.area[inside], len(found)), np.float64)
    return Planes(normals, offsets, np.array([noise for _, noise in found]), area, label)


def _take_known(
    faces: MeshFaces,
    known: Sequence[Plane],
    found: list[tuple[Plane, float]],
    label: NDArray[np.int32],
    options: PlanarOptions,
) -> tuple[list[tuple[Plane, float]], NDArray[np.int32]]:
    """Let known planes take the faces that are split among several planes found on the surface, or lie on none.

    Returns:
        planes with their noise, and labels [F].
    """
    if not known:
        return found, label
    found, label = list(found), label.copy()
    regions = sorted(_known_regions(faces, known, options), key=lambda region: -faces.area[region[1]].sum())
    for grown, inside in regions:
        held = label[inside]
        most = np.bincount(held[held >= 0], faces.area[inside[held >= 0]], 1).max()
        if grown[1] > options.known_noise or faces.area[inside].sum() < options.known_gain * most:
            continue
        label[inside] = len(found)
        found.append(grown)
    area = np.bincount(label[label >= 0], faces.area[label >= 0], len(found))
    kept = np.flatnonzero(area >= options.least_area)
    place = np.full(len(found) + 1, -1, np.int32)  # the last for faces without plane
    place[kept] = np.arange(len(kept))
    return [found[number] for number in kept], place[label]


def _known_regions(
    faces: MeshFaces, known: Sequence[Plane], options: PlanarOptions
) -> Iterator[tuple[tuple[Plane, float], NDArray[np.int64]]]:
    """Grow known planes of either side, each to all of its regions: the fitted plane, its noise, and the faces.

    Edges say that they are planes, so that they may bow by more than their noise: plain walls sink towards windows.
    """
    cosine, known_cosine = np.cos(np.radians((options.turn, options.merged_angle)))
    lenient = replace(options, bows=(options.known_bow, max(options.known_bow, options.bows[1])))
    for plane in (side for one in known for side in (one, Plane(-one.normal, -one.offset))):
        free = np.flatnonzero(faces.normal @ plane.normal > cosine)
        near = free[np.abs(faces.distances(plane, free)) < options.band]
        while (grown := _grow(faces, plane, near, lenient)) is not None:
            near = np.setdiff1d(near, grown[1])
            # Edges leave a plane uncertain by a pixel: the band lies around what was fitted to the region.
            grown = _grow(faces, grown[0][0], free, lenient)
            if grown is not None and grown[0][0].normal @ plane.normal > known_cosine:
                near, free = np.setdiff1d(near, grown[1]), np.setdiff1d(free, grown[1])
                yield grown


def _seeds(faces: MeshFaces, options: PlanarOptions) -> list[NDArray[np.int64]]:
    """Group the faces by place and direction; return those of each group that a plane may begin in, the best of each
    coarse cell first."""
    side = options.seed_side * float(np.median(faces.pixel))
    local = np.floor((faces.centre - faces.centre.min(0)) / side)
    cell = morton(local.astype(np.int64)) if local.max() < 2**20 else morton(cells_of(faces.centre))
    axis = np.abs(faces.normal).argmax(1)
    direction = 2 * axis + (np.take_along_axis(faces.normal, axis[:, None], 1)[:, 0] < 0)
    order, new = arrange(cell, direction)
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(new) - 1
    area = np.bincount(group, faces.area)
    mean = np.stack([np.bincount(group, faces.area * faces.normal[:, k]) for k in range(3)], 1)
    even = np.linalg.norm(mean, axis=1) / np.maximum(area, 1e-12)
    fit = np.flatnonzero((area >= options.seed_area) & (even >= options.seed_even))
    score = (even[fit] - options.seed_even) * np.minimum(area[fit], options.seed_side**2)
    bound = np.r_[np.flatnonzero(new), len(order)]
    some = order[bound[fit]]  # a face of each
    coarse = morton((local[some] // options.seed_coarse).astype(np.int64)) * 8 + direction[some]
    best = fit[_by_turns(coarse, score)]
    return [order[bound[g] : bound[g + 1]] for g in best[: options.tries]]


def _by_turns(cell: NDArray[np.integer], score: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order by score, [K], the best of each cell before the second of any: one even part does not use up all tries.

    Args:
        cell: coarse cell of each, [K].
        score: of each, [K].
    """
    ahead = np.lexsort((-score, cell))
    new = np.r_[True, cell[ahead][1:] != cell[ahead][:-1]][: len(ahead)]
    turn = np.empty(len(ahead), np.int64)
    turn[ahead] = np.arange(len(ahead)) - np.flatnonzero(new)[np.cumsum(new) - 1]
    return np.lexsort((-score, turn))


def _begin(
    faces: MeshFaces, seed: NDArray[np.int64], tree: cKDTree, label: NDArray[np.int32], options: PlanarOptions
) -> Plane | None:
    """Return the plane around the faces ``seed``, fitted within one of ``radii`` after the other."""
    plane = _fit(faces, seed, np.ones(len(seed)))
    if plane.normal @ faces.normal[seed].sum(0) < 0:
        plane = Plane(-plane.normal, -plane.offset)
    middle, side, facing = faces.centre[seed].mean(0), float(np.median(faces.pixel[seed])), plane.normal
    for radius in options.radii:
        near = np.sort(np.asarray(tree.query_ball_point(middle, radius * side), np.int64))
        near = near[(label[near] < 0) & (faces.normal[near] @ facing > np.cos(np.radians(options.turn)))]
        fitted = _refit(faces, near, plane, options)
        if fitted is None:
            return None
        plane = fitted
    return plane


def _refit(faces: MeshFaces, near: NDArray[np.int64], plane: Plane, options: PlanarOptions) -> Plane | None:
    """Return the plane moved onto those of the faces ``near`` that lie in it, twice; None where they are too few."""
    for _ in range(2):
        off = faces.distances(plane, near)
        inside = np.abs(off) < options.band
        if faces.area[near[inside]].sum() < options.seed_area:
            return None
        plane = _fit(faces, near[inside], (1 - (off[inside] / options.band) ** 2) ** 2).facing(plane.normal)
    return plane


def _same(plane: Plane, others: list[Plane], at: NDArray[np.float64], pixel: float, options: PlanarOptions) -> bool:
    """Tell whether a plane is one of others, near a point."""
    if not others:
        return False
    normals, offsets = np.array([other.normal for other in others]), np.array([other.offset for other in others])
    shift = np.abs((at @ plane.normal - plane.offset) - (normals @ at - offsets)) / pixel
    return bool(
        ((normals @ plane.normal > np.cos(np.radians(options.same_angle))) & (shift < options.same_shift)).any()
    )


def _grow(
    faces: MeshFaces, plane: Plane, free: NDArray[np.int64], options: PlanarOptions
) -> tuple[tuple[Plane, float], NDArray[np.int64]] | None:
    """Grow a plane to its largest connected region: the plane, its noise, and the faces; None if it is rejected."""
    inside = _largest_part(faces, free[np.abs(faces.distances(plane, free)) < options.band])
    if faces.area[inside].sum() < options.least_area:
        return None
    for _ in range(3):
        off = faces.distances(plane, inside)
        reach = max(min(options.sigmas * _noise(off, faces.area[inside]), options.band), 1e-6)
        weight = np.maximum(1 - (off / reach) ** 2, 0) ** 2
        if faces.area[inside[weight > 0]].sum() < options.least_area:
            return None
        plane = _fit(faces, inside, weight).facing(plane.normal)
    off = faces.distances(plane, inside)
    # centres of faces have less noise than vertices, so in a relief of a few sigma hardly any face counts as flat
    kept = np.abs(off) <= options.sigmas * _noise(off, faces.area[inside])
    inside, off = inside[kept], off[kept]
    if faces.area[inside].sum() < options.least_area or _bent(faces, inside, off, plane.normal, options):
        return None
    return (plane, _vertex_noise(faces, plane, inside)), inside


def _merge(
    faces: MeshFaces, found: list[tuple[Plane, float]], label: NDArray[np.int32], options: PlanarOptions
) -> tuple[list[tuple[Plane, float]], NDArray[np.int32]]:
    """Merge planes with larger ones that they lie in, the smallest first; return planes with noise, and labels [F].

    A plane lies in another if their angle is small, 90 % of its faces are near the other and their median distance is
    noise. The other is then fitted to the faces of both.
    """
    rows = [np.flatnonzero(label == number) for number in range(len(found))]
    area = np.array([faces.area[own].sum() for own in rows])
    merged = list(found)
    for number in np.argsort(area, kind="stable"):
        near = {}
        for other in np.flatnonzero(area > area[number]):
            if merged[other][0].normal @ merged[number][0].normal > np.cos(np.radians(options.merged_angle)):
                off = faces.distances(merged[other][0], rows[number])
                if abs(np.median(off)) < options.sigmas * max(merged[other][1], merged[number][1]):
                    near[int(other)] = float(np.percentile(np.abs(off), 90))
        target = min(near, key=lambda other: near[other], default=None)
        if target is None or near[target] > options.merged_distance:
            continue
        rows[target], rows[number] = np.r_[rows[target], rows[number]], rows[number][:0]
        area[target], area[number] = area[target] + area[number], 0.0
        plane = _fit(faces, rows[target], np.ones(len(rows[target]))).facing(merged[target][0].normal)
        merged[target] = (plane, _vertex_noise(faces, plane, rows[target]))
    kept = [number for number, own in enumerate(rows) if len(own)]
    label = np.full(len(label), -1, np.int32)
    for place, number in enumerate(kept):
        label[rows[number]] = place
    return [merged[number] for number in kept], label


def _vertex_noise(faces: MeshFaces, plane: Plane, rows: NDArray[np.int64]) -> float:
    """Estimate the standard deviation of the vertices of faces [K] from a plane, in ground pixels."""
    corners = (faces.mesh.vertices[faces.mesh.faces[rows]] @ plane.normal - plane.offset) / faces.pixel[rows, None]
    return _noise(corners.ravel(), np.repeat(faces.area[rows], 3))


def _fit(faces: MeshFaces, rows: NDArray[np.int64], weight: NDArray[np.float64]) -> Plane:
    """Return the plane through faces, weighted also by their area."""
    weight = weight * faces.area[rows] + 1e-12
    middle = weight @ faces.centre[rows] / weight.sum()
    local = faces.centre[rows] - middle
    normal = np.linalg.eigh((local * weight[:, None]).T @ local)[1][:, 0]
    return Plane(normal, float(normal @ middle))


def _largest_part(faces: MeshFaces, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the connected component of the faces with the largest area."""
    place = np.full(len(faces.area), -1, np.int64)
    place[rows] = np.arange(len(rows))
    a, b = place[faces.pairs]
    both = (a >= 0) & (b >= 0)
    part = label_components(len(rows), a[both], b[both])
    if not len(part):
        return rows
    return rows[part == np.bincount(part, faces.area[rows]).argmax()]


def _noise(off: NDArray[np.float64], area: NDArray[np.float64]) -> float:
    """Estimate the standard deviation of distances by the area-weighted median of their absolute values."""
    order = np.argsort(np.abs(off))
    sums = np.cumsum(area[order])
    return float(1.4826 * np.abs(off)[order[np.searchsorted(sums, sums[-1] / 2)]])


def _bent(
    faces: MeshFaces,
    rows: NDArray[np.int64],
    off: NDArray[np.float64],
    normal: NDArray[np.float64],
    options: PlanarOptions,
) -> bool:
    """Tell whether faces are too narrow for a plane, or deviate from it systematically.

    Two tests: the means over cells, and what a paraboloid explains against the noise around those means.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    flat = (faces.centre[rows] - faces.centre[rows].mean(0)) @ across.T / np.median(faces.pixel[rows])
    area = faces.area[rows]
    width = _width(flat, area)
    if width < options.least_width:
        return True
    places = np.floor(flat / options.bend_cell).astype(np.int64)
    places -= places.min(0)
    cell = places[:, 0] * (places[:, 1].max() + 1) + places[:, 1]
    sums = np.bincount(cell, area)
    means = np.bincount(cell, area * off) / np.maximum(sums, 1e-12)
    full = sums >= options.bend_area
    waves = np.sqrt((sums * means**2)[full].sum() / max(sums[full].sum(), 1e-12))
    noise = _noise(off - means[cell], area)
    most = max(np.clip(noise, *options.bows), options.bow_share * width)
    return bool(waves > options.waves or _bow(flat, off, area) > most)


def _width(flat: NDArray[np.float64], area: NDArray[np.float64]) -> float:
    """Return the shorter side of the rectangle with the second moments of places [K, 2], weighted by area."""
    spread = np.linalg.eigvalsh((flat * area[:, None]).T @ flat / area.sum())
    return float(np.sqrt(12 * max(spread[0], 0.0)))


def _bow(flat: NDArray[np.float64], off: NDArray[np.float64], area: NDArray[np.float64]) -> float:
    """Return the root mean square of the paraboloid that fits distances [K] at places [K, 2], weighted by area."""
    u, v = (flat / np.abs(flat).max()).T
    terms = np.stack([np.ones(len(u)), u, v, u * u, u * v, v * v], 1)
    weighted = terms * area[:, None]
    bow = terms @ np.linalg.lstsq(weighted.T @ terms, weighted.T @ off, rcond=1e-9)[0]
    return float(np.sqrt(area @ bow**2 / area.sum()))
