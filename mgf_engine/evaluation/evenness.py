# SPDX-License-Identifier: GPL-3.0-or-later
"""Evenness of the walls of a mesh without ground truth: its largest planes, and the deviations from them.

Points are sampled by area; the plane that holds most of them within three ground pixels is found, fitted to what it
holds and taken away, then the next one. Planes that most of their faces cross, as through leaves, frames or steps,
are none of the mesh and are left out. Distances tell of waves, angles between the faces and their plane of grain and
pits: a clean wall has a few degrees. Reveals of windows and the corners of other walls lie within three pixels of the
plane, too, so a perfect mesh has large angles at 90 %; away from whatever leaves the plane, it has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.surfaces import Points, Surface


@dataclass(frozen=True)
class EvennessOptions:
    """How the planes of a mesh are found; figures compare only where these are the same.

    Attributes:
        samples: number of points sampled on the mesh.
        planes: maximum number of planes.
        least_share: share of all points below which no further plane is looked for.
        reach: distance from a plane within which a point lies in it, ground pixels.
        near: distance, ground pixels, within which the three points lie that define half of the tried planes.
        tries: number of planes that are tried.
        tried_on: number of points they are tried on.
        fitted: number of the best ones that are fitted.
        rounds: number of rounds of fitting.
        edge: distance, ground pixels, from whatever leaves the plane up to which a point lies at an edge.
        edge_spacing: distance between the points by which edges are found, ground pixels.
        edge_samples: maximum number of these points.
        largest_median_angle: maximum median angle between a plane and the faces in it, degrees; above it, the plane is
            none of the mesh but cuts through what leaves the walls.
    """

    samples: int = 100_000
    planes: int = 8
    least_share: float = 0.01
    reach: float = 3.0
    near: float = 30.0
    tries: int = 4000
    tried_on: int = 4000
    fitted: int = 12
    rounds: int = 3
    edge: float = 6.0
    edge_spacing: float = 2.0
    edge_samples: int = 1_000_000
    largest_median_angle: float = 45.0


@dataclass(frozen=True)
class PlaneEvenness:
    """One plane of a mesh and how even it is.

    Attributes:
        share: of the mesh's area.
        rms: RMS distance of what lies in it, ground pixels.
        angle_median: median of the angle between its faces and it, degrees.
        angle_90: 90 % of that angle.
        interior_90: 90 % of that angle away from edges: corners, reveals and what else leaves the plane.
    """

    share: float
    rms: float
    angle_median: float
    angle_90: float
    interior_90: float


@dataclass(frozen=True)
class Evenness:
    """The largest planes of a mesh, the largest first; ``ground_pixel`` is the length of a pixel, units of the mesh."""

    ground_pixel: float
    planes: tuple[PlaneEvenness, ...]

    @property
    def mean(self) -> PlaneEvenness | None:
        """What all planes share of the mesh, and the means of their measures weighted by area; None without any."""
        if not self.planes:
            return None
        values = np.array([(p.rms, p.angle_median, p.angle_90, p.interior_90) for p in self.planes])
        shares = [plane.share for plane in self.planes]
        return PlaneEvenness(sum(shares), *np.average(values, axis=0, weights=shares).tolist())

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: ``mean`` (or null) and ``planes``, each as :class:`PlaneEvenness`, and
        ``ground_pixel``."""
        mean = None if self.mean is None else asdict(self.mean)
        return {"ground_pixel": self.ground_pixel, "mean": mean, "planes": [asdict(plane) for plane in self.planes]}


def measure_evenness(
    mesh: Surface, ground_pixel: float, options: EvennessOptions = EvennessOptions(), seed: int = 0
) -> Evenness:
    """Measure the largest planes of a mesh and how even they are.

    Args:
        mesh: in any unit.
        ground_pixel: length that a pixel of the photos covers on the building, in the units of the mesh.
        options: number of samples, and how planes are found.
        seed: of the sampling and of the planes that are tried.

    Raises:
        BadInput: the pixel's length or the number of samples is not a number above 0.
    """
    samples = options.samples
    if not 0 < ground_pixel < np.inf:
        raise BadInput(f"The length of a ground pixel must be finite and above 0, not {ground_pixel:g}.")
    if samples < 1:
        raise BadInput(f"The number of samples must be 1 or more, not {samples}.")
    rng = np.random.default_rng(seed)
    points, face = mesh.sample(samples, rng)
    middle = points.mean(0)
    points, normals = points - middle, mesh.normals(face)
    count = float(mesh.areas.sum()) / (options.edge_spacing * ground_pixel) ** 2
    around = mesh.sample(int(np.clip(count, samples, options.edge_samples)), rng)[0] - middle
    left, planes = np.arange(samples), list[PlaneEvenness]()
    while len(planes) < options.planes and len(left) >= max(options.least_share * samples, 3):
        centre, normal, held = _largest_plane(points[left], ground_pixel, rng, options)
        if len(held) < 3:
            break
        held = left[held]
        away = (points[held] - centre) @ normal
        angles = np.degrees(np.arccos(np.clip(np.abs(normals[held] @ normal), 0.0, 1.0)))
        left = np.setdiff1d(left, held, assume_unique=True)
        if np.median(angles) > options.largest_median_angle:
            continue
        interior = _away_from_edges(points[held], around, centre, normal, ground_pixel, options)
        planes.append(
            PlaneEvenness(
                len(held) / samples, float(np.sqrt((away**2).mean())) / ground_pixel, float(np.median(angles)),
                float(np.percentile(angles, 90)), float(np.percentile(angles[interior], 90)),
            )
        )  # fmt: skip
    return Evenness(ground_pixel, tuple(planes))


