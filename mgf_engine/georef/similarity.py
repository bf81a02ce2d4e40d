# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit similarities between two point sets: closed form, robust, and weighted by accuracies."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_MOST_SAMPLES = 600  # of triples, for a bounded time
#: Second singular value of points as a share of the first below which they are on a line: the turn about it is unknown.
LINE = 0.02


@dataclass(frozen=True)
class Direction:
    """That a direction of the source is up in the target, known to ``sd`` radians."""

    source: Array
    sd: float


def umeyama(source: Array, target: Array, weights: Array | None = None) -> Array:
    """Fit the similarity [4, 4] that takes ``source`` [N, 3] to ``target`` [N, 3] by least squares.

    Source: Umeyama 1991, eqs. 40-43, with weights [N].
    """
    share = np.full(len(source), 1.0 / len(source)) if weights is None else weights / weights.sum()
    a, b = source - share @ source, target - share @ target
    u, values, vt = np.linalg.svd((b * share[:, None]).T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt)) or 1.0])
    rotation = (u * sign) @ vt
    spread = float(share @ (a**2).sum(1))
    scale = float(values @ sign) / spread if spread > 0 else 1.0
    return matrix_of(scale, rotation, share @ target - scale * rotation @ (share @ source))


def matrix_of(scale: float, rotation: Array, translation: Array) -> Array:
    """Return a similarity as a matrix [4, 4]."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * rotation, translation
    return matrix


def transform_points(matrix: Array, points: Array) -> Array:
    """Return points [..., 3] after a similarity [4, 4]."""
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def straightness(points: Array) -> float:
    """Measure the second spread of points [N, 3] as a share of their first: 0 on a line; 0 as well where they are one
    point."""
    spreads = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return float(spreads[1] / spreads[0]) if len(spreads) > 1 and spreads[0] > 0 else 0.0


def find_inliers(source: Array, target: Array, tolerance: Array, seed: int = 0) -> NDArray[np.bool_]:
    """Find by RANSAC the points [N] that one similarity explains within ``tolerance`` [N]: the largest such set.

    All triples are tried while there are few, else a fixed number of random ones; triples on a line are passed over.

    Args:
        source: [N, 3].
        target: [N, 3].
        tolerance: largest distance of each point, [N].
        seed: of the random triples.
    """
    count = len(source)
    if comb(count, 3) <= _MOST_SAMPLES:
        triples = np.array(list(combinations(range(count), 3)))
    else:
        rng = np.random.default_rng(seed)
        triples = np.array([rng.choice(count, 3, replace=False) for _ in range(_MOST_SAMPLES)])
    best, cost = np.zeros(count, bool), np.inf
    for triple in triples:
        if straightness(target[triple]) < LINE or straightness(source[triple]) < LINE:
            continue
        found = umeyama(source[triple], target[triple])
        away = np.linalg.norm(transform_points(found, source) - target, axis=1) / tolerance
        now = float(np.minimum(away, 1.0) @ np.minimum(away, 1.0))  # MSAC: how well counts as well as how many
        if now < cost:
            best, cost = away < 1.0, now
    return best


def refine_similarity(matrix: Array, source: Array, target: Array, sd: Array, up: Direction | None = None) -> Array:
    """Return the similarity improved by least squares of residuals over their accuracies.

    Args:
        matrix: where to begin.
        source, target: [N, 3].
        sd: accuracy of each coordinate of the target, [N, 3].
        up: a direction of the source that is +z in the target.
    """
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    middle = source.mean(0)  # turns and scales about it, so that the seven numbers hardly depend on each other
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    rotation, place = matrix[:3, :3] / scale, transform_points(matrix, middle)

    def unpacked(x: Array) -> Array:
        grown, turned = scale * np.exp(x[6]), Rotation.from_rotvec(x[3:6]).as_matrix() @ rotation
        return matrix_of(grown, turned, place + x[:3] - grown * turned @ middle)

    def residuals(x: Array) -> Array:
        now = unpacked(x)
        rows = [((transform_points(now, source) - target) / sd).ravel()]
        if up is not None:
            turned = now[:3, :3] @ up.source
            rows.append(turned[:2] / np.linalg.norm(turned) / up.sd)
        return np.concatenate(rows)

    found = least_squares(residuals, np.zeros(7), method="trf", x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return unpacked(found.x)
