# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from mgf_engine.errors import BadInput
from mgf_engine.geometry import delaunay as module
from mgf_engine.geometry import tetgen
from mgf_engine.geometry.delaunay import delaunay
from mgf_engine.geometry.reference_delaunay import reference_delaunay
from mgf_engine.native import library


@pytest.fixture(params=library.runnable_variants())
def variant(request: pytest.FixtureRequest):
    library.use_variant(request.param)
    yield
    library.use_variant("")


def nothing() -> None:
    pass


def random_points(count: int = 400, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 3))


def grid(*sides: int) -> np.ndarray:
    """Points of a grid, in any order: all cubes, rectangles and planes of it are degenerate."""
    points = np.stack(np.meshgrid(*map(np.arange, sides), indexing="ij"), -1).reshape(-1, 3) / max(np.array(sides) - 1)
    return np.random.default_rng(4).permutation(points)


def on_sphere(count: int) -> np.ndarray:
    """Points on a sphere but for their rounding, as the corners of a turned box are."""
    points = np.random.default_rng(5).normal(size=(count, 3))
    return 0.5 + 0.5 * points / np.linalg.norm(points, axis=1, keepdims=True)


def boxes(count: int) -> np.ndarray:
    """Corners and middles of turned boxes, as Gaussians span them."""
    rng = np.random.default_rng(6)
    corner = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(-1, 3)
    turned = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0] * rng.uniform(0.001, 0.05, (count, 1, 3))
    offsets = np.concatenate([np.zeros((1, 3)), corner])
    return (rng.random((count, 1, 3)) + np.einsum("nij,cj->nci", turned, offsets)).reshape(-1, 3)


def volumes(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    a, b, c, d = (points[tetrahedra[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def ordered(tetrahedra: np.ndarray) -> np.ndarray:
    """Tetrahedra of positive volume as the kernel orders them."""
    result = np.empty_like(tetrahedra)
    first = np.empty(tetrahedra.max() + 2, np.int64)
    library.call("mgf_sort_tetrahedra", len(result), tetrahedra, len(first) - 1, first, result)
    return result


def test_tetrahedra_fill_the_hull() -> None:
    points = random_points()
    volume = volumes(points, delaunay(points))
    assert (volume > 0).all() and np.isclose(volume.sum(), ConvexHull(points).volume)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((3, 3)),
        random_points(50) * [1, 1, 0],
        random_points(50) * [1, 0, 0],
        np.ones((10, 3)),
        random_points(50) * [1, 1, 1e-9] + 100,
    ],
)
def test_flat_points_are_refused(points: np.ndarray) -> None:
    with pytest.raises(BadInput, match="no surface"):
        delaunay(points)


def test_points_that_rounding_makes_flat_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "spans_volume", lambda points: True)
    with pytest.raises(BadInput, match="no surface"):
        delaunay(random_points(50) * [1, 1, 1e-17])


@pytest.mark.parametrize(
    "points",
    [
        *(random_points(13, seed) for seed in range(3)),
        random_points(12) * [1, 1, 1e-6],
        grid(2, 2, 2),
        grid(3, 2, 2),
        np.r_[grid(3, 3, 1), [[0.3, 0.4, 0.2]]],
        np.r_[grid(2, 2, 2), [[0.5, 0.5, 0.5]], [[0.5, 0.5, 1.0]]],
        on_sphere(12),
        boxes(1),
        np.r_[boxes(1), boxes(1)[:3] + 1e-3],
    ],
    ids=lambda points: str(len(points)),
)
def test_they_are_those_of_the_definition(points: np.ndarray, variant: None) -> None:
    scaled = module.scaled(points, points)
    assert np.array_equal(delaunay(points), reference_delaunay(scaled))


@pytest.mark.parametrize(
    "points", [random_points(3000), grid(6, 6, 6), on_sphere(1000), boxes(300), random_points(2000) * [1, 1, 1e-4]]
)
def test_they_are_those_of_tetgen(points: np.ndarray) -> None:
    scaled = np.rint(module.scaled(points, points) * 2.0**53) / 2.0**53
    assert np.array_equal(delaunay(points), ordered(tetgen.tetrahedralize(scaled)))


@pytest.mark.parametrize("points", [random_points(500), grid(5, 5, 5)])
def test_they_do_not_depend_on_the_order_of_insertion(points: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = delaunay(points)
    order = np.random.default_rng(1).permutation(len(points)).astype(np.int32)
    monkeypatch.setattr(module, "_insertion_order", lambda points: order)
    assert np.array_equal(delaunay(points), expected)


def test_of_equal_points_one_counts() -> None:
    points = random_points(100)
    twice = delaunay(np.concatenate([points, points[:50]]))
    used = np.unique(twice)
    assert len(used) == 100 and len(np.unique(used % 100)) == 100
    assert np.isclose(volumes(np.concatenate([points, points]), twice).sum(), ConvexHull(points).volume)


def test_capacity_grows_where_it_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = delaunay(random_points())
    monkeypatch.setattr(module, "_FIRST_CAPACITY", 1)
    assert np.array_equal(delaunay(random_points()), expected)


def test_a_far_origin_costs_nothing_but_rounding() -> None:
    points = 0.01 * grid(6, 6, 6) + 3e5
    volume = volumes(points - points.mean(0), delaunay(points))
    assert np.isclose(volume.sum(), np.prod(np.ptp(points, axis=0)), rtol=1e-6) and (volume > -1e-12).all()


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for the peak")
def test_a_point_takes_what_the_budget_counts_on() -> None:
    code = """
import numpy as np
from mgf_engine.geometry import delaunay
from mgf_engine.system.machine import peak_memory

points = np.random.default_rng(0).random((300_000, 3))
delaunay.delaunay(points[:100])
before = peak_memory()
delaunay.delaunay(points)
print((peak_memory() - before) / len(points) / delaunay._BYTES)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    # Random points have 6.7 tetrahedra each, those of Gaussians 6.3; what the order takes counts more for few.
    assert float(done.stdout) < 1.25
