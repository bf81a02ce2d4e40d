# SPDX-License-Identifier: GPL-3.0-or-later
"""A small bundle adjustment: poses, focal lengths and points that make observations and projections agree.

Levenberg-Marquardt with the points eliminated (Schur complement) and Cauchy's weights, after Triggs, McLauchlan,
Hartley and Fitzgibbon, "Bundle Adjustment - A Modern Synthesis" (2000). One thread, no randomness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_ROUNDS, _POINT_ROUNDS = 40, 8
_ENOUGH = 1e-4  # relative gain of a round below which the work is done
_LEAST_SCALE = 0.5  # pixels, of Cauchy's weights
_LARGEST_DAMPING = 1e8


@dataclass(frozen=True)
class Bundle:
    """Cameras, points and what the cameras saw; ``V`` views, ``G`` cameras (lenses), ``P`` points, ``T`` observations.

    Attributes:
        rotations, translations: ``camera = R @ world + t``, [V, 3, 3] and [V, 3].
        points: [P, 3].
        focal: logarithm of what each lens' focal length is to be multiplied by, [G].
        lens: the lens of each view, int [V].
        view, point: of each observation, int [T].
        rays: observed x / z and y / z through the lens as it was, [T, 2]; NaN where there is none.
        pixels: how many pixels of the working photo a ray's unit is, [T].
    """

    rotations: Array
    translations: Array
    points: Array
    focal: Array
    lens: Indices
    view: Indices
    point: Indices
    rays: Array
    pixels: Array

    @property
    def centres(self) -> Array:
        """Camera centres, [V, 3]."""
        return np.asarray(-np.einsum("vji,vj->vi", self.rotations, self.translations))


def errors(bundle: Bundle) -> Array:
    """Distance between observation and projection, working pixels, [T]; inf behind a camera and without a ray."""
    local = _local(bundle)
    size = np.linalg.norm(_residuals(bundle, local), axis=1)
    return np.where((local[:, 2] > 0) & np.isfinite(size), size, np.inf)


def adjust(bundle: Bundle, chosen: Indices) -> Bundle:
    """Poses, focal lengths and the points of the observations ``chosen`` improved until nothing is gained any more."""
    used, slot = np.unique(bundle.point[chosen], return_inverse=True)
    part = replace(
        bundle, points=bundle.points[used], point=slot.astype(np.int64), view=bundle.view[chosen],
        rays=bundle.rays[chosen], pixels=bundle.pixels[chosen],
    )  # fmt: skip
    damping, scale = 1e-3, _scale(part)
    cost = _cost(part, scale)
    for _ in range(_ROUNDS):
        better, gain = None, 0.0
        system = _System(part, scale)
        while better is None and damping < _LARGEST_DAMPING:
            tried = _moved(part, *system.solve(damping))
            after = _cost(tried, scale)
            if after < cost:
                better, gain, damping = tried, (cost - after) / cost, damping / 5
            else:
                damping *= 4
        if better is None:
            break
        part, scale = better, min(scale, _scale(better))
        cost = _cost(part, scale)
        if gain < _ENOUGH:
            break
    points = bundle.points.copy()
    points[used] = part.points
    return replace(bundle, rotations=part.rotations, translations=part.translations, points=points, focal=part.focal)


def triangulate(bundle: Bundle) -> Bundle:
    """All points placed anew for the cameras as they are; a point that gets no better stays."""
    start = replace(bundle, points=_linear_points(bundle))
    before, after = (_point_costs(b) for b in (bundle, start))
    best = replace(bundle, points=np.where((after < before)[:, None], start.points, bundle.points))
    for _ in range(_POINT_ROUNDS):
        local = _local(best)
        residual, weight = _weighted(best, local, _LEAST_SCALE)
        slope = _by_point(best, local) * weight[:, None, None]
        normal, right = _point_normals(best, slope, residual * weight[:, None])
        step = np.linalg.solve(normal + 1e-9 * _traces(normal), right[..., None])[..., 0]
        tried = replace(best, points=best.points - step)
        gained = _point_costs(tried) < _point_costs(best)
        best = replace(best, points=np.where(gained[:, None], tried.points, best.points))
    return best


def _linear_points(bundle: Bundle) -> Array:
    """Points nearest to all rays that saw them (least squares), [P, 3]; the old ones where rays are parallel."""
    zoom = np.exp(-bundle.focal)[bundle.lens[bundle.view]]
    ray = np.column_stack([bundle.rays * zoom[:, None], np.ones(len(bundle.rays))])
    known = np.isfinite(ray).all(1)
    ray[~known] = 1.0
    turned: Array = np.einsum("tji,tj->ti", bundle.rotations[bundle.view], ray)
    direction: Array = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    centres: Array = bundle.centres[bundle.view]
    across: Array = np.eye(3) - direction[:, :, None] * direction[:, None]
    across[~known] = 0.0
    normal = _sum_by(bundle.point, across, len(bundle.points))
    right = _sum_by(bundle.point, (across @ centres[..., None])[..., 0], len(bundle.points))
    sound = np.linalg.eigvalsh(normal)[:, 0] > 1e-6
    normal[~sound] = np.eye(3)
    return np.where(sound[:, None], np.linalg.solve(normal, right[..., None])[..., 0], bundle.points)


class _System:
    """Normal equations at one place; poses first, then focal lengths; points eliminated."""

    def __init__(self, bundle: Bundle, scale: float) -> None:
        local = _local(bundle)
        residual, weight = _weighted(bundle, local, scale)
        self.bundle, views, lenses = bundle, len(bundle.rotations), len(bundle.focal)
        flat = _projection_slope(bundle, local) * weight[:, None, None]  # [T, 2, 3]
        turn = -flat @ _cross(local)
        zoom = (weight[:, None] * (residual + bundle.pixels[:, None] * np.nan_to_num(bundle.rays)))[..., None]
        slope = np.concatenate([turn, flat, zoom], 2)  # [T, 2, 7]
        first = 6 * bundle.view[:, None] + np.arange(6)
        columns = np.column_stack([first, 6 * views + bundle.lens[bundle.view]])
        self.cameras = _sparse(slope, columns, 6 * views + lenses)
        per_point = flat @ bundle.rotations[bundle.view]
        self.of_points = _sparse(per_point, 3 * bundle.point[:, None] + np.arange(3), 3 * len(bundle.points))
        right = (residual * weight[:, None]).ravel()
        self.normal = (self.cameras.T @ self.cameras).toarray()
        self.coupling = (self.cameras.T @ self.of_points).tocsr()
        self.blocks = _point_normals(bundle, per_point, residual * weight[:, None])[0]
        self.right, self.right_points = self.cameras.T @ right, self.of_points.T @ right

    def solve(self, damping: float) -> tuple[Array, Array]:
        """Steps of poses and focal lengths, and of the points [P, 3]."""
        diagonal = np.diag(self.normal)
        floor = 1e-9 * max(float(diagonal.max()), 1e-30)
        damped = self.normal + np.diag(damping * diagonal + floor)
        blocks = self.blocks * (1 + damping * np.eye(3)) + 1e-12 * _traces(self.blocks)
        inverse = sparse.block_diag(list(np.linalg.inv(blocks)), format="csr")
        through = self.coupling @ inverse
        reduced = damped - (through @ self.coupling.T).toarray()
        right = self.right - through @ self.right_points
        try:
            cameras = linalg.solve(reduced, right, assume_a="pos")
        except linalg.LinAlgError:
            cameras = np.zeros_like(right)
        points = inverse @ (self.right_points - self.coupling.T @ cameras)
        return -cameras, -points.reshape(-1, 3)


def _moved(bundle: Bundle, cameras: Array, points: Array) -> Bundle:
    views = len(bundle.rotations)
    pose = cameras[: 6 * views].reshape(-1, 6)
    turn = _turns(pose[:, :3])
    return replace(
        bundle, rotations=turn @ bundle.rotations,
        translations=np.einsum("vij,vj->vi", turn, bundle.translations) + pose[:, 3:],
        points=bundle.points + points, focal=bundle.focal + cameras[6 * views :],
    )  # fmt: skip


def _local(bundle: Bundle) -> Array:
    """The observed points in their cameras, [T, 3]."""
    turned = np.einsum("tij,tj->ti", bundle.rotations[bundle.view], bundle.points[bundle.point])
    return np.asarray(turned + bundle.translations[bundle.view])


def _depths(local: Array) -> Array:
    return np.where(local[:, 2] > 1e-9, local[:, 2], 1e-9)


def _zoom(bundle: Bundle) -> Array:
    return np.asarray(np.exp(bundle.focal)[bundle.lens[bundle.view]] * bundle.pixels)


def _residuals(bundle: Bundle, local: Array) -> Array:
    """Projection less observation, working pixels, [T, 2]."""
    projected = local[:, :2] / _depths(local)[:, None] * _zoom(bundle)[:, None]
    return np.asarray(projected - bundle.rays * bundle.pixels[:, None])


def _projection_slope(bundle: Bundle, local: Array) -> Array:
    """Change of the projection with the point in its camera, [T, 2, 3]."""
    depth, slope = _depths(local), np.zeros((len(local), 2, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = 1.0 / depth
    slope[:, :, 2] = -local[:, :2] / depth[:, None] ** 2
    return slope * _zoom(bundle)[:, None, None]


def _by_point(bundle: Bundle, local: Array) -> Array:
    return np.asarray(_projection_slope(bundle, local) @ bundle.rotations[bundle.view])


def _weighted(bundle: Bundle, local: Array, scale: float) -> tuple[Array, Array]:
    """Residuals (0 where nothing was seen or the point lies behind) and the roots of Cauchy's weights."""
    residual = _residuals(bundle, local)
    valid = np.isfinite(residual).all(1) & (local[:, 2] > 1e-9)
    residual = np.where(valid[:, None], residual, 0.0)
    weight = 1.0 / np.sqrt(1.0 + (residual**2).sum(1) / scale**2)
    return residual, np.where(valid, weight, 0.0)


