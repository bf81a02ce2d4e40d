# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks of points: tetrahedra of neighbouring ones meet in the same triangles."""

from __future__ import annotations

import numpy as np
import pytest

from mgf_engine.geometry.block_grid import BlockGrid, make_grid, with_borders
from mgf_engine.geometry.delaunay import background_delaunay

FACES = ([1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2])


def shell(count: int = 3000, seed: int = 0) -> np.ndarray:
    """Points in three layers around a long body, as Gaussians span them."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points * rng.choice([0.97, 1.0, 1.03], count)[:, None] * (3.0, 1.5, 1.0)


def lattice() -> np.ndarray:
    """The corners of 20 x 8 x 6 cubes: any four of a square lie on one circle."""
    return np.stack(np.meshgrid(np.arange(21.0), np.arange(9.0), np.arange(7.0), indexing="ij"), -1).reshape(-1, 3)


def triangles_on(points: np.ndarray, corners: np.ndarray, axis: int, cut: float) -> set[tuple[int, ...]]:
    """Faces of tetrahedra that lie on a border."""
    faces = np.sort(np.concatenate([corners[:, face] for face in FACES]), axis=1)
    on = (points[faces][..., axis] == cut).all(1)
    return set(map(tuple, faces[on].tolist()))


@pytest.mark.parametrize("count", [2, 4, 6, 8])
@pytest.mark.parametrize("points", [shell(), lattice()], ids=["shell", "lattice"])
def test_blocks_at_both_sides_of_a_border_have_the_same_triangles_on_it(points: np.ndarray, count: int) -> None:
    extent = np.full(len(points), 0.3 if len(points) == 3000 else 0.9)
    grid = make_grid(points, count)
    assert len(grid) == count
    whole, _ = with_borders(points, extent, grid)
    found = []
    for rows in grid.members(whole):
        with background_delaunay(whole[rows], whole) as made:
            found.append(rows[made(lambda: None)])
    for axis, cuts in enumerate(grid.cuts):
        for cut in cuts:
            sides = [triangles_on(whole, corners, axis, cut) for corners in found]
            met = sorted(triangle for side in sides for triangle in side)
            assert len(met) > 20
            assert met[::2] == met[1::2] and len(set(met)) == len(met) // 2  # each at two sides


def test_every_point_is_in_a_block_and_only_border_points_in_several() -> None:
    points = shell()
    grid = make_grid(points, 6)
    whole, extent = with_borders(points, np.full(len(points), 0.3), grid)
    assert np.array_equal(whole[: len(points)], points) and len(extent) == len(whole)
    times = np.bincount(np.concatenate(list(grid.members(whole))), minlength=len(whole))
    on = grid.on_border(whole).any(1)
    assert (times[~on] == 1).all() and (times[on] >= 2).all()


def test_blocks_are_even_and_borders_keep_away_from_walls() -> None:
    rng = np.random.default_rng(0)
    inside = rng.uniform(size=(4000, 3)) * (10, 2, 2)
    wall = rng.uniform(size=(2000, 3)) * (0.02, 2, 2) + (5.0, 0, 0)
    points = np.concatenate([inside, wall])
    ((cut,), across, up) = make_grid(points, 2).cuts
    assert len(across) == len(up) == 0
    assert not 4.99 < cut < 5.03
    assert 0.3 < (points[:, 0] < cut).mean() < 0.7
    sizes = [len(rows) for rows in make_grid(inside, 5).members(inside)]
    assert min(sizes) > 500 and sum(sizes) == 4000


def test_one_block_has_no_border() -> None:
    grid = make_grid(shell(), 1)
    whole, _ = with_borders(shell(), np.ones(3000), grid)
    assert len(grid) == 1 and len(whole) == 3000
    assert [len(rows) for rows in grid.members(whole)] == [3000]


def test_points_on_the_meeting_of_borders_stay_on_all_of_them() -> None:
    grid = BlockGrid((np.array([0.5, 2.0]), np.array([0.5]), np.array([0.5])))
    points = np.random.default_rng(0).uniform(0, 1, (500, 3)) * (3, 1, 1)
    whole, _ = with_borders(points, np.full(500, 0.2), grid)
    on = grid.on_border(whole)
    assert on.all(1).sum() >= 2  # corners of eight blocks
    assert (on.sum(1) == 2).sum() > 10
