# SPDX-License-Identifier: GPL-3.0-or-later
"""Stereo points that few of the photos that ought to see them confirm: reflections, matches of a single pair."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mgf_engine.model.scene import View
from mgf_engine.scene.depths import Depths
from mgf_engine.scene.stereo import StereoOptions, StereoPhoto
from mgf_engine.start.confirmation import confirmed_share, surface_normals
from mgf_engine.start.options import DenseOptions

OPTIONS = DenseOptions()
SIZE, FOCAL = 64, 64.0


def view(centre: list[float], at: tuple[float, float, float] = (0, 0, 0)) -> View:
    """A camera that looks from ``centre`` at a place, up is z."""
    forward = np.asarray(at) - np.asarray(centre, float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    half = SIZE / 2
    return View("v", "v.png", SIZE, SIZE, FOCAL, FOCAL, half, half, rotation, -rotation @ np.asarray(centre, float),
                SIZE, SIZE, None)  # fmt: skip


def wall() -> np.ndarray:
    """Points on the plane y = 0."""
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, 12), np.linspace(-0.5, 0.5, 12))
    return np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], 1)


NORMALS = surface_normals(wall(), OPTIONS.normal_neighbours)


def scene(cameras: list[View], maps: dict[int, np.ndarray]) -> tuple[Any, Depths]:
    """What the photos and their depth maps are asked for; every pixel is in the mask."""
    labels = [np.ones((SIZE, SIZE), np.uint8)] * len(cameras)
    views = SimpleNamespace(
        views=cameras, labels=labels, indices=list(range(len(cameras))), centres=np.stack([c.centre for c in cameras])
    )
    photos = {i: StereoPhoto(c, labels[i], labels[i] > 0) for i, c in enumerate(cameras)}
    return views, Depths(photos, {}, maps, StereoOptions.tolerance)


ROUND = [view([x, -3.0, 0.3]) for x in (-0.8, -0.4, 0.0, 0.4, 0.8)]


def seen_by(*views: int) -> list[np.ndarray]:
    return [np.array(views)] * len(wall())


def test_all_photos_that_look_at_a_point_ought_to_see_it() -> None:
    views, depths = scene(ROUND, {})
    np.testing.assert_allclose(confirmed_share(views, depths, wall(), NORMALS, seen_by(1, 2), OPTIONS), 2 / 5)
    np.testing.assert_allclose(confirmed_share(views, depths, wall(), NORMALS, seen_by(0, 1, 2, 3, 4), OPTIONS), 1)


def test_a_photo_whose_depth_lies_before_a_point_need_not_see_it() -> None:
    near, far, unknown = (np.full((SIZE, SIZE), z, np.float32) for z in (1.0, 9.0, 0.0))
    for depth, expected in ((near, 2 / 4), (far, 2 / 5), (unknown, 2 / 5)):
        views, depths = scene(ROUND, {4: depth})
        np.testing.assert_allclose(confirmed_share(views, depths, wall(), NORMALS, seen_by(1, 2), OPTIONS), expected)


def test_photos_that_look_along_the_surface_need_not_see_it() -> None:
    along = view([2.9, -0.5, 0.0])
    views, depths = scene([*ROUND, along], {})
    wide = replace(OPTIONS, largest_angle=90.0)
    middle = np.abs(wall()).max(1) < 0.3
    share = confirmed_share(views, depths, wall(), NORMALS, seen_by(1, 2), wide)
    np.testing.assert_allclose(share[middle], 2 / 5)
    share = confirmed_share(views, depths, wall(), NORMALS, seen_by(1, 2), replace(wide, grazing_angle=89.9))
    np.testing.assert_allclose(share[middle], 2 / 6)


def test_photos_from_far_aside_or_beyond_their_frame_need_not_see_it() -> None:
    aside, away = view([3.0, -1.5, 0.0]), view([0.0, -3.0, 0.0], at=(0, -9, 0))
    views, depths = scene([*ROUND, aside, away], {})
    np.testing.assert_allclose(confirmed_share(views, depths, wall(), NORMALS, seen_by(2), OPTIONS), 1 / 5)


def test_background_is_not_expected_to_see_it() -> None:
    views, depths = scene(ROUND, {})
    views.labels = [*views.labels[:4], np.zeros((SIZE, SIZE), np.uint8)]
    np.testing.assert_allclose(confirmed_share(views, depths, wall(), NORMALS, seen_by(1), OPTIONS), 1 / 4)


def test_no_points_have_no_share() -> None:
    views, depths = scene(ROUND, {})
    assert confirmed_share(views, depths, np.zeros((0, 3)), np.zeros((0, 3)), [], OPTIONS).shape == (0,)
    assert surface_normals(np.zeros((0, 3)), 40).shape == (0, 3)


@pytest.mark.parametrize("axis", range(3))
def test_normals_are_those_of_the_surface(axis: int) -> None:
    points = np.roll(wall(), axis - 1, axis=1)
    assert np.abs(surface_normals(points, 12)[:, axis]).min() > 0.999
    assert np.isfinite(surface_normals(points[:2], 12)).all()
    assert np.isfinite(surface_normals(points[:1], 12)).all()
