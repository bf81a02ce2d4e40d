# SPDX-License-Identifier: GPL-3.0-or-later
"""PSNR and SSIM inside a mask, against values worked out by hand and against a second implementation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import correlate1d

from mgf_engine.evaluation.images import PSNR_LIMIT, mean_scores, score, ssim_map


@pytest.fixture
def photo() -> np.ndarray:
    random = np.random.default_rng(0)
    coarse = random.integers(0, 256, (6, 8, 3)).repeat(8, 0).repeat(8, 1)
    return (0.7 * coarse + 0.3 * random.integers(0, 256, (48, 64, 3))).astype(np.uint8)


@pytest.fixture
def mask() -> np.ndarray:
    result = np.zeros((48, 64), bool)
    result[10:40, 12:50] = True
    return result


def test_equal_pictures(photo: np.ndarray, mask: np.ndarray) -> None:
    scores = score(photo, photo, mask)
    assert scores.psnr == scores.psnr_frame == PSNR_LIMIT
    assert scores.ssim == pytest.approx(1.0) and scores.ssim_frame == pytest.approx(1.0)
    assert scores.pixels == 30 * 38 and scores.lpips is None


def test_only_the_mask_counts(photo: np.ndarray, mask: np.ndarray) -> None:
    random = np.random.default_rng(1)
    noise = random.integers(0, 256, photo.shape).astype(np.uint8)
    render = np.where(mask[..., None], photo, noise)
    assert score(photo, render, mask).psnr == PSNR_LIMIT
    assert score(photo, render, mask).ssim == pytest.approx(1.0)
    assert score(photo, render, ~mask).psnr == pytest.approx(score(photo, noise, ~mask).psnr)


def test_psnr_by_hand(mask: np.ndarray) -> None:
    a = np.full((48, 64, 3), 100, np.uint8)
    b = a.copy()
    b[mask] = 110
    scores = score(a, b, mask)
    assert scores.psnr == pytest.approx(-20 * math.log10(10 / 255))
    share = mask.mean()
    assert scores.psnr_frame == pytest.approx(-20 * math.log10(10 / 255) - 10 * math.log10(share))


def test_ssim_against_a_second_implementation(photo: np.ndarray) -> None:
    """The same formula with SciPy's filters, on luminance-like channels one by one."""
    random = np.random.default_rng(2)
    a = photo / 255.0
    b = np.clip(a + random.normal(0, 0.1, a.shape), 0, 1)
    x = np.arange(-5, 6)
    window = np.exp(-(x**2) / (2 * 1.5**2))
    window /= window.sum()

    def mean(image: np.ndarray) -> np.ndarray:
        return correlate1d(correlate1d(image, window, axis=0, mode="mirror"), window, axis=1, mode="mirror")

    expected = np.zeros(a.shape)
    for k in range(3):
        p, q = a[..., k], b[..., k]
        mp, mq = mean(p), mean(q)
        vp, vq, cov = mean(p * p) - mp**2, mean(q * q) - mq**2, mean(p * q) - mp * mq
        top = (2 * mp * mq + 1e-4) * (2 * cov + 9e-4)
        expected[..., k] = top / ((mp**2 + mq**2 + 1e-4) * (vp + vq + 9e-4))
    assert np.abs(ssim_map(a, b) - expected.mean(-1)).max() < 1e-9


def test_worse_is_worse(photo: np.ndarray, mask: np.ndarray) -> None:
    random = np.random.default_rng(3)
    previous = score(photo, photo, mask)
    for level in (5, 20, 60):
        noisy = np.clip(photo + random.normal(0, level, photo.shape), 0, 255).astype(np.uint8)
        now = score(photo, noisy, mask)
        assert now.psnr < previous.psnr and now.ssim < previous.ssim
        # The whole frame counts the outside as perfect, so it flatters.
        assert now.psnr_frame > now.psnr and now.ssim_frame > now.ssim
        previous = now


def test_empty_and_full_masks(photo: np.ndarray) -> None:
    empty = score(photo, 255 - photo, np.zeros(photo.shape[:2], bool))
    assert empty.psnr is None and empty.ssim is None and empty.pixels == 0
    full = score(photo, 255 - photo, np.ones(photo.shape[:2], bool))
    assert full.psnr == pytest.approx(full.psnr_frame) and full.ssim == pytest.approx(full.ssim_frame)


def test_means_leave_out_views_without_scores(photo: np.ndarray, mask: np.ndarray) -> None:
    good = score(photo, np.roll(photo, 1, 0), mask)
    empty = score(photo, photo, np.zeros_like(mask))
    assert mean_scores([good, empty]).psnr == good.psnr
    assert mean_scores([]).psnr is None


def test_shapes_must_agree(photo: np.ndarray, mask: np.ndarray) -> None:
    with pytest.raises(ValueError, match="shapes differ"):
        score(photo, photo[:-1], mask)
    with pytest.raises(ValueError, match="shapes differ"):
        score(photo, photo, mask[:-1])
