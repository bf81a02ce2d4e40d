# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest

from mgf_engine.masks.propagation.appearance import ROWS, fit_mixture, log_ratio


def features(count: int) -> np.ndarray:
    """Two materials, bright and smooth, dark and rough."""
    rng = np.random.default_rng(0)
    middle = np.where(np.arange(count)[:, None] % 2 == 0, [80, 0, 5, 0.2, 0.2, 0.1], [30, -5, 10, 1.5, 1.2, 2.0])
    return middle + rng.normal(size=(count, 6)) * [6, 2, 2, 0.2, 0.2, 0.3]


def test_densities_are_those_of_the_components():
    x = features(ROWS + 50) / 3  # more than one block
    mixture = fit_mixture(x, np.ones(len(x)), 5, 0, np.ones(6))
    assert mixture is not None
    wanted = np.empty((len(x), len(mixture.means)))
    for k, mean in enumerate(mixture.means):
        z = (x - mean) @ mixture.roots[k].T
        wanted[:, k] = mixture.log_weights[k] + mixture.log_norms[k] - 0.5 * (z * z).sum(1)
    assert mixture.terms(x) == pytest.approx(wanted, rel=1e-9, abs=1e-9)
    assert mixture.log_density(x) == pytest.approx(np.logaddexp.reduce(wanted, axis=1), rel=1e-9, abs=1e-9)


def test_materials_are_told_apart_and_unknown_materials_have_no_odds():
    x = features(400)
    bright = fit_mixture(x, (np.arange(400) % 2 == 0).astype(float), 4, 0)
    dark = fit_mixture(x, (np.arange(400) % 2 == 1).astype(float), 4, 0)
    ratio = log_ratio(x, bright, dark)
    assert ((ratio > 0) == (np.arange(400) % 2 == 0)).mean() > 0.99
    assert log_ratio(np.full((1, 6), 500.0), bright, dark) == pytest.approx(0, abs=1e-6)
    assert not log_ratio(x, None, dark).any()
