# SPDX-License-Identifier: GPL-3.0-or-later
"""Equalize exposure and white balance of the photos of a scene.

A camera on automatic changes both between photos; the field would paint the change onto the building or in front of
it. The gains follow from points that several photos observed: log c = g(photo) + p(point) per channel, solved over all
observations by least squares with Cauchy's weights, the points eliminated. Stored values are a power of the light
(gamma), so a change of exposure is a gain of theirs, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from mgf_engine.files.images import read_rgb, write_png
from mgf_engine.model.photo_cache import PHOTOS
from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

_TOLERANCE, _MAX_STEPS = 1e-9, 2000  # relative residual of the conjugate gradients, and number of their steps

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExposureOptions:
    """Options of the adjustment of exposures."""

    darkest: float = parameter(12.0, "Grey value below which an observation does not count", "grey levels", high=255)
    brightest: float = parameter(240.0, "Grey value above which an observation does not count", "grey levels", high=255)
    rounds: int = parameter(10, "Number of rounds of robust least squares", low=1)
    noise: float = parameter(0.06, "Scale of Cauchy's weights, of the logarithm of a colour", low=0.001)
    prior: float = parameter(2.0, "Weight of unchanged exposure, in observations")
    least_change: float = parameter(0.02, "Largest logarithm of a gain below which no photo is changed")
    largest_gain: float = parameter(3.0, "Largest gain, and inverse of the smallest", low=1)


def even_exposure(scene: Scene, folder: Path, threads: int = 1, options: ExposureOptions = ExposureOptions()) -> Array:
    """Rewrite the working photos in ``folder`` with equal exposure and white balance.

    Args:
        scene: its tracks are the pixels that show the same point.
        folder: holds the working photos of ``scene`` under their file names.
        threads: photos that are worked on at a time.
        options: from which difference on photos are changed, and how strongly.

    Returns:
        What each photo's channels were multiplied by, [V, 3]; ones where nothing was changed.
    """
    gains = photo_gains(observed_colors(scene, folder, threads), scene, options)

    def rewrite(index: int) -> None:
        path = folder / Path(scene.views[index].file).name
        write_png(path, with_gain(PHOTOS.get(path, read_rgb), gains[index]))

    for _ in parallel_map(rewrite, np.flatnonzero((gains != 1.0).any(1)).tolist(), threads):
        pass
    return gains


def with_gain(photo: NDArray[np.uint8], gain: Sequence[float] | Array) -> NDArray[np.uint8]:
    """Return a photo [h, w, 3] with its channels multiplied by ``gain`` [3]."""
    table = np.clip(np.arange(256)[:, None] * np.asarray(gain), 0, 255).round().astype(np.uint8)
    return np.asarray(cv2.LUT(photo, table[None]), np.uint8)


def photo_gains(observed: Array, scene: Scene, options: ExposureOptions = ExposureOptions()) -> Array:
    """Find factors [V, 3] that make the photos agree on their points; all ones when they agree already.

    Args:
        observed: colours of the scene's observations, 0..255, [T, 3].
    """
    owner = scene.track_point
    valid = ((observed > options.darkest) & (observed < options.brightest)).all(1)
    shared = np.bincount(owner[valid], minlength=len(scene.points)) >= 2
    valid &= shared[owner]
    if not valid.any():
        return np.ones((len(scene.views), 3))
    point, view = np.unique(owner[valid], return_inverse=True)[1], scene.track_view[valid]
    logs = np.stack([_solve(np.log(c), view, point, len(scene.views), options) for c in observed[valid].T], 1)
    if np.abs(logs).max() < options.least_change:
        return np.ones((len(scene.views), 3))
    gains: Array = np.exp(np.clip(-logs, -np.log(options.largest_gain), np.log(options.largest_gain)))
    return gains


def _solve(
    value: Array, view: NDArray[np.int32], point: NDArray[np.int64], views: int, options: ExposureOptions
) -> Array:
    """Solve value = g[view] + p[point] for g [views], the points eliminated; its mean is zero.

    The matrix between photos is never formed: it would grow with their square, and with that of the tracks' lengths.
    Conjugate gradients apply it instead, in the time that the observations take (Hestenes and Stiefel 1952).
    """
    points = int(point.max()) + 1
    weight = np.ones(len(value))
    log_gain = np.zeros(views)
    for _ in range(options.rounds):
        pairs = sparse.csr_matrix((weight, (view, point)), shape=(views, points))
        per_point = np.bincount(point, weight, points)
        mean = np.bincount(point, weight * value, points) / per_point
        own: Array = np.bincount(view, weight, views).astype(np.float64) + options.prior
        right: Array = np.bincount(view, weight * (value - mean[point]), views).astype(np.float64)
        log_gain = _conjugate_gradients(pairs, np.asarray(1.0 / per_point), own, right, log_gain)
        log_gain -= log_gain.mean()
        level = np.bincount(point, weight * (value - log_gain[view]), points) / per_point
        residual = np.abs(value - log_gain[view] - level[point])
        weight = 1.0 / (1.0 + (residual / options.noise) ** 2)
    return log_gain


def _conjugate_gradients(pairs: sparse.csr_matrix, share: Array, own: Array, right: Array, start: Array) -> Array:
    """Solve (diag(own) - P diag(share) P^T) x = right for x.

    Args:
        pairs: P, weights [V, P]; share: [P]; own, right: [V].
        start: a guess, [V].
    """
    across = pairs.T.tocsr()

    def times(x: Array) -> Array:
        return np.asarray(own * x - pairs @ (share * (across @ x)))

    shape = (len(own), len(own))
    matrix = LinearOperator(shape, matvec=times, dtype=np.float64)
    jacobi = LinearOperator(shape, matvec=lambda x: x / own, dtype=np.float64)
    found, _ = cg(matrix, right, x0=start, rtol=_TOLERANCE, atol=0.0, maxiter=_MAX_STEPS, M=jacobi)
    return np.asarray(found)


def observed_colors(scene: Scene, folder: Path, threads: int = 1) -> Array:
    """Return the mean colour of the 3 x 3 pixels around each observation, 0..255, [T, 3].

    Args:
        folder: holds the working photos under their file names.
    """
    colors = np.zeros((len(scene.track_view), 3))

    def read_colors(index: int) -> None:
        mine = scene.observations(index)
        blurred = cv2.blur(PHOTOS.get(folder / Path(scene.views[index].file).name, read_rgb), (3, 3))
        x, y = np.floor(scene.track_uv[mine]).astype(int).T
        colors[mine] = blurred[np.clip(y, 0, blurred.shape[0] - 1), np.clip(x, 0, blurred.shape[1] - 1)]

    for _ in parallel_map(read_colors, range(len(scene.views)), threads):
        pass
    return colors
