# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a photo has texture that tells depth: straight edges, however strong, have none."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.sparse import csr_array

from mgf_engine.scene.coarse_stereo import texture_strength
from mgf_engine.start.dense import DensePoints, VoxelSums
from mgf_engine.start.options import DenseOptions

ROWS, COLUMNS = np.mgrid[:40, :40].astype(np.float32)


@pytest.mark.parametrize("picture", [0 * ROWS, 60 * (COLUMNS > 20), 60 * (ROWS > 20), 20 * ROWS])
def test_plain_places_and_straight_edges_have_notexture_strength(picture: np.ndarray) -> None:
    assert texture_strength(picture.astype(np.float32))[5:-5, 5:-5].max() < 0.1 * DenseOptions.texture


def test_it_is_the_gradient_where_that_is_least() -> None:
    steep, gentle = 4.0, 1.5  # L per px along columns and rows
    folded = steep * np.abs(COLUMNS % 8 - 4) + gentle * np.abs(ROWS % 8 - 4)
    found = np.median(texture_strength(folded.astype(np.float32))[8:-8, 8:-8])
    assert 0.5 * gentle < found <= gentle
    noise = np.random.default_rng(0).normal(scale=8.0, size=ROWS.shape).astype(np.float32)
    assert texture_strength(noise)[5:-5, 5:-5].min() > DenseOptions.texture


def sparse(seen: np.ndarray) -> csr_array:
    return csr_array(seen, dtype=np.uint32)


def scattered(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points in 4 x 4 x 4 voxels of size 1, about eight in each, and which of five views saw them."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-2, 2, (512, 3)), rng.random((512, 5)) < 0.4


def test_voxels_hold_means_and_the_views_that_saw_enough_of_their_points() -> None:
    points, seen = scattered()
    mean, views = VoxelSums.of(points, sparse(seen), np.full(3, -2.0), 1.0).means(2, 0.4)
    cell = np.floor(points + 2).astype(int)
    expected = {}
    for key in {tuple(c) for c in cell}:
        rows = (cell == key).all(1)
        share = seen[rows].mean(0)
        if rows.sum() >= 2 and (share > 0.4).any():
            expected[tuple(points[rows].mean(0).round(9))] = np.flatnonzero(share > 0.4).tolist()
    found = {tuple(m.round(9)): v.tolist() for m, v in zip(mean, views, strict=True)}
    assert found == expected
    assert len(found) > 50


def test_voxels_of_photos_one_by_one_are_those_of_all_together() -> None:
    points, seen = scattered()
    low = np.full(3, -2.0)
    parts = [VoxelSums.of(points[k::3], sparse(seen[k::3]), low, 1.0) for k in range(3)]
    mean, views = VoxelSums.joined([parts[0], VoxelSums.joined(parts[1:])]).means(2, 0.4)
    expected_mean, expected_views = VoxelSums.of(points, sparse(seen), low, 1.0).means(2, 0.4)
    np.testing.assert_allclose(mean, expected_mean)
    assert [v.tolist() for v in views] == [v.tolist() for v in expected_views]


def test_no_points_make_no_voxels() -> None:
    mean, views = VoxelSums.of(np.zeros((0, 3)), csr_array((0, 5), dtype=np.uint32), np.zeros(3), 1.0).means(2, 0.4)
    assert mean.shape == (0, 3)
    assert views == []


def test_views_that_saw_nothing_take_no_memory() -> None:
    rng, count, views = np.random.default_rng(1), 20_000, 600
    points = rng.uniform(-2, 2, (count, 3))
    saw = np.repeat(np.arange(count), 8), rng.integers(0, views, 8 * count)
    seen = csr_array((np.ones(8 * count, np.uint32), saw), shape=(count, views))
    tracemalloc.start()
    parts = [VoxelSums.of(points, seen, np.full(3, -2.0), 0.02) for _ in range(8)]
    VoxelSums.joined(parts).means(2, 0.4)
    assert tracemalloc.get_traced_memory()[1] < 0.25 * 8 * 4 * count * views
    tracemalloc.stop()


def test_two_lots_of_points_are_joined_in_order() -> None:
    def lot(count: int, weight: float, aliased: bool) -> DensePoints:
        seen = [np.array([n]) for n in range(count)]
        return DensePoints(np.full((count, 3), weight), seen, np.full(count, weight), np.ones((count, 3)), aliased)

    both = lot(2, 0.3, True).joined(lot(3, 0.9, False))
    assert both.weight.tolist() == [0.3, 0.3, 0.9, 0.9, 0.9] == both.points[:, 0].tolist()
    assert [s.tolist() for s in both.seen] == [[0], [1], [0], [1], [2]] and both.aliased and len(both.normals) == 5
