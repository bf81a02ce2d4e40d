# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail of a mesh, and how far each lies from the full one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.geometry.rasterize import render_parallel
from mgf_engine.mesh.decimate import reduce_faces
from mgf_engine.model.mesh import Mesh
from mgf_engine.options.algorithms import parameter

SAMPLES = 100_000  # points on each of two surfaces whose deviation is reported
_DIRECTIONS, _SIDE = 8, 400  # of silhouettes: around the building, and pixels along the side of each picture

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LodOptions:
    """Options of the levels of detail."""

    shares: tuple[float, float, float] = parameter(
        (0.25, 0.06, 0.015), "Number of faces of each coarser level, as shares of the full mesh's", high=1
    )
    face_excess: float = parameter(1.05, "Largest number of faces of a level over the wanted number", low=1)
    nearer: float = parameter(
        0.67, "Share of the error of the decimation that keeps topology, from which the other one is taken", high=1
    )
    clearer: float = parameter(
        0.01, "Gain in overlap of the silhouettes over the decimation that keeps topology, from which too", high=1
    )
    least_silhouette: float = parameter(
        0.92, "Overlap of the silhouettes below which a level gets more faces than wanted", high=1
    )
    more_faces: tuple[float, float, float] = parameter(
        (1.5, 2.0, 3.0),
        "Factors on the wanted number of faces of a level with too little silhouette overlap, tried in turn",
        low=1,
    )
    samples: int = parameter(25_000, "Number of points at which the two decimations of a level are compared", low=100)
    aggressiveness: float = parameter(
        5.0, "Growth of the error that fast-simplification tolerates from round to round (its agg)", low=1
    )


@dataclass(frozen=True)
class Deviation:
    """Distances between two surfaces, from each to the other, in their unit.

    Attributes:
        rms: root mean square.
        p90, p95: 90th and 95th percentile.
        largest: maximum of all samples.
    """

    rms: float
    p90: float
    p95: float
    largest: float

    def as_dict(self) -> dict[str, float]:
        return {name: round(value, 6) for name, value in self.__dict__.items()}


def reduce_chain(
    mesh: Mesh,
    errors: Sequence[float] = (),
    progress: Callable[[float], None] = lambda share: None,
    options: LodOptions = LodOptions(),
) -> list[Mesh]:
    """Return the mesh and coarser ones, each made from the full mesh, so that errors do not add up.

    Args:
        mesh: the full one, with or without colours.
        errors: how far each coarser mesh may lie from the full one, in its unit; empty takes the options' shares.
        progress: called with the share of the work done.
        options: number of levels, and their errors as shares of the size.
    """
    chain = [mesh]
    steps = len(errors) or len(options.shares)
    for k in range(steps):
        if errors:
            chain.append(reduce_faces(mesh, 0, errors[k]))
        else:
            chain.append(_reduced_to(mesh, max(4, round(options.shares[k] * len(mesh.faces))), options))
        progress((k + 1) / steps)
    return chain


def _reduced_to(mesh: Mesh, most: int, options: LodOptions) -> Mesh:
    """Reduce the mesh to about ``most`` faces, or to more where its outline needs them: a ragged mesh has so many
    tunnels that no reduction to so few can leave enough of it."""
    best = _of_size(mesh, most, options)
    overlap = silhouette_overlap(mesh, best)
    for more in options.more_faces:
        if overlap >= options.least_silhouette:
            break
        finer = _of_size(mesh, round(more * most), options)
        better = silhouette_overlap(mesh, finer)
        if better > overlap:
            best, overlap = finer, better
    return best


def _of_size(mesh: Mesh, most: int, options: LodOptions) -> Mesh:
    """Reduce the mesh to about ``most`` faces.

    Our own reduction keeps rims and holes, and keeps every tunnel. A coarse mesh has no faces for all of those: where
    it misses the number, lies much farther off or shows another outline, edges collapse whatever they close
    (fast-simplification, Garland and Heckbert's quadrics). That one stops early on some meshes of large flat faces;
    where both miss the number, the smaller one is taken.
    """
    kept, free = reduce_faces(mesh, most), _simplified(mesh, most, options)
    if not len(free.faces):
        return kept
    if max(len(kept.faces), len(free.faces)) > options.face_excess * most:
        return min(kept, free, key=lambda reduced: len(reduced.faces))
    return free if _better(mesh, free, kept, options) else kept