def _losses(bundle: Bundle, scale: float) -> Array:
    """Cauchy's loss of each observation, [T]; behind a camera that of a large error."""
    local = _local(bundle)
    squared = (_residuals(bundle, local) ** 2).sum(1)
    squared = np.where(local[:, 2] > 1e-9, squared, 1e6)
    return np.asarray(np.where(np.isfinite(squared), np.log1p(squared / scale**2), 0.0))


def _cost(bundle: Bundle, scale: float) -> float:
    return float(_losses(bundle, scale).sum())


def _point_costs(bundle: Bundle) -> Array:
    return np.asarray(np.bincount(bundle.point, _losses(bundle, _LEAST_SCALE), len(bundle.points)), np.float64)


def _scale(bundle: Bundle) -> float:
    size = errors(bundle)
    known = size[np.isfinite(size)]
    return max(_LEAST_SCALE, 2.0 * float(np.median(known))) if len(known) else _LEAST_SCALE


def _point_normals(bundle: Bundle, slope: Array, residual: Array) -> tuple[Array, Array]:
    """Per point J^T J [P, 3, 3] and J^T r [P, 3]."""
    normal = _sum_by(bundle.point, np.einsum("tki,tkj->tij", slope, slope), len(bundle.points))
    return normal, _sum_by(bundle.point, np.einsum("tki,tk->ti", slope, residual), len(bundle.points))


