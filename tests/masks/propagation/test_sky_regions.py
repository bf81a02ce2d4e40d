# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky beside a wall of the same colour, and plain walls that are no sky."""

import numpy as np

from mgf_engine.masks.image_ops import rgb_to_lab
from mgf_engine.masks.propagation.sky_regions import draw_skyline, find_sky
from mgf_engine.masks.propagation.superpixels import cut_regions


def photo() -> np.ndarray:
    """White sky over a white wall with a dark eave between, on a rough lawn."""
    rng = np.random.default_rng(0)
    picture = np.full((200, 300, 3), 240, np.uint8)
    picture[90:96, 60:240] = 20
    picture[150:] = rng.integers(40, 90, (50, 300, 3))
    picture[96:150, :60] = picture[96:150, 240:] = rng.integers(40, 90, (54, 60, 3))
    return picture


def test_sky_is_found_and_the_white_wall_is_not():
    regions = cut_regions(photo())
    wall = np.stack([np.linspace(70, 230, 40), np.full(40, 120.0)], 1)
    sky = find_sky(regions, regions.at(wall))
    assert (sky[regions.at(np.array([[20.0, 10], [150, 40], [280, 60]]))] > 0).all()
    assert not sky[regions.at(wall)].any()


def test_what_holds_points_is_no_sky():
    regions = cut_regions(photo())
    rng = np.random.default_rng(1)
    everywhere = np.stack([rng.uniform(0, 300, 400), rng.uniform(0, 90, 400)], 1)
    assert not find_sky(regions, regions.at(everywhere))[regions.at(np.array([[150.0, 40]]))].any()


def test_a_pale_roof_is_no_sky_though_no_edge_parts_them():
    picture = np.full((200, 300, 3), (200, 220, 240), np.uint8)
    picture[60:150, 100:200] = (205, 228, 222)
    picture[150:] = np.random.default_rng(0).integers(40, 90, (50, 300, 3))
    regions = cut_regions(picture)
    sky = find_sky(regions, regions.at(np.array([[20.0, 180]] * 30)))
    assert sky[regions.at(np.array([[50.0, 100], [250, 20]]))].all()
    assert not sky[regions.at(np.array([[150.0, 110]]))].any()


def test_the_skyline_is_drawn_to_the_pixel():
    picture = np.full((200, 300, 3), 235, np.uint8)
    picture[80:, 60:240] = (120, 70, 50)
    picture[60:80, 100:108] = (120, 70, 50)  # a chimney
    truth = (picture == 50).any(2)
    coarse = np.zeros((200, 300), bool)
    coarse[77:, 57:243] = coarse[64:, 97:105] = True
    coarse[:77, 57:97] = coarse[:77, 105:] = False
    sky = np.zeros((200, 300), bool)
    sky[:75] = sky[:, :55] = sky[:, 245:] = True
    sky[56:80, 92:116] = False
    drawn = draw_skyline(rgb_to_lab(picture), coarse, sky)
    assert (drawn != truth).sum() < 0.15 * (coarse != truth).sum()


def test_no_skyline_without_sky():
    mask = np.zeros((200, 300), bool)
    mask[90:, 60:240] = True
    assert (draw_skyline(rgb_to_lab(photo()), mask, np.zeros((200, 300), bool)) == mask).all()


def gap_between_chimneys(building: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Photo of a roof with a deep gap between two chimneys, a mask that closes the gap, and the sky's regions above."""
    picture = np.full((200, 300, 3), (228, 238, 250), np.uint8)
    picture[80:, 40:260] = building
    picture[40:80, 110:130] = picture[40:80, 146:166] = building
    mask = np.zeros((200, 300), bool)
    mask[80:, 40:260] = mask[40:80, 110:166] = True
    sky = np.zeros((200, 300), bool)
    sky[:38] = True
    return picture, mask, sky


def test_the_sky_between_two_chimneys_is_followed_down():
    picture, mask, sky = gap_between_chimneys((90, 80, 75))
    drawn = draw_skyline(rgb_to_lab(picture), mask, sky)
    assert not drawn[42:78, 132:144].any()
    assert (drawn == (mask & (picture == 80).any(2))).mean() > 0.99


def test_a_wall_nearly_as_bright_as_the_sky_is_not_followed_down():
    picture, mask, sky = gap_between_chimneys((205, 212, 220))
    assert draw_skyline(rgb_to_lab(picture), mask, sky)[60:78, 132:144].all()
