# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos brought to one exposure by the points they share."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mgf_engine.files.images import read_rgb, write_png
from mgf_engine.model.scene import Scene, Similarity, View
from mgf_engine.scene.exposure import ExposureOptions, _solve, even_exposure, photo_gains

VIEWS, POINTS, SIZE = 6, 400, 48


@pytest.fixture()
def scene(tmp_path) -> Scene:
    """Each view sees a random half of the points at random places."""
    generator = np.random.default_rng(1)
    seen = generator.random((POINTS, VIEWS)) < 0.5
    owner, view = np.nonzero(seen)
    views = tuple(
        View(
            name=f"{i}", file=f"images/{i}.png", width=SIZE, height=SIZE, fx=50.0, fy=50.0, cx=24.0, cy=24.0,
            rotation=np.eye(3), translation=np.zeros(3), original_width=SIZE, original_height=SIZE,
        )
        for i in range(VIEWS)
    )  # fmt: skip
    return Scene(
        views=views, points=generator.normal(size=(POINTS, 3)), colors=np.zeros((POINTS, 3), np.uint8),
        errors=np.zeros(POINTS, np.float32), track_start=np.concatenate([[0], np.cumsum(seen.sum(1))]),
        track_view=view.astype(np.int32),
        track_uv=generator.uniform(2, SIZE - 2, (len(owner), 2)).astype(np.float32),
        to_normalised=Similarity(1.0, np.eye(3), np.zeros(3)), roots=(0,), held_out=(), folder=tmp_path,
    )  # fmt: skip


def colors(scene: Scene, gain: np.ndarray, outliers: float = 0.0) -> np.ndarray:
    generator = np.random.default_rng(2)
    truth = generator.uniform(40, 150, (POINTS, 3))
    owner = np.repeat(np.arange(POINTS), np.diff(scene.track_start))
    observed = truth[owner] * gain[scene.track_view] * generator.normal(1, 0.01, (len(owner), 1))
    wrong = generator.random(len(owner)) < outliers
    observed[wrong] = generator.uniform(20, 230, (int(wrong.sum()), 3))
    return observed


@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_gains_are_found_up_to_one_common_factor(scene, outliers) -> None:
    true = np.exp(np.random.default_rng(3).normal(0, 0.2, (VIEWS, 3)))
    both = photo_gains(colors(scene, true, outliers), scene) * true
    assert np.abs(np.log(both) - np.log(both).mean(0)).max() < (0.02 if outliers else 0.012)


def test_equal_photos_stay_as_they_are(scene) -> None:
    assert (photo_gains(colors(scene, np.ones((VIEWS, 3))), scene) == 1).all()


def test_a_photo_that_shares_nothing_stays_as_it_is(scene) -> None:
    alone = replace(scene, track_view=np.where(scene.track_view == 5, 0, scene.track_view).astype(np.int32))
    true = np.exp(np.random.default_rng(3).normal(0, 0.2, (VIEWS, 1))) * np.ones(3)
    gains = photo_gains(colors(alone, true), alone)
    others = np.log(gains[:5] * true[:5])
    assert np.isfinite(gains).all()
    assert np.ptp(others, axis=0).max() < 0.02


def test_no_points_and_clipped_colors_change_nothing(scene) -> None:
    assert (photo_gains(np.full((len(scene.track_view), 3), 255.0), scene) == 1).all()
    empty = replace(scene, points=np.zeros((0, 3)), track_start=np.zeros(1, np.int64),
                    track_view=np.zeros(0, np.int32), track_uv=np.zeros((0, 2), np.float32))  # fmt: skip
    assert (photo_gains(np.zeros((0, 3)), empty) == 1).all()


def test_photos_are_rewritten_to_agree(scene, tmp_path) -> None:
    picture = np.full((SIZE, SIZE, 3), 100, np.uint8)
    factors = [0.8, 1.0, 1.25, 1.0, 0.9, 1.1]
    for i, factor in enumerate(factors):
        write_png(tmp_path / f"{i}.png", cv2.multiply(picture, np.full(4, factor)))
    gains = even_exposure(scene, tmp_path)
    after = [read_rgb(tmp_path / f"{i}.png").mean() for i in range(VIEWS)]
    assert np.ptp(after) <= 2.0
    assert gains.shape == (VIEWS, 3)


def test_the_gains_of_very_many_photos_need_no_matrix_between_them() -> None:
    """20,000 photos: the matrix between them would take 3.2 GB."""
    random = np.random.default_rng(0)
    photos, points, seen = 20_000, 8_000, 40
    view = np.repeat(np.arange(photos, dtype=np.int32), seen)
    point = random.integers(0, points, len(view))
    gain = random.normal(0, 0.2, photos)
    value = gain[view] + random.normal(0, 0.5, points)[point] + random.normal(0, 0.01, len(view))
    found = _solve(value, view, point, photos, ExposureOptions())
    inner = np.abs(gain) < 0.3  # the prior draws larger ones to zero
    assert np.percentile(np.abs(found - (gain - gain.mean()))[inner], 95) < 0.08
    assert np.corrcoef(found, gain)[0, 1] > 0.99
