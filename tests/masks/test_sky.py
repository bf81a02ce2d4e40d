# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky beside a wall of the same colour, and plain walls that are no sky."""

import numpy as np

from mgf_engine.masks.regions import cut_regions
from mgf_engine.masks.sky import find_sky


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