def _sum_by(index: Indices, values: Array, count: int) -> Array:
    """Sums of values [T, ...] by index, [count, ...]."""
    flat = values.reshape(len(values), -1)
    sums = [np.bincount(index, column, count) for column in flat.T]
    return np.asarray(np.stack(sums, 1).reshape(count, *values.shape[1:]), np.float64)


def _traces(blocks: Array) -> Array:
    """The blocks' traces (never 0) times the unit matrix, [P, 3, 3]."""
    size = np.trace(blocks, axis1=1, axis2=2)
    return np.asarray(np.maximum(size, 1e-12)[:, None, None] * np.eye(3))


def _sparse(slope: Array, columns: Indices, width: int) -> sparse.csr_matrix:
    """The rows of slope [T, 2, k] with the same columns [T, k] for both, as a matrix [2 T, width]."""
    count, _, k = slope.shape
    where = np.repeat(columns[:, None], 2, axis=1).ravel()
    return sparse.csr_matrix((slope.ravel(), where, np.arange(0, 2 * count * k + 1, k)), shape=(2 * count, width))


def _cross(vectors: Array) -> Array:
    """Matrices [T, 3, 3] that take the cross product with vectors [T, 3]."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)


def _turns(vectors: Array) -> Array:
    """Rotations [V, 3, 3] about vectors by their lengths (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    k = _cross(vectors)
    safe = np.maximum(angle, 1e-12)
    return np.asarray(np.eye(3) + np.sin(angle) / safe * k + (1 - np.cos(angle)) / safe**2 * (k @ k))