def typical_pixel(distances: Sequence[Points], focals: Sequence[float]) -> float:
    """Return the length that a pixel covers on what the photos show: the median over the photos.

    Args:
        distances: per photo, how far the sparse points are that it observed; none of photos without any.
        focals: of each photo, in pixels.

    Raises:
        BadInput: no photo observed a point.
    """
    sizes = [np.median(away) / focal for away, focal in zip(distances, focals, strict=True) if len(away)]
    if not sizes:
        raise BadInput(
            "No photo of the scene observed a sparse point, so the size of a pixel on the building is unknown."
        )
    return float(np.median(sizes))


def _largest_plane(
    points: Points, ground_pixel: float, rng: np.random.Generator, options: EvennessOptions
) -> tuple[Points, Points, NDArray[np.int64]]:
    """Return a point on the plane and its normal, [3] each, and the rows of points [N, 3] within reach of it."""
    reach = options.reach * ground_pixel
    some = points[rng.choice(len(points), min(options.tried_on, len(points)), replace=False)]
    middle, normals = _planes_through(some, options.near * ground_pixel, options.tries, rng)
    counts = _counts(some, normals, np.einsum("ti,ti->t", middle, normals), reach)
    best = np.argsort(-counts, kind="stable")[: options.fitted]
    fitted = [_fit(some, middle[k], normals[k], reach, options.rounds) for k in best]
    counts = _counts(some, np.stack([n for _, n in fitted]), np.array([c @ n for c, n in fitted]), reach)
    centre, normal = fitted[int(np.argmax(counts))]
    centre, normal = _fit(points, centre, normal, reach, options.rounds)
    return centre, normal, np.flatnonzero(np.abs((points - centre) @ normal) < reach)


def _away_from_edges(
    points: Points, around: Points, centre: Points, normal: Points, ground_pixel: float, options: EvennessOptions
) -> NDArray[np.bool_]:
    """Tell which points [N, 3] of a plane lie away from whatever leaves it, bool [N]; all, where none does.

    Args:
        points: in the plane.
        around: points of the whole mesh, [M, 3].
        centre: a point of the plane, [3].
        normal: of the plane, [3].
        ground_pixel: length that a pixel covers.
        options: reach of the plane, and distance from its edges.
    """
    away, edge = np.abs((around - centre) @ normal), options.edge * ground_pixel
    beyond = around[(away > options.reach * ground_pixel) & (away < edge)]
    if not len(beyond):
        return np.ones(len(points), bool)
    interior = cKDTree(beyond).query(points, distance_upper_bound=edge)[0] == np.inf
    return interior if interior.any() else np.ones(len(points), bool)


def _planes_through(points: Points, near: float, tries: int, rng: np.random.Generator) -> tuple[Points, Points]:
    """Return planes through three points each, half of them near each other: where they are and their normals, [T, 3]
    each."""
    first, second, third = rng.integers(0, len(points), (3, tries))
    for start in range(0, tries // 2, 250):
        part = slice(start, min(start + 250, tries // 2))
        row, around = np.nonzero(cdist(points[first[part]], points, "sqeuclidean") <= near * near)
        counts = np.bincount(row)  # each point is near itself
        chosen = rng.integers(0, counts[:, None], (len(counts), 2)) + (np.cumsum(counts) - counts)[:, None]
        second[part], third[part] = around[chosen].T
    normals = np.cross(points[second] - points[first], points[third] - points[first])
    length = np.linalg.norm(normals, axis=1)
    good = length > 0
    if not good.any():
        return points[first[:1]], np.array([[0.0, 0.0, 1.0]])
    return points[first[good]], normals[good] / length[good, None]


def _counts(points: Points, normals: Points, offsets: Points, reach: float) -> NDArray[np.int64]:
    """Return how many of points [N, 3] lie within reach of each plane ``normal . x = offset``, [T]."""
    flat = points.astype(np.float32)
    result = np.empty(len(normals), np.int64)
    for start in range(0, len(normals), 500):
        part = slice(start, start + 500)
        away = flat @ normals[part].T.astype(np.float32) - offsets[part].astype(np.float32)
        result[part] = np.count_nonzero(np.abs(away) < reach, axis=0)
    return result


def _fit(points: Points, centre: Points, normal: Points, reach: float, rounds: int) -> tuple[Points, Points]:
    """Fit the plane of least squares through the points within reach of it, a few times over."""
    for _ in range(rounds):
        held = points[np.abs((points - centre) @ normal) < reach]
        if len(held) < 3:
            break
        centre = held.mean(0)
        local = held - centre
        normal = np.linalg.eigh(local.T @ local)[1][:, 0]
    return centre, normal
