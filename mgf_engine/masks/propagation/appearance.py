# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour and texture models of building and background, shared by all photos of a scene.

Each class is a Gaussian mixture over the features of regions. The result is the log-likelihood ratio, which fades to
zero for regions that resemble neither class.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter

#: Expected scatter of each feature within one material; keeps components from collapsing onto few samples.
FEATURE_SCALE = np.array([6.0, 2.5, 2.5, 0.25, 0.25, 0.3])
ROWS = 16_384  # samples looked at together: what fits the cache


@dataclass(frozen=True)
class AppearanceOptions:
    """Options of the models of colour and texture."""

    building: int = parameter(8, "Maximum number of Gaussians that model the building", low=1)
    background: int = parameter(10, "Maximum number of Gaussians that model what is not the building", low=1)
    samples: int = parameter(5000, "Maximum number of regions or points that a mixture is fitted to", low=100)
    least_samples: int = parameter(12, "Minimum number of regions or points for each Gaussian", low=2)
    rounds: int = parameter(8, "Number of rounds of expectation maximisation")
    prior: float = parameter(
        6.0, "Weight of the expected scatter in the covariance of each Gaussian, in regions or points", low=1e-3
    )
    unseen: float = parameter(
        12.0, "Negative log-likelihood, over that of the middle of a Gaussian of the expected scatter, from which a "
        "region is like nothing that was seen"
    )  # fmt: skip


@dataclass(frozen=True)
class Mixture:
    """Weighted Gaussians with full covariances, over features divided by :data:`FEATURE_SCALE`."""

    log_weights: NDArray[np.float64]  # [K]
    means: NDArray[np.float64]  # [K, F]
    roots: NDArray[np.float64]  # [K, F, F], inverse Cholesky factors
    log_norms: NDArray[np.float64]  # [K]

    def log_density(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute log p(x) for scaled features [N, F] -> [N]."""
        starts = range(0, max(1, len(x)), ROWS)
        return np.concatenate([_log_sum(self.terms(x[start : start + ROWS])) for start in starts])

    def terms(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return log(weight_k p_k(x)), [N, K]."""
        # Written out as a polynomial of second degree in x, all components are one product of matrices.
        precision = np.einsum("kji,kjl->kil", self.roots, self.roots)
        first, second = np.triu_indices(x.shape[1])
        square = -np.where(first == second, 0.5, 1.0) * precision[:, first, second]
        linear = np.einsum("kij,kj->ki", precision, self.means)
        constant = self.log_weights + self.log_norms - 0.5 * np.einsum("ki,ki->k", linear, self.means)
        factors = np.concatenate([square, linear], axis=1).T
        result = np.empty((len(x), len(self.means)))
        for start in range(0, len(x), ROWS):
            part = x[start : start + ROWS]
            powers = np.concatenate([part[:, first] * part[:, second], part], axis=1)
            np.matmul(powers, factors, out=result[start : start + ROWS])
        return result + constant


def fit_mixture(
    features: NDArray[np.floating],
    weights: NDArray[np.floating],
    components: int,
    seed: int,
    scale: NDArray[np.float64] = FEATURE_SCALE,
    options: AppearanceOptions = AppearanceOptions(),
) -> Mixture | None:
    """Fit a mixture by expectation maximisation on weighted samples; None where too few of them carry weight.

    Args:
        features: [N, F] unscaled.
        weights: [N], at least 0.
        components: how many Gaussians at most.
        seed: of the sampling and the start.
        scale: [F], what each feature is divided by.
        options: numbers of samples and rounds, and the prior of the covariances.
    """
    keep = np.flatnonzero(weights > 1e-3)
    if len(keep) < options.least_samples:
        return None
    rng = np.random.default_rng(seed)
    if len(keep) > options.samples:
        keep = rng.choice(keep, options.samples, replace=False, p=weights[keep] / weights[keep].sum())
        weight = np.ones(len(keep))
    else:
        weight = weights[keep].astype(np.float64)
    x = features[keep] / scale
    components = max(1, min(components, len(keep) // options.least_samples))
    cv2.setRNGSeed(seed)
    _, assigned, _ = cv2.kmeans(
        x.astype(np.float32), components, np.zeros((len(x), 1), np.int32), (cv2.TERM_CRITERIA_MAX_ITER, 12, 0), 1,
        cv2.KMEANS_PP_CENTERS,
    )  # fmt: skip
    share = np.zeros((len(x), components))
    share[np.arange(len(x)), assigned.ravel()] = 1
    mixture = _maximise(x, share * weight[:, None], options.prior)
    for _ in range(options.rounds):
        terms = mixture.terms(x)
        share = np.exp(terms - _log_sum(terms)[:, None])
        mixture = _maximise(x, share * weight[:, None], options.prior)
    return mixture


def _log_sum(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the log of the sum of exp(terms) along the second axis, [N]."""
    most = terms.max(axis=1)
    return most + np.log(np.exp(terms - most[:, None]).sum(axis=1))


def _maximise(x: NDArray[np.float64], share: NDArray[np.float64], prior: float) -> Mixture:
    mass = share.sum(0) + 1e-6
    means = (share.T @ x) / mass[:, None]
    dim = x.shape[1]
    roots, norms = np.empty((len(mass), dim, dim)), np.empty(len(mass))
    for k in range(len(mass)):
        d = x - means[k]
        # A few pseudo-samples of the expected scatter keep small components from collapsing.
        cov = ((share[:, k, None] * d).T @ d + prior * np.eye(dim)) / (mass[k] + prior)
        root = np.linalg.inv(np.linalg.cholesky(cov))
        roots[k], norms[k] = root, np.log(np.abs(np.diag(root))).sum() - 0.5 * dim * np.log(2 * np.pi)
    return Mixture(np.log(mass / mass.sum()), means, roots, norms)


def log_ratio(
    features: NDArray[np.floating],
    building: Mixture | None,
    background: Mixture | None,
    scale: NDArray[np.float64] = FEATURE_SCALE,
    threads: int = 1,
    options: AppearanceOptions = AppearanceOptions(),
) -> NDArray[np.float64]:
    """Compute log p(x | building) - log p(x | background) for features [N, F] -> [N]; 0 if both are very unlikely.

    Args:
        features: [N, F].
        building: mixture of the building; None where nothing is known of it.
        background: mixture of the background.
        scale: of the features, [F].
        threads: number of worker threads.
        options: from where on a region is like nothing that was seen.
    """
    if building is None or background is None:
        return np.zeros(len(features))
    x = features / scale
    stranger = -0.5 * x.shape[1] * np.log(2 * np.pi) - options.unseen
    models = building, background
    first, second = parallel_map(lambda k: np.logaddexp(models[k].log_density(x), stranger), range(2), threads)
    return first - second


def vegetation_probability(features: NDArray[np.floating]) -> NDArray[np.float64]:
    """Rate regions as leaves and grass, green or yellow-green and not smooth; features [N, F] -> 0..1."""
    green, yellow, texture = features[:, 1], features[:, 2], features[:, 3]
    color = np.clip((-green - 3) / 6, 0, 1) * np.clip((yellow - 2) / 6, 0, 1)
    return color * np.clip((texture - 0.6) / 0.5, 0, 1)
