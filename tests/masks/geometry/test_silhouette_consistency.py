# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes of a block seen from all around, some of them wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.masks.geometry.ground_plane import GroundPlane
from mgf_engine.masks.geometry.silhouette_consistency import (
    Silhouette,
    SilhouetteConsistencyOptions,
    _largest_of_squares,
    silhouette_odds,
)
from mgf_engine.masks.propagation.superpixels import Superpixels
from mgf_engine.model.scene import View

WIDTH, HEIGHT, BLOCK, COUNT = 120, 90, 6, 12
OPTIONS = SilhouetteConsistencyOptions(cells=48)
LOW, HIGH = np.array([-1.0, -0.7, 0.0]), np.array([1.0, 0.7, 1.2])


def camera(number: int) -> View:
    """One of a ring of cameras around the block, 5 away and 2.5 up, that looks at its middle."""
    angle = 2 * np.pi * number / COUNT
    centre = np.array([5 * np.cos(angle), 5 * np.sin(angle), 2.5])
    forward = np.array([0, 0, 0.5]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return View(f"{number}", "", WIDTH, HEIGHT, 130.0, 130.0, 60.0, 45.0, rotation, -rotation @ centre, WIDTH, HEIGHT)


def squares() -> Superpixels:
    """Regions of a photo: squares of 6 px."""
    rows, columns = HEIGHT // BLOCK, WIDTH // BLOCK
    labels = np.kron(np.arange(rows * columns).reshape(rows, columns), np.ones((BLOCK, BLOCK))).astype(np.int32)
    y, x = np.divmod(np.arange(rows * columns), columns)
    centres = (np.stack([x, y], 1) * BLOCK + BLOCK / 2).astype(np.float32)
    area = np.full(rows * columns, 1 / (rows * columns), np.float32)
    nothing = np.zeros((0,), np.float32)
    return Superpixels(
        labels, (1.0, 1.0), np.zeros((len(area), 6), np.float32), centres, area, 0 * area,
        np.zeros((0, 2), np.int32), nothing, nothing,
    )  # fmt: skip


def shown(view: View) -> np.ndarray:
    """Share of each square that shows the block, by points all through it."""
    inside = np.random.default_rng(0).uniform(LOW, HIGH, (60_000, 3))
    uv, _ = view.project(inside)
    framed = (uv >= 0).all(1) & (uv < (WIDTH, HEIGHT)).all(1)
    image = np.zeros((HEIGHT, WIDTH), bool)
    image[tuple(np.floor(uv[framed, ::-1]).astype(int).T)] = True
    return np.bincount(squares().labels.ravel(), image.ravel(), minlength=len(squares().area)) / BLOCK**2


@pytest.fixture(scope="module")
def photos() -> list[Silhouette]:
    result = []
    for n in range(COUNT):
        view, regions = camera(n), squares()
        inside = (shown(view) > 0.3).astype(np.float32)
        result.append(Silhouette(view, regions, inside, np.ones_like(inside)))
    return result


def odds(photos: list[Silhouette], ground: GroundPlane | None = None) -> list[np.ndarray]:
    points = np.random.default_rng(1).uniform(LOW, HIGH, (500, 3))
    return silhouette_odds(photos, points, ground, 1, OPTIONS)


def test_the_block_is_confirmed_and_what_is_beside_it_is_not(photos: list[Silhouette]) -> None:
    for photo, found in zip(photos, odds(photos), strict=True):
        share = shown(photo.view)
        assert (found[share > 0.95] > 0.5).mean() > 0.9
        near = np.abs(photo.regions.centres - (60, 45)).max(1) < 40
        assert np.median(found[near & (share == 0)]) < -1
        assert (found >= OPTIONS.odds_against).all() and (found <= OPTIONS.odds_for).all()


def test_what_one_photo_lacks_the_others_restore(photos: list[Silhouette]) -> None:
    """The left half of one silhouette is missing; that photo's own word does not count for it."""
    lacking = photos[4].inside.copy()
    lacking[photos[4].regions.centres[:, 0] < 60] = 0
    found = odds([*photos[:4], replace(photos[4], inside=lacking), *photos[5:]])[4]
    left = (shown(photos[4].view) > 0.95) & (lacking == 0)
    assert left.sum() > 5 and (found[left] > 0.5).mean() > 0.9


def test_what_one_photo_has_too_much_the_others_reject(photos: list[Silhouette]) -> None:
    found = odds([replace(photos[0], inside=np.ones_like(photos[0].inside)), *photos[1:]])[0]
    beside = (shown(photos[0].view) == 0) & (np.abs(photos[0].regions.centres - (60, 45)).max(1) < 40)
    assert np.median(found[beside]) < -1


def test_plants_in_front_say_nothing(photos: list[Silhouette]) -> None:
    """In a third of the photos a bush covers the block: as background it carves, without weight it does not."""

    def bushes(weight: float) -> list[Silhouette]:
        hidden = np.where(photos[0].regions.centres[:, 0] > 50, 0, 1).astype(np.float32)
        part = np.where(hidden > 0, 1, weight).astype(np.float32)
        return [replace(p, inside=p.inside * hidden, weight=part) if n % 3 == 0 else p for n, p in enumerate(photos)]

    core = shown(photos[1].view) > 0.95
    assert odds(bushes(1.0))[1][core].mean() < -1
    assert odds(bushes(0.0))[1][core].mean() > 0.5


def test_below_the_ground_nothing_is_looked_at(photos: list[Silhouette]) -> None:
    high = GroundPlane(np.array([0.0, 0, 1]), 0.8, 0.01)
    foot = shown(photos[0].view) > 0.95
    foot &= photos[0].regions.centres[:, 1] > 60
    assert foot.any() and odds(photos, high)[0][foot].mean() < odds(photos)[0][foot].mean() - 1


def test_two_photos_decide_nothing(photos: list[Silhouette]) -> None:
    """Too few others have any cell in their frame: the share is unknown, or the ray meets no cell."""
    for found in odds(photos[:2]):
        assert (found <= 1e-6).all()


def test_squares_over_an_image_are_those_drawn_one_by_one():
    rng = np.random.default_rng(2)
    radius = rng.integers(0, 9, 200)
    x, y = (np.floor(rng.uniform(-radius, size + radius)).astype(int) for size in (40, 30))
    value = rng.uniform(0, 1, 200).astype(np.float32)
    expected = np.zeros((30, 40), np.float32)
    for column, row, r, v in zip(x, y, radius, value, strict=True):
        square = expected[max(0, row - r) : max(0, row + r + 1), max(0, column - r) : max(0, column + r + 1)]
        np.maximum(square, v, out=square)
    assert np.array_equal(_largest_of_squares((30, 40), x, y, radius, value), expected)
    assert not _largest_of_squares((30, 40), x[:0], y[:0], radius[:0], value[:0]).any()
