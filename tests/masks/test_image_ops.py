# SPDX-License-Identifier: GPL-3.0-or-later
import cv2
import numpy as np
import pytest

from mgf_engine.masks.image_ops import (
    color_distance,
    dilate,
    dilate_square,
    enlarge,
    erode,
    erode_square,
    masked_mean,
    rgb_to_lab,
)


def picture(height: int = 150, width: int = 230) -> tuple[np.ndarray, np.ndarray]:
    """A colour picture of soft spots, and a mask of a few pieces."""
    rng = np.random.default_rng(3)
    colors = cv2.resize(rng.random((8, 12, 3), np.float32) * 100, (width, height), interpolation=cv2.INTER_CUBIC)
    mask = cv2.resize(rng.random((10, 14), np.float32), (width, height), interpolation=cv2.INTER_CUBIC) > 0.6
    return np.asarray(colors, np.float32), mask


@pytest.mark.parametrize("sigma", [4.0, 13.0, 25.0])
def test_mean_is_that_of_the_whole_photo(sigma: float) -> None:
    colors, mask = picture()
    weight = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma)
    mean = cv2.GaussianBlur(colors * mask[..., None], (0, 0), sigma) / np.maximum(weight, 1e-6)[..., None]
    found = masked_mean(colors, mask, sigma)
    # At the frame, where the reduced photo is mirrored half a pixel elsewhere, they differ most.
    assert np.abs(enlarge(found.weight, mask.shape) - weight).max() < 0.03
    told = weight > 0.01
    # Values go from 0 to 100; the differences of colour that are asked for are of 4 units and more.
    away = np.abs(enlarge(found.color, mask.shape) - mean)[told]
    assert away.max() < 2.0 and away.mean() < 0.2


def test_mean_of_nothing_has_no_weight() -> None:
    colors, mask = picture()
    found = masked_mean(colors, np.zeros_like(mask), 20.0)
    assert not found.weight.any() and np.isfinite(found.color).all()


def test_distance_is_the_norm_of_the_difference() -> None:
    colors, _ = picture()
    other = colors[::-1].copy()
    assert np.allclose(color_distance(colors, other), np.linalg.norm(colors - other, axis=2), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("radius", [3, 9, 24])
def test_discs_are_those_of_morphology_but_for_the_rim(radius: int) -> None:
    _, mask = picture()
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    for found, operation in ((dilate(mask, radius), cv2.dilate), (erode(mask, radius), cv2.erode)):
        wanted = operation(mask.astype(np.uint8), kernel) > 0
        near = cv2.morphologyEx(wanted.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8)) > 0
        assert not (found ^ wanted)[~near].any()
        assert (found ^ wanted).mean() < 0.01


def test_the_frame_is_no_edge_and_nothing_stays_nothing() -> None:
    full = np.ones((20, 30), bool)
    assert erode(full, 5).all() and not erode(~full, 5).any()
    assert not dilate(~full, 5).any() and dilate(full, 5).all()
    half = full.copy()
    half[:, :15] = False
    assert erode(half, 5)[:, 22:].all() and not erode(half, 5)[:, :19].any()


@pytest.mark.parametrize("radius", [1, 3, 9])
def test_what_grows_on_one_side_shrinks_on_the_other(radius: int) -> None:
    _, mask = picture()
    assert np.array_equal(erode(mask, radius), ~dilate(~mask, radius))


def test_half_pixels_at_the_rim_belong_to_a_disc() -> None:
    dot = np.zeros((9, 9), bool)
    dot[4, 4] = True
    assert dilate(dot, 3)[4, 7] and dilate(dot, 3)[5, 7] and not dilate(dot, 3)[4, 8] and not dilate(dot, 3)[6, 7]


def test_squares_grow_and_shrink_by_their_radius_and_the_frame_is_no_edge() -> None:
    mask = np.zeros((20, 30), bool)
    mask[8:13, :10] = True
    grown, shrunk = np.zeros_like(mask), np.zeros_like(mask)
    grown[6:15, :12], shrunk[10:11, :8] = True, True
    np.testing.assert_array_equal(dilate_square(mask, 2), grown)
    np.testing.assert_array_equal(erode_square(mask, 2), shrunk)
    np.testing.assert_array_equal(dilate_square(mask, 0), mask)


def test_cielab_has_its_own_units() -> None:
    photo = np.array([[[255, 255, 255], [0, 0, 0], [255, 0, 0], [0, 0, 255]]], np.uint8)
    known = [[100, 0, 0], [0, 0, 0], [53.2, 80.1, 67.2], [32.3, 79.2, -107.9]]
    np.testing.assert_allclose(rgb_to_lab(photo)[0], known, atol=0.3)
