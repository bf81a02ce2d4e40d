# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps matched between photos: the kernel against its reference, and what matching must and must not do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from support.sideways import view_beside

from mgf_engine.mesh.photometric import (
    MatchOptions,
    RenderedSurface,
    correlations,
    match_surface,
)
from mgf_engine.mesh.reference_photometric import PhotoPair, depth_steps, match_depths
from mgf_engine.model.scene import View
from mgf_engine.native import library
from mgf_engine.scene.kernel_photos import pixel_transfer

SIZE, DISTANCE = 64, 5.0
OPTIONS = MatchOptions()


def view(x: float, turn: float = 0.0) -> View:
    return view_beside(x, turn, (SIZE, SIZE), (80.0, 84.0), (31.0, 33.0), DISTANCE)


def texture(points: np.ndarray) -> np.ndarray:
    x, y = points[..., 0], points[..., 1]
    waves = np.sin(9 * x + 2 * y) + np.sin(5 * y - 7 * x + 1) + np.sin(13 * y + 3 * x) + np.sin(17 * x - 11 * y)
    return 0.5 + 0.1 * waves


def surface(camera: View, tilt: float = 0.3, gain: float = 1.0, plain: bool = False) -> RenderedSurface:
    """The textured plane z = tilt * x as the camera sees it, exactly."""
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    towards = rays @ camera.rotation
    normal = np.array([tilt, 0.0, -1.0]) / np.hypot(tilt, 1.0)
    depth = -(camera.centre @ normal) / (towards @ normal)
    points = camera.centre + depth[..., None] * towards
    grey = np.full(depth.shape, 0.5) if plain else 0.1 + gain * texture(points)
    normals = np.broadcast_to(camera.rotation @ normal, (*depth.shape, 3))
    through = np.zeros(depth.shape, bool)
    as32 = (np.ascontiguousarray(a, dtype=np.float32) for a in (depth, normals))
    return RenderedSurface(camera, np.rint(255 * grey).astype(np.uint8), *as32, through)


FIRST = surface(view(0.0))
OTHERS = [surface(view(0.9, -0.15)), surface(view(-0.8, 0.1), gain=0.7)]


@pytest.fixture(params=library.runnable_variants())
def variant(request: pytest.FixtureRequest) -> Iterator[str]:
    library.use_variant(request.param)
    yield request.param
    library.use_variant("")


def test_kernel_equals_its_reference(variant: str) -> None:
    generator = np.random.default_rng(0)
    noisy = replace(FIRST, depth=(FIRST.depth * generator.normal(1, 0.004, FIRST.depth.shape)).astype(np.float32))
    noisy.depth[10:20, 5:40] = 0
    others = [OTHERS[0], replace(OTHERS[1], depth=OTHERS[1].depth * np.where(np.arange(SIZE)[:, None] < 40, 1, 0.9))]
    others[1] = replace(others[1], depth=others[1].depth.astype(np.float32))
    pixels = np.sort(generator.choice(SIZE * SIZE, 700, replace=False)).astype(np.int32)
    pixels = pixels[noisy.depth.ravel()[pixels] > 0]
    scores, counts, step = correlations(noisy, others, pixels)
    v = noisy.view
    maps = [pixel_transfer(v, other.view) for other in others]
    first, inverse = (noisy.grey.astype(float), noisy.depth.astype(float)), np.array([1 / v.fx, 1 / v.fy, v.cx, v.cy])
    found = [
        match_depths(
            PhotoPair(first, (other.grey.astype(float), other.depth.astype(float)), inverse, m), pixels,
            noisy.normal.reshape(-1, 3)[pixels].astype(float), step.astype(float), OPTIONS,
        )
        for m, other in zip(maps, others, strict=True)
    ]  # fmt: skip
    expected, seen = sum(f[0] for f in found), sum(f[1] for f in found)
    assert {0, 1, 2} == set(seen.tolist()) and 200 < seen.sum() < 900
    # A pixel whose depth lies on a threshold to the last bit may fall either way.
    same = counts == seen
    assert same.mean() > 0.995
    assert np.abs(scores - expected)[same].max() < 2e-3
    assert np.abs(scores - expected)[same].mean() < 2e-5
    inside = (np.minimum(pixels % SIZE, pixels // SIZE) >= 2) & (np.maximum(pixels % SIZE, pixels // SIZE) < SIZE - 2)
    steps = depth_steps(pixels, noisy.depth.astype(float), maps, OPTIONS.pixels, 0.5 / OPTIONS.steps)
    np.testing.assert_allclose(step[inside], steps[inside], rtol=1e-5)
    assert np.ptp(step) > 0.1 * step.mean()


def test_any_number_of_threads_and_small_pictures() -> None:
    pixels = np.flatnonzero(FIRST.depth.ravel() > 0).astype(np.int32)
    results = []
    for count in (1, 3):
        library.set_threads(count)
        results.append(correlations(FIRST, OTHERS, pixels))
    library.set_threads(0)
    for one, other in zip(*results, strict=True):
        assert np.array_equal(one, other)
    for height, width in ((1, 1), (4, 64), (64, 4), (5, 5)):
        small = [
            replace(s, **{k: np.ascontiguousarray(getattr(s, k)[:height, :width]) for k in ("grey", "depth", "normal")})
            for s in (FIRST, *OTHERS)
        ]
        assert np.isfinite(match_surface(small[0], small[1:]).depth).all()


def inner(a: np.ndarray) -> np.ndarray:
    return a[12:-12, 12:-12]


@pytest.mark.parametrize("error", [-0.01, -0.004, 0.006, 0.012])
def test_a_wrong_depth_is_moved_onto_the_surface(error: float) -> None:
    start = replace(FIRST, depth=FIRST.depth * np.float32(1 + error))
    others = [replace(o, depth=o.depth * np.float32(1 + error)) for o in OTHERS]
    matched = match_surface(start, others)
    pixels = inner(np.abs(matched.depth / FIRST.depth - 1)) * 80.0 * 0.9 / DISTANCE  # of parallax
    assert inner(matched.correlation > 0.9).mean() > 0.95
    assert np.median(pixels) < 0.02 and np.percentile(pixels, 90) < 0.06


def test_without_texture_the_depth_stays() -> None:
    others = [surface(o.view, plain=True) for o in OTHERS]
    start = surface(FIRST.view, plain=True)
    matched = match_surface(start, others)
    assert (matched.correlation == 0).all()
    assert np.array_equal(matched.depth, start.depth)


def test_a_neighbour_that_sees_something_else_has_no_say() -> None:
    blocked = [replace(o, depth=0.8 * o.depth) for o in OTHERS]
    assert (match_surface(FIRST, blocked).correlation == 0).all()


def test_unseen_pixels_stay_unseen_and_no_neighbour_changes_nothing() -> None:
    holes = replace(FIRST, depth=np.where(np.arange(SIZE) % 9 < 2, 0, FIRST.depth).astype(np.float32))
    matched = match_surface(holes, OTHERS)
    assert (matched.depth[holes.depth == 0] == 0).all() and np.isfinite(matched.depth).all()
    alone = match_surface(FIRST, [])
    assert np.array_equal(alone.depth, FIRST.depth) and not alone.correlation.any()
