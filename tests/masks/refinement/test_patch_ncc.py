# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that compares patches, held against the same written with NumPy and OpenCV's blurs: to the bit."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mgf_engine.masks.image_ops import color_distance
from mgf_engine.masks.refinement.ground_homography import GroundHomographyOptions
from mgf_engine.masks.refinement.patch_ncc import PATCH, Map, Patches

TEXTURE = GroundHomographyOptions.texture


def mean(image: Map) -> Map:
    return np.asarray(cv2.blur(image, (PATCH, PATCH)), np.float32)


def correlation(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> Map:
    """Of the patches of two pictures of lightness, 0 where there is no texture."""
    a, b = (image.astype(np.float32) * np.float32(100 / 255) for image in (first, second))
    variances = [mean(image**2) - mean(image) ** 2 for image in (a, b)]
    shared = mean(a * b) - mean(a) * mean(b)
    enough = (variances[0] > TEXTURE) & (variances[1] > TEXTURE)
    return np.where(enough, shared / np.sqrt(np.maximum(variances[0] * variances[1], TEXTURE**2)), 0)


def smooth(lab: NDArray[np.uint8]) -> Map:
    return np.asarray(cv2.transform(cv2.blur(lab, (3, 3)).astype(np.float32), np.diag([100 / 255, 1, 1])), np.float32)


def best_of(maps: list[Map], count: int) -> Map:
    """Mean over the best."""
    return np.asarray((-np.sort(-np.stack(maps), axis=0)[:count]).sum(0) / count, np.float32)


def pictures(size: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """One picture and four like it, the more so the earlier, with an even part."""
    rng = np.random.default_rng(size[0])
    base = cv2.GaussianBlur(rng.uniform(0, 255, (*size, 3)).astype(np.float32), (0, 0), 1.2)
    base = np.clip(128 + 4 * (base - 128), 0, 255)
    base[:, : size[1] // 4] = 90
    return [np.clip(base + rng.normal(0, 1 + 12 * k, base.shape), 0, 255).astype(np.uint8) for k in range(5)]


def spans(size: tuple[int, int], seed: int) -> NDArray[np.int32]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, size[1] + 1, (size[0], 2)).astype(np.int32)


def inside(seen: NDArray[np.int32], width: int) -> NDArray[np.bool_]:
    return (np.arange(width) >= seen[:, :1]) & (np.arange(width) < seen[:, 1:])


@pytest.mark.parametrize("size", [(40, 61), (33, 128), (1, 1), (2, 3), (1, 40), (17, 1)])
def test_the_best_are_those_of_the_plain_sums(size: tuple[int, int]) -> None:
    own, *others = pictures(size)
    seen = np.stack([spans(size, number) for number in range(len(others))])
    expected: dict[str, list[Map]] = {"fits": [], "colours": [], "alone": []}
    for other, rows in zip(others, seen, strict=True):
        shown = inside(rows, size[1])
        found = np.where(shown, correlation(own[..., 0], other[..., 0]), np.float32(-1))
        away = color_distance(smooth(own), smooth(other))
        expected["alone"].append(found)
        expected["fits"].append(np.where(away < 12, found, np.minimum(found, 0)))
        expected["colours"].append(np.where(shown, -away, np.float32(-255)))
    patches, labs = Patches(own), np.stack(others)
    fits, colors, alone = patches.compare(labs, seen, 3, 12.0, 3, 2)
    np.testing.assert_array_equal(fits, best_of(expected["fits"], 3))
    np.testing.assert_array_equal(colors, best_of(expected["colours"], 3))
    np.testing.assert_array_equal(alone, best_of(expected["alone"][1:], 2))
    light = patches.correlate(np.ascontiguousarray(labs[..., 0]), seen, 4)
    np.testing.assert_array_equal(light, best_of(expected["alone"], 4))


def test_a_picture_is_like_itself_and_nothing_is_more_unlike_than_its_negative() -> None:
    own = pictures((40, 60))[0]
    every = np.tile(np.array([0, 60], np.int32), (1, 40, 1))
    light = np.ascontiguousarray(own[..., 0])[None]
    same, other = (Patches(own).correlate(picture, every, 1) for picture in (light, 255 - light))
    textured = same != 0
    assert textured.mean() > 0.6 and same[textured] == pytest.approx(1, abs=1e-4)
    assert other[textured] == pytest.approx(-1, abs=1e-4)
