# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of texels: weights between corners, photos at the scale wanted, gutters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.small_scene import view

from mgf_engine.texture.bake import barycentric, fill_gutters, reduce_photo, sample_photo
from mgf_engine.texture.model import Source


def test_weights_are_those_that_give_the_place_back() -> None:
    rng = np.random.default_rng(0)
    triangle, weight = rng.uniform(0, 10, (20, 3, 2)), rng.dirichlet(np.ones(3), 20)
    found = barycentric(triangle, (triangle * weight[..., None]).sum(1))
    np.testing.assert_allclose(found, weight, atol=1e-9)


def ramp(width: int, height: int) -> np.ndarray:
    """A photo whose red grows by 200 over its width and whose green by 200 over its height."""
    red, green = (200 * (np.arange(n) + 0.5) / n for n in (width, height))
    image = np.zeros((height, width, 3))
    image[..., 0], image[..., 1] = red[None], green[:, None]
    return image.round().astype(np.uint8)


@pytest.mark.parametrize("scale,width", [(1.0, 20), (2.0, 40), (3.0, 60), (8.0, 60)])
def test_photos_are_reduced_to_what_the_texture_shows(scale: float, width: int) -> None:
    photo = Source(ramp(60, 30), True)
    found = reduce_photo(view("a", 0, original_width=60, original_height=30), photo, scale)
    assert found.image.shape == (width // 2, width, 3) and found.original
    np.testing.assert_allclose(found.image[:, -1, 0], 200 * (1 - 0.5 / width), atol=2)


@pytest.mark.parametrize("width", [60, 40, 20])
@pytest.mark.parametrize("original", [True, False])
def test_a_photo_of_any_size_has_the_same_colors_at_the_same_places(width: int, original: bool) -> None:
    camera = view("a", 0, original_width=60, original_height=30)
    points = np.array([[0.0, 0.0, 1.0], [0.4, -0.2, 1.0], [-0.6, 0.3, 1.0]])  # at pixels (10, 5), (14, 3), (4, 8)
    found = sample_photo(camera, Source(ramp(width, width // 2), original), points)
    np.testing.assert_allclose(found[:, 0], [100, 140, 40], atol=2)
    np.testing.assert_allclose(found[:, 1], [100, 60, 160], atol=3)


def test_the_original_is_looked_up_in_its_own_pixels() -> None:
    wide = view("a", 0, original_width=60, original_height=60)  # twice as high as the working photo shows it
    upright = replace(wide, height=20, cy=10.0, fy=20.0)
    found = sample_photo(upright, Source(ramp(60, 60), True), np.array([[0.0, 0.25, 1.0]]))
    np.testing.assert_allclose(found[0, :2], [100, 150], atol=2)


def test_gutters_take_the_nearest_color_and_the_rest_the_mean() -> None:
    image, painted = np.zeros((5, 20, 3), np.uint8), np.zeros((5, 20), bool)
    painted[2, 3], painted[2, 19] = True, True
    image[2, 3], image[2, 19] = (200, 0, 0), (0, 100, 0)
    found = fill_gutters(image, painted, 2)
    assert found[2, 5].tolist() == [200, 0, 0] and found[2, 17].tolist() == [0, 100, 0]
    assert found[2, 9].tolist() == [100, 50, 0] and found[2, 3].tolist() == [200, 0, 0]
    assert not fill_gutters(np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), bool), 2).any()
