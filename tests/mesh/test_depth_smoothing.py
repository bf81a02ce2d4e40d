# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoothing of depth maps: noise goes, planes stay planes, creases and relief stay where photos are sure."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.mesh import reference_depth_smoothing as reference
from mgf_engine.mesh.depth_smoothing import SmoothingOptions, smooth_depth, smooth_map
from mgf_engine.mesh.photometric import Matched
from mgf_engine.native.library import runnable_variants, use_variant

SIZE, PARALLAX = 60, 0.01  # pixels; relative change of the inverse depth that is one of parallax
ROWS, COLUMNS = np.mgrid[:SIZE, :SIZE].astype(np.float64)
SLANTED = 0.2 + 1e-4 * COLUMNS - 2e-4 * ROWS  # inverse depth of a plane


def smoothed(inverse: np.ndarray, precision: np.ndarray | float = 4.0, **options: float) -> np.ndarray:
    depth = np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1), 0).astype(np.float32)
    precise = np.zeros(depth.shape, np.float32) + np.float32(precision)
    parallax = np.full(depth.shape, PARALLAX, np.float32)
    matched = Matched(depth, np.ones_like(depth), precise, parallax)
    return smooth_depth(depth, matched, SmoothingOptions(**options)).astype(np.float64)  # type: ignore[arg-type]


def pixels_off(depth: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Difference to an inverse depth in pixels of parallax."""
    return (1 / depth - inverse) / (PARALLAX * np.median(inverse))


def noise(sigma: float) -> np.ndarray:
    return sigma * PARALLAX * SLANTED * np.random.default_rng(0).normal(size=SLANTED.shape)


def test_a_slanted_plane_stays_and_its_noise_goes() -> None:
    np.testing.assert_allclose(pixels_off(smoothed(SLANTED), SLANTED), 0, atol=2e-4)
    off = pixels_off(smoothed(SLANTED + noise(0.2)), SLANTED)
    assert off.std() < 0.25 * 0.2
    assert np.abs(off).max() < 0.2


def test_depths_that_no_photo_tells_follow_their_neighbours() -> None:
    dented = SLANTED.copy()
    dented[20:28, 20:28] -= 0.5 * PARALLAX * dented[20:28, 20:28]
    precision = np.where((ROWS >= 20) & (ROWS < 28) & (COLUMNS >= 20) & (COLUMNS < 28), 0.0, 4.0)
    assert np.abs(pixels_off(smoothed(dented, precision, steps=60), SLANTED)).max() < 0.2  # of 0.5


@pytest.mark.parametrize("shape", ["step", "roof"])
def test_relief_that_photos_tell_stays(shape: str) -> None:
    rise = np.where(COLUMNS < SIZE / 2, 0.0, 1.0) if shape == "step" else 0.3 * np.abs(COLUMNS - SIZE / 2)
    relief = SLANTED * (1 + PARALLAX * rise)
    off = np.abs(pixels_off(smoothed(relief, 40.0), relief))
    assert off.max() < 0.2
    assert np.median(off) < 0.02


def test_surfaces_apart_do_not_pull_at_each_other() -> None:
    apart = np.where(COLUMNS < SIZE / 2, SLANTED, 1.5 * SLANTED)
    np.testing.assert_allclose(pixels_off(smoothed(apart), apart), 0, atol=2e-3)


def test_without_a_surface_or_any_match_nothing_changes() -> None:
    np.testing.assert_array_equal(smoothed(SLANTED + noise(0.2), 0.0), (1 / (SLANTED + noise(0.2))).astype(np.float32))
    empty = np.zeros_like(SLANTED)
    assert not smoothed(empty).any()
    few = np.where((ROWS == 30) & (COLUMNS < 2), SLANTED, 0)
    np.testing.assert_allclose(smoothed(few)[few > 0], 1 / few[few > 0], rtol=1e-6)


def test_it_minimises_what_it_says() -> None:
    """Conjugate gradients against a dense solution of the same least squares, float64."""
    small = slice(0, 8)
    inverse = (SLANTED + noise(0.3))[small, small]
    found = 1 / smoothed(inverse, 2.0, rounds=1, steps=200, jump=100.0)
    scale = PARALLAX * np.median(inverse)
    x = (1 / (1 / inverse).astype(np.float32).astype(np.float64) / scale).ravel()
    system, target = [np.sqrt(2.0) * np.eye(64)], [np.sqrt(2.0) * x]
    for axis in (0, 1):
        numbers = np.moveaxis(np.arange(64).reshape(8, 8), axis, 0)
        for a, b, c in zip(numbers[:-2].ravel(), numbers[1:-1].ravel(), numbers[2:].ravel(), strict=True):
            row = np.zeros(64)
            row[[a, b, c]] = 1, -2, 1
            weight = 20.0 / np.sqrt(1 + (row @ x / 0.15) ** 2)
            system.append(np.sqrt(weight) * row[None])
            target.append(np.zeros(1))
    expected = np.linalg.lstsq(np.concatenate(system), np.concatenate(target), rcond=None)[0]
    np.testing.assert_allclose(found.ravel() / scale, expected, atol=3e-3)


@pytest.mark.parametrize("variant", runnable_variants())
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (33, 47), (20, 64)])
def test_the_kernel_agrees_with_its_reference(variant: str, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    target = 300 + rng.normal(size=shape) + np.where(np.arange(shape[1]) > shape[1] // 2, 4.0, 0.0)
    weight = np.where(rng.random(shape) < 0.1, 0.0, rng.uniform(0.1, 5, shape))
    joined = rng.random((max(shape[0] - 2, 0), shape[1])) < 0.9, rng.random((shape[0], max(shape[1] - 2, 0))) < 0.9
    use_variant(variant)
    try:
        found = smooth_map(weight.astype(np.float32), target.astype(np.float32), joined, 20.0, 0.15, 3, 12)
    finally:
        use_variant("")
    expected = reference.smooth_map(weight, target, joined, 20.0, 0.15, 3, 12)
    np.testing.assert_allclose(found, expected, atol=1e-3)
