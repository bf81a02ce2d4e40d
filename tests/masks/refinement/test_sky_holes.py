# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky between bars is cut out of a mask; walls as pale as the sky and windows that mirror it are not."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
from mast import HEIGHT, LAND, SKY, UP, WIDTH, look, make_scene, photograph
from numpy.typing import NDArray

from mgf_engine.masks.geometry.elevation import over_horizon
from mgf_engine.masks.image_ops import rgb_to_lab
from mgf_engine.masks.propagation.correct_masks import MaskCorrection
from mgf_engine.masks.refinement.sky_holes import SkyHoleOptions, find_sky_holes
from mgf_engine.masks.refinement.sky_silhouette import SilhouetteOptions
from mgf_engine.model.masks import BACKGROUND, BUILDING, IGNORE
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config

VIEW = look(0.9, 0.3)
NO_POINTS = np.zeros((0, 2))
OVER = over_horizon(VIEW, UP, SilhouetteOptions.horizon)


def around(mast: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mast as a segmenter draws it: with the air between its bars."""
    hull = np.zeros(mast.shape, np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.argwhere(mast)[:, ::-1].astype(np.int32)), 1)
    return hull > 0


def large_sky(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return OVER & (cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0)


def land_under_sky() -> NDArray[np.uint8]:
    photo = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    photo[:] = SKY
    photo[round(VIEW.cy) :] = LAND
    return photo


def test_the_sky_between_bars_is_no_building() -> None:
    photo, hut, mast = photograph(VIEW)
    mask = around(mast) | hut
    found = find_sky_holes(rgb_to_lab(photo), mask, large_sky(mask), VIEW, UP, NO_POINTS)
    air = mask & over_horizon(VIEW, UP, SkyHoleOptions.horizon) & ~mast & ~hut
    assert air.sum() > 200
    assert (found & ~air).sum() == 0
    assert (found & air).sum() > 0.9 * air.sum()


def test_a_wall_as_pale_as_the_sky_stays() -> None:
    photo = land_under_sky()
    wall = np.zeros((HEIGHT, WIDTH), bool)
    wall[30:78, 60:120] = True
    photo[wall] = (186, 206, 231)
    photo[50:60, 80:90] = (160, 180, 205)  # a shaded recess, darker than the sky but not by much
    assert not find_sky_holes(rgb_to_lab(photo), wall, large_sky(wall), VIEW, UP, NO_POINTS).any()


def test_a_white_wall_under_a_dark_cornice_stays() -> None:
    """What tells is its foot: no sky is seen below the horizon."""
    photo = land_under_sky()
    wall = np.zeros((HEIGHT, WIDTH), bool)
    wall[30:130, 40:200] = True
    photo[wall], photo[30:36, 40:200] = SKY, 10
    assert not find_sky_holes(rgb_to_lab(photo), wall, large_sky(wall), VIEW, UP, NO_POINTS).any()
    photo[85:130, 40:200] = (150, 70, 55)  # on a brick foot it could as well be a gap
    assert find_sky_holes(rgb_to_lab(photo), wall, large_sky(wall), VIEW, UP, NO_POINTS).any()


def test_a_pale_column_before_bricks_stays() -> None:
    """It has the colour of the sky above the horizon and below, and bricks beside it to stand out against."""
    photo = land_under_sky()
    wall = np.zeros((HEIGHT, WIDTH), bool)
    wall[50:150, 20:220] = True
    photo[wall], photo[50:150, 118:122] = (150, 70, 55), SKY
    assert not find_sky_holes(rgb_to_lab(photo), wall, large_sky(wall), VIEW, UP, NO_POINTS).any()
    photo[75:150, 118:122] = (150, 70, 55)
    found = find_sky_holes(rgb_to_lab(photo), wall, large_sky(wall), VIEW, UP, NO_POINTS)
    assert found.any()  # a gap that ends over the horizon


def test_a_window_that_mirrors_the_sky_stays_where_it_holds_points() -> None:
    photo = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    photo[:] = SKY
    wall, pane = np.zeros((2, HEIGHT, WIDTH), bool)
    wall[20:78, 60:140], pane[40:60, 90:110] = True, True
    photo[wall] = (150, 70, 55)
    photo[pane] = SKY
    y, x = np.mgrid[22:78:4, 62:140:4]
    points = np.stack([x.ravel(), y.ravel()], 1).astype(float)
    assert not find_sky_holes(rgb_to_lab(photo), wall, large_sky(wall), VIEW, UP, points).any()
    found = find_sky_holes(
        rgb_to_lab(photo),
        wall,
        large_sky(wall),
        VIEW,
        UP,
        points[~pane[points[:, 1].astype(int), points[:, 0].astype(int)]],
    )
    assert (found == pane).all()


def test_without_sky_nothing_is_cut() -> None:
    photo, hut, mast = photograph(VIEW)
    assert not find_sky_holes(rgb_to_lab(photo), hut | mast, np.zeros_like(hut), VIEW, UP, NO_POINTS).any()


class _Everywhere:
    """An extent that expects the building all over the photo, as it does between the bars of a frame."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def view_regions(self, index: int) -> SimpleNamespace:
        shape = (HEIGHT // 2, WIDTH // 2)
        return SimpleNamespace(core=np.ones(shape, bool), ground_first=np.zeros(shape, bool))

    def within(self, index: int, place: SimpleNamespace) -> np.ndarray:
        return np.ones(len(self.scene.observations(index)), bool)


def test_sky_between_bars_is_background_and_not_unknown(tmp_path: Path) -> None:
    """Unknown pixels do not vote: nothing would say that the air between the bars is empty."""
    _, hut, mast = photograph(VIEW)
    scene, mask = make_scene(tmp_path, [VIEW]), around(mast) | hut
    labels, regions = [mask.astype(np.uint8)], [SimpleNamespace(labels=large_sky(mask).astype(np.int64))]
    graph = SimpleNamespace(
        scene=scene, full=scene, regions=regions, start=[0, 2], sky=np.array([0, 1]), plants=np.zeros(2), threads=1,
        point_features=SimpleNamespace(up=UP),
    )  # fmt: skip
    reporter = SimpleNamespace(progress=lambda share: None, check=lambda: None)
    correction = MaskCorrection(graph, labels, {}, {}, None, Config(), reporter)
    correction.run(_Everywhere(scene), np.ones(len(scene.points), bool), [0])
    air = mask & OVER & ~mast & ~hut
    assert (labels[0][air] == BACKGROUND).mean() > 0.9
    assert (labels[0][mast & OVER] == BUILDING).mean() > 0.9
    assert (labels[0][~mask & ~OVER] == IGNORE).any()  # where the building is expected and something else is seen


def test_a_speck_is_no_hole() -> None:
    photo = land_under_sky()
    wall = np.zeros((HEIGHT, WIDTH), bool)
    wall[20:78, 60:140] = True
    photo[wall] = (150, 70, 55)
    photo[40:60, 80:83], photo[40:44, 120] = SKY, SKY
    for smallest, columns in ((6, {80, 81, 82}), (1, {80, 81, 82, 120})):
        options = SkyHoleOptions(smallest=smallest)
        found = find_sky_holes(rgb_to_lab(photo), wall, large_sky(wall), VIEW, UP, NO_POINTS, options)
        assert set(np.nonzero(found)[1].tolist()) == columns