def _better(mesh: Mesh, free: Mesh, kept: Mesh, options: LodOptions) -> bool:
    """Tell whether the free reduction is much nearer to the mesh than that which keeps topology, or has a clearly
    better outline."""
    off = [measure_deviation(mesh, reduced, options.samples).rms for reduced in (free, kept)]
    if off[0] < options.nearer * off[1]:
        return True
    return silhouette_overlap(mesh, free) > silhouette_overlap(mesh, kept) + options.clearer


def _simplified(mesh: Mesh, most: int, options: LodOptions) -> Mesh:
    """Reduce the mesh to ``most`` faces, topology or not; where it keeps more, errors may grow faster."""
    import fast_simplification

    if most >= len(mesh.faces):
        return mesh
    middle = mesh.vertices.mean(0)
    local, faces = (mesh.vertices - middle).astype(np.float32), np.ascontiguousarray(mesh.faces)
    for pace in (options.aggressiveness, options.aggressiveness + 2):
        points, left = fast_simplification.simplify(local, faces, target_count=most, agg=pace)
        if len(left) <= options.face_excess * most:
            break
    used, index = np.unique(left, return_inverse=True)
    vertices = np.asarray(points, np.float64)[used] + middle
    colors = mesh.colors[cKDTree(mesh.vertices).query(vertices)[1]]
    return Mesh(vertices, index.reshape(-1, 3).astype(np.int32), colors)


def measure_deviation(one: Mesh, other: Mesh, samples: int = SAMPLES) -> Deviation:
    """Measure the distance of two surfaces at points uniform by area on both."""
    surfaces = [Surface(m.vertices, m.faces.astype(np.int64)) for m in (one, other)]
    rng = np.random.default_rng(0)
    pairs = (surfaces, surfaces[::-1])
    return deviation_of(np.concatenate([to.distances(a.sample(samples, rng)[0]) for a, to in pairs]))


def deviation_of(distances: Array) -> Deviation:
    """Return the figures of distances [n]."""
    p90, p95 = np.percentile(distances, (90, 95)).tolist()
    return Deviation(float(np.sqrt((distances**2).mean())), p90, p95, float(distances.max()))


def silhouette_overlap(one: Mesh, other: Mesh) -> float:
    """Compute the least overlap (intersection over union) of two outlines, seen from all sides level and from above;
    0..1."""
    middle = 0.5 * (one.vertices.min(0) + one.vertices.max(0))
    reach = float(np.linalg.norm(one.vertices - middle, axis=1).max()) * 1.05
    least = 1.0
    for x, y in _silhouette_axes():
        seen = [_outline(mesh.vertices - middle, mesh.faces, np.stack([x, y]) / reach) for mesh in (one, other)]
        least = min(least, float((seen[0] & seen[1]).sum() / max(int((seen[0] | seen[1]).sum()), 1)))
    return least


def _silhouette_axes() -> list[tuple[Array, Array]]:
    """Return the axes to the right and up of the pictures of a silhouette: level ones, and one from above."""
    up = np.array([0.0, 0.0, 1.0])
    angles = np.pi * np.arange(_DIRECTIONS // 2) / (_DIRECTIONS // 2)  # the other side shows the same outline
    level = [(np.array([np.cos(a), np.sin(a), 0.0]), up) for a in angles]
    return [*level, (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))]


def _outline(points: Array, faces: NDArray[np.int32], axes: Array) -> NDArray[np.bool_]:
    at = 0.5 * _SIDE * (points @ axes.T + 1)
    return render_parallel(np.column_stack([at, np.zeros(len(at))]), faces, _SIDE, _SIDE).face >= 0
