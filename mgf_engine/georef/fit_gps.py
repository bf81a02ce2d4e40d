# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit the similarity that aligns the cameras with the GPS positions of their photos."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.georef.gps import GpsPosition
from mgf_engine.georef.options import GpsFitOptions
from mgf_engine.georef.similarity import (
    LINE,
    Direction,
    find_inliers,
    refine_similarity,
    straightness,
    transform_points,
    umeyama,
)

Array = NDArray[np.float64]
MIN_GPS_POSITIONS = 4  # positions: three give a similarity, the fourth checks it


@dataclass(frozen=True)
class GpsFit:
    """Cameras aligned to their GPS positions.

    Attributes:
        matrix: similarity [4, 4] to metres.
        used: the positions that agree, bool [N].
        residuals: camera less place, [N, 3].
    """

    matrix: Array
    used: NDArray[np.bool_]
    residuals: Array

    @property
    def rms(self) -> Array:
        """Root mean square of the used residuals, [3]."""
        return np.asarray(np.sqrt((self.residuals[self.used] ** 2).mean(0)))


def fit_gps(
    centres: Array,
    targets: Array,
    positions: list[GpsPosition],
    up: Direction,
    options: GpsFitOptions = GpsFitOptions(),
) -> GpsFit | str:
    """Fit the similarity from camera centres to the GPS of their photos.

    Args:
        centres: of the cameras [N, 3], normalised frame.
        targets: their GPS positions [N, 3], metres.
        positions: the same as the photos give them, for their accuracy.
        up: a direction of the cameras' frame that is up.
        options: limits of the fit.

    Returns:
        The fit, or why there is none, as the end of a sentence.
    """
    if len(positions) < MIN_GPS_POSITIONS:
        return f"only {len(positions)} photos have one"
    sd = np.array([[p.sd[0], p.sd[0], p.sd[1]] for p in positions])
    known = np.array([p.has_height for p in positions])
    if known.sum() < MIN_GPS_POSITIONS:
        return "they have no heights"
    if straightness(targets[known] * (1, 1, 0)) < LINE:
        return "they lie on a line"
    tolerance = options.outlier * np.sqrt((sd**2).sum(1))
    for wider in options.widening:
        good = np.zeros(len(positions), bool)
        good[known] = find_inliers(centres[known], targets[known], wider * tolerance[known])
        if good.sum() >= max(MIN_GPS_POSITIONS, options.agreeing * known.sum()):
            break
    else:
        return "they contradict the cameras"
    return _checked(centres, targets, sd, good, up, options.least_spread)


def _checked(
    centres: Array, targets: Array, sd: Array, good: NDArray[np.bool_], up: Direction, least_spread: float
) -> GpsFit | str:
    """Refine a fit by the accuracies, and check that it is well determined.

    Args:
        centres: of the cameras, [N, 3].
        targets: their GPS positions, metres, [N, 3].
        sd: accuracies of these, [N, 3].
        good: which of them agree, bool [N].
        up: a direction of the cameras' frame that is up.
        least_spread: minimum spread of the positions across their main direction, in standard errors.

    Returns:
        The fit, or why there is none, as the end of a sentence.
    """
    matrix = umeyama(centres[good], targets[good])
    for _ in range(2):  # once with what photos say of their accuracy, once with what it turned out to be
        matrix = refine_similarity(matrix, centres[good], targets[good], sd[good], up)
        residuals = transform_points(matrix, centres) - targets
        worse = float(np.sqrt(((residuals[good] / sd[good]) ** 2).mean()))
        sd = sd * max(1.0, worse)
    level = (targets[good] - targets[good].mean(0))[:, :2]
    across = float(np.linalg.svd(level, compute_uv=False)[1]) / np.sqrt(good.sum())
    off = float(np.sqrt((residuals[good][:, :2] ** 2).sum(1).mean() / good.sum()))
    if across < least_spread * off:
        return "they lie too near to each other, or on a line, for how far they are off"
    turned = matrix[:3, :3] @ up.source
    if turned[2] < 0:
        return "the building would stand on its head"
    return GpsFit(matrix, good, residuals)
