# SPDX-License-Identifier: GPL-3.0-or-later
"""A wall whose fine texture aliases: every photo shows another pattern of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.moire import CENTRES, DISTANCE, STEREO, add_mirror_image, add_moire
from support.wall import make_wall

from mgf_engine.masks.geometry.densify_points import DensifyOptions, densify_points
from mgf_engine.model.scene import Scene
from mgf_engine.scene.coarse_stereo import (
    CoarseStereoOptions,
    confirmed_texture,
    match_reduced,
    on_aliased_texture,
)
from mgf_engine.scene.depths import Depths, Matching, match_photos
from mgf_engine.scene.neighbours import MatchingPoints
from mgf_engine.scene.validation import keep_points

OPTIONS = CoarseStereoOptions(factor=2.0)  # the photos are small
MATCHING = Matching(3, 192, STEREO)
VIEWS = range(8)
CLICKS = {2: np.array([[100.0, 70.0], [120.0, 60.0]])}


def go_on() -> None:
    pass


def all_points(scene: Scene) -> MatchingPoints:
    return MatchingPoints(scene, np.ones(len(scene.points), bool), VIEWS)


@pytest.fixture
def wall(tmp_path: Path) -> Scene:
    """A wall with a texture that all photos see alike."""
    return make_wall(tmp_path, CENTRES)[0]


@pytest.fixture
def moire(wall: Scene) -> Scene:
    add_moire(wall)
    return wall


def depths_of(scene: Scene) -> Depths:
    return match_photos(all_points(scene), None, MATCHING, 2, go_on)


def densify_on(scene: Scene, clicks: dict[int, np.ndarray]) -> Scene:
    """Return the scene with points for the masks, where it has none."""

    def leafy(index: int) -> np.ndarray:
        return np.zeros((4, 6), bool)

    return densify_points(scene, clicks, leafy, 1, go_on, DensifyOptions(stereo=STEREO, coarse=OPTIONS))


def right(depths: Depths) -> float:
    """Share of all pixels whose depth is right within 2 %."""
    return float(np.mean([np.abs(depth - DISTANCE) < 0.02 * DISTANCE for depth in depths.maps.values()]))


def test_photos_agree_on_texture_and_not_on_moire(wall: Scene) -> None:
    before = confirmed_texture(depths_of(wall), OPTIONS)
    add_moire(wall)
    after = confirmed_texture(depths_of(wall), OPTIONS)
    assert before > 0.6 and after < OPTIONS.least_confirmed


def test_photos_without_depths_are_not_called_aliased(wall: Scene) -> None:
    depths = depths_of(wall)
    assert confirmed_texture(replace(depths, maps={}), OPTIONS) == 1


def test_reduced_photos_match_where_moire_hides_the_texture(moire: Scene) -> None:
    fine = depths_of(moire)
    coarse = match_reduced(all_points(moire), None, MATCHING, OPTIONS, 2, go_on)
    assert max(coarse.photos[0].grey.shape) == 96
    assert right(coarse) > 0.5 > 2 * right(fine)


def test_places_on_moire_are_told_from_texture_and_plain_places(wall: Scene) -> None:
    places = np.array([[0.5, 0.5], [0.4, 0.6], [1.0, 1.0]])  # the last on the rim, which is a place, too
    assert not on_aliased_texture(depths_of(wall), 2, places, OPTIONS)[:2].any()
    add_moire(wall)
    found = on_aliased_texture(depths_of(wall), 2, places, OPTIONS)
    assert found[:2].all() and found.shape == (3,)
    for view in wall.views:
        cv2.imwrite(str(wall.folder / view.file), np.full((view.height, view.width, 3), 90, np.uint8))
    assert not on_aliased_texture(depths_of(wall), 2, places, OPTIONS).any()


def test_masks_get_points_on_moire_only_where_it_was_clicked(moire: Scene) -> None:
    half = keep_points(moire, moire.points[:, 0] < 0)
    without = densify_on(half, {2: np.zeros((0, 2))})
    full = densify_on(half, CLICKS)
    new = full.points[len(without.points) :]
    assert len(new) > 10
    assert np.median(np.abs(new[:, 2])) < 0.04 * DISTANCE
    assert np.array_equal(full.points[: len(without.points)], without.points)


def test_masks_get_no_such_points_where_reduced_photos_disagree_about_the_clicks_too(moire: Scene) -> None:
    add_mirror_image(moire, 2)
    half = keep_points(moire, moire.points[:, 0] < 0)
    assert np.array_equal(densify_on(half, CLICKS).points, densify_on(half, {2: np.zeros((0, 2))}).points)
