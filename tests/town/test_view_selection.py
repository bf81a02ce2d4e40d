# SPDX-License-Identifier: GPL-3.0-or-later
"""Which photos are chosen for a building of a town: those that see it, near and face on, each for what it adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapely
from support.analytic import camera
from support.small_scene import make_scene

from mgf_engine.georef.model import Georeference
from mgf_engine.model.scene import View
from mgf_engine.town.clicks import suggest_clicks
from mgf_engine.town.hulls import Hull
from mgf_engine.town.view_selection import BuildingViewOptions, HullScene, choose_photos, small_view

HOUSE = Hull("house", shapely.box(-1, -1, 1, 1), 0.0, 2.0, 50)
#: Before the house as the camera in the south sees it, and higher.
TOWER = Hull("tower", shapely.box(-1.5, -4, 1.5, -3), 0.0, 6.0, 50)
OPTIONS = BuildingViewOptions(spacing=0.5, least_share=0.002)


def around(count: int, radius: float = 8.0) -> list[View]:
    """Cameras on a circle, the first in the east, that look at the house."""
    angles = 2 * np.pi * np.arange(count) / count
    return [camera((radius * np.cos(a), radius * np.sin(a), 2.5), (0, 0, 1), name=f"{a:.3f}.png") for a in angles]


def town(views: Sequence[View], hulls: Sequence[Hull] = (HOUSE,)) -> HullScene:
    scene = make_scene(list(views), np.zeros((0, 3)), [])
    return HullScene.draw(scene, Georeference(), 1.0, np.zeros((0, 3)), hulls, OPTIONS)


def test_a_house_that_no_photo_shows_has_none() -> None:
    away = [camera((8.0, 0.0, 2.0), (16.0, 0.0, 2.0)), camera((0.0, 8.0, 2.0), (0.0, 16.0, 2.0))]
    found = choose_photos(town(away), 0, 5, OPTIONS)
    assert (found.photos, found.share, found.seen, found.candidates) == ([], 0.0, 0.0, 0)


def test_where_no_photo_shows_a_house_no_clicks_are_suggested() -> None:
    away = town([camera((8.0, 0.0, 2.0), (16.0, 0.0, 2.0))] * 3)
    assert suggest_clicks(away, 0, choose_photos(away, 0, 5, OPTIONS)) == {}


def test_all_photos_of_a_ring_are_candidates_and_at_most_so_many_are_taken() -> None:
    found = choose_photos(town(around(8)), 0, 5, OPTIONS)
    assert found.candidates == 8 and len(found.photos) == len(set(found.photos)) == 5
    assert found.seen == pytest.approx(0.8)  # all walls; the roof is seen too flat
    assert sorted(choose_photos(town(around(8)), 0, 50, OPTIONS).photos) == list(range(8))


def test_the_second_photo_shows_the_side_that_the_first_does_not() -> None:
    """Two cameras in the east, one in the west, as far away as they are."""
    east = [camera((8.0, y, 2.5), (0, 0, 1)) for y in (0.0, 0.2)]
    found = choose_photos(town([*east, camera((-8.0, 0.0, 2.5), (0, 0, 1))]), 0, 2, OPTIONS)
    assert 2 in found.photos and len(found.photos) == 2


def test_a_side_that_was_shown_counts_less_each_time() -> None:
    """Three cameras in the east, nearer than the one in the west."""
    east = [camera((7.0, y, 2.5), (0, 0, 1)) for y in (0.0, 0.1, 0.2)]
    views = [*east, camera((-7.5, 0.0, 2.5), (0, 0, 1))]
    assert 3 in choose_photos(town(views), 0, 2, OPTIONS).photos
    every = replace(OPTIONS, decay=1.0)
    assert 3 not in choose_photos(town(views), 0, 2, every).photos


def test_a_near_photo_comes_before_one_from_far_away() -> None:
    views = [camera((20.0, 0.0, 2.5), (0, 0, 1)), camera((7.0, 0.0, 2.5), (0, 0, 1))]
    assert choose_photos(town(views), 0, 2, OPTIONS).photos == [1, 0]


def test_the_size_of_a_pixel_and_the_share_of_the_photo_are_those_of_the_projection() -> None:
    view = camera((8.0, 0.0, 1.0), (0, 0, 1))
    found = choose_photos(town([view]), 0, 1, OPTIONS)
    assert found.pixel == pytest.approx(7 / view.fx, rel=0.05)  # of the wall, 7 m away
    # The hull begins 0.3 m below the ground.
    assert found.share == pytest.approx(2.3 / 7 * view.fy * 2 / 7 * view.fx / (view.width * view.height), rel=0.05)
    assert found.seen == 0.0  # no spot is seen twice


def test_what_another_house_hides_does_not_count() -> None:
    """From the south, 8 m away, the tower hides the house."""
    south = camera((0.0, -8.0, 1.5), (0, 0, 1))
    assert choose_photos(town([south]), 0, 1, OPTIONS).photos == [0]
    hidden = choose_photos(town([south], (HOUSE, TOWER)), 0, 1, OPTIONS)
    assert hidden.photos == [] and hidden.candidates == 0
    assert choose_photos(town([south], (HOUSE, TOWER)), 1, 1, OPTIONS).photos == [0]


@pytest.mark.parametrize(("height", "photos"), [(4.0, 5), (1.0, 0)])
def test_a_part_inside_another_footprint_is_seen_where_it_rises_above(height: float, photos: int) -> None:
    """Maps have towers within buildings, and buildings twice."""
    hall, part = (Hull(str(s), shapely.box(-s, -s, s, s), 0.0, z, 50) for s, z in ((2.0, 2.0), (0.5, height)))
    assert len(choose_photos(town(around(8), (hall, part)), 1, 5, OPTIONS).photos) == photos


@pytest.mark.parametrize(("gap", "asked_for"), [(0.0, 64), (0.5, 64), (1.5, 80)])
def test_a_wall_close_to_a_neighbour_is_not_asked_for(gap: float, asked_for: int) -> None:
    """Two level cameras before each of three walls, a neighbour before the fourth; all have 16 spots."""
    pairs = [(-1, 0.02), (-1, -0.02), (0.02, -1), (-0.02, -1), (0.02, 1), (-0.02, 1)]
    views = [camera((8 * x, 8 * y, 1.0), (0, 0, 1)) for x, y in pairs]
    row = (HOUSE, Hull("neighbour", shapely.box(1 + gap, -3, 3 + gap, 3), 0.0, 2.0, 50))
    assert choose_photos(town(views, row), 0, 6, OPTIONS).seen == pytest.approx(3 * 16 / asked_for)


def test_pictures_of_large_photos_are_drawn_smaller() -> None:
    view = camera((8.0, 0.0, 1.0), width=960, height=640, focal=900.0)
    small, factor = small_view(view, BuildingViewOptions(picture_side=480))
    assert factor == 0.5 and (small.width, small.height, small.fx) == (480, 320, 450.0)
    assert small_view(small, BuildingViewOptions(picture_side=480)) == (small, 1.0)
