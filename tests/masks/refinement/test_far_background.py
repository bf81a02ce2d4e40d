# SPDX-License-Identifier: GPL-3.0-or-later
"""Lawn far behind a frame is cut out of its masks; bars, walls like a neighbour's and green buildings are not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.refinement.far_background import remove_far_background
from mgf_engine.model.masks import BACKGROUND, BUILDING
from mgf_engine.model.scene import View

WIDTH, HEIGHT = 400, 130
UP = np.array([0.0, 0.0, 1.0])
LEVEL = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along y, upright
VIEW = View("a", "a", WIDTH, HEIGHT, 240.0, 240.0, 200.0, 40.0, LEVEL, np.zeros(3), WIDTH, HEIGHT)
STEEL, BRICK = (120, 124, 130), (150, 70, 55)
FRAME = np.zeros((HEIGHT, WIDTH), bool)
FRAME[20:110, 150:230] = True
BARS = np.zeros_like(FRAME)
BARS[:, 150:230:16] = BARS[:, 151:230:16] = BARS[:, 152:230:16] = BARS[:, 153:230:16] = True
BARS &= FRAME
SKY = np.broadcast_to(np.arange(HEIGHT)[:, None] < 40, FRAME.shape)
Photo = NDArray[np.uint8]


def lawn(seed: int) -> Photo:
    """Green that turns into haze towards the horizon, and a pale sky; with grain."""
    down = np.clip((np.arange(HEIGHT) - 40) / 90, 0, 1)[:, None, None]
    color = np.array([170, 185, 180.0]) * (1 - down) ** 2 + np.array([70, 95, 50.0]) * (1 - (1 - down) ** 2)
    photo = np.broadcast_to(np.where(SKY[..., None], (225, 232, 240), color), (HEIGHT, WIDTH, 3))
    grain = np.random.default_rng(seed).normal(0, 3, photo.shape)
    return np.clip(photo + grain, 0, 255).astype(np.uint8)


def framed(seed: int) -> Photo:
    photo = lawn(seed)
    photo[BARS] = STEEL
    return photo


def cut(photos: list[Photo], masks: list[NDArray[np.bool_]], points: NDArray[np.float64] | None = None) -> list[Photo]:
    labels = [np.where(mask, BUILDING, BACKGROUND).astype(np.uint8) for mask in masks]
    scene = SimpleNamespace(photo=photos.__getitem__, views=[VIEW] * len(photos))
    seen = np.zeros((0, 2)) if points is None else points
    remove_far_background(scene, labels, UP, lambda index: seen)
    return labels


def test_lawn_and_haze_between_bars_are_no_building() -> None:
    labels = cut([framed(i) for i in range(4)], [FRAME] * 4)
    for label in labels:
        inner = FRAME & ~BARS
        inner[:, 1:-1] &= ~BARS[:, :-2] & ~BARS[:, 2:]  # colours are means of 3 x 3 pixels
        assert (label[inner] == BACKGROUND).mean() > 0.95
        assert (label[BARS] == BUILDING).all()


def test_a_photo_full_of_the_building_learns_from_the_others() -> None:
    labels = cut([framed(i) for i in range(4)], [np.ones_like(FRAME)] + [FRAME] * 3)
    away = ~FRAME & (np.arange(HEIGHT)[:, None] > 30)
    assert (labels[0][away] == BACKGROUND).mean() > 0.9
    assert (labels[0][BARS] == BUILDING).all()


def test_a_neighbour_of_the_same_brick_takes_no_wall_away() -> None:
    wall = np.zeros_like(FRAME)
    wall[50:80, 20:140] = True
    photos = [framed(i) for i in range(4)]
    for photo in photos:
        photo[wall] = BRICK
    photos[0][50:80, 235:] = BRICK  # of the other house this photo shows more than of the lawn
    labels = cut(photos, [FRAME | wall] * 4)
    assert (labels[0][wall] == BUILDING).all()
    assert (labels[1][FRAME & ~BARS] == BACKGROUND).mean() > 0.6


def test_a_building_as_green_as_the_lawn_stays() -> None:
    rows, columns = np.mgrid[50:100:5, 155:225:5]
    points = np.stack([columns.ravel(), rows.ravel()], 1).astype(float)
    labels = cut([lawn(i) for i in range(4)], [FRAME] * 4, points)
    assert all((label[FRAME] == BUILDING).all() for label in labels)


def test_two_photos_are_too_few_to_tell() -> None:
    labels = cut([framed(i) for i in range(2)], [FRAME] * 2)
    assert all((label[FRAME] == BUILDING).all() for label in labels)
