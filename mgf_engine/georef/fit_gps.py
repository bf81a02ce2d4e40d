# SPDX-License-Identifier: GPL-3.0-or-later
"""From the places that photos were taken at to the similarity that lays the cameras there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.georef.gps import Place
from mgf_engine.georef.similarity import LINE, Direction, adjusted, applied, consensus, straightness, umeyama

Array = NDArray[np.float64]
FEWEST = 4  # places
_TOLERANCE = 4.0  # times the accuracy that a place may be off
_WIDER = (1.0, 2.0, 4.0)  # what photos tell of their accuracy is often too good
_AGREE = 0.6  # share of the places that must agree
_LEAST_SPREAD = 2.0  # of the places across, in units of their error


@dataclass(frozen=True)
class GpsFit:
    """Cameras laid onto their GPS.

    Attributes:
        matrix: similarity [4, 4] to metres.
        used: the places that agree, bool [N].
        residuals: camera less place, [N, 3].
    """

    matrix: Array
    used: NDArray[np.bool_]
    residuals: Array

    @property
    def rms(self) -> Array:
        """Root mean square of the used residuals, [3]."""
        return np.asarray(np.sqrt((self.residuals[self.used] ** 2).mean(0)))


def fit_gps(centres: Array, targets: Array, places: list[Place], up: Direction) -> GpsFit | str:
    """Lay camera centres [N, 3] onto their GPS.

    Args:
        targets: the places in metres, [N, 3].
        places: the same as the photos say them, for their accuracy.
        up: a direction of the cameras' frame that is up.

    Returns:
        The fit, or why there is none, as the end of a sentence.
    """
    if len(places) < FEWEST:
        return f"only {len(places)} photos have one"
    sd = np.array([[p.sd[0], p.sd[0], p.sd[1]] for p in places])
    known = sd[:, 2] < 1e3
    if known.sum() < FEWEST:
        return "they have no heights"
    if straightness(targets[known] * (1, 1, 0)) < LINE:
        return "they lie on a line"
    tolerance = _TOLERANCE * np.sqrt((sd**2).sum(1))
    for wider in _WIDER:
        good = np.zeros(len(places), bool)
        good[known] = consensus(centres[known], targets[known], wider * tolerance[known])
        if good.sum() >= max(FEWEST, _AGREE * known.sum()):
            break
    else:
        return "they contradict the cameras"
    return _checked(centres, targets, sd, good, up)


def _checked(centres: Array, targets: Array, sd: Array, good: NDArray[np.bool_], up: Direction) -> GpsFit | str:
    matrix = umeyama(centres[good], targets[good])
    for _ in range(2):  # once with what photos say of their accuracy, once with what it turned out to be
        matrix = adjusted(matrix, centres[good], targets[good], sd[good], up)
        residuals = applied(matrix, centres) - targets
        worse = float(np.sqrt(((residuals[good] / sd[good]) ** 2).mean()))
        sd = sd * max(1.0, worse)
    level = (targets[good] - targets[good].mean(0))[:, :2]
    across = float(np.linalg.svd(level, compute_uv=False)[1]) / np.sqrt(good.sum())
    off = float(np.sqrt((residuals[good][:, :2] ** 2).sum(1).mean() / good.sum()))
    if across < _LEAST_SPREAD * off:
        return "they lie too near to each other, or on a line, for how far they are off"
    turned = matrix[:3, :3] @ up.source
    if turned[2] < 0:
        return "the building would stand on its head"
    return GpsFit(matrix, good, residuals)
