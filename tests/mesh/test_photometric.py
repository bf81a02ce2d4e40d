# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps matched between photos: the kernel against its twin, and what matching must and must not do."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mgf_engine.mesh.photometric import (
    HIDDEN,
    JUMP,
    TEXTURE,
    Surface,
    between,
    correlations,
    match_surface,
)
from mgf_engine.raster.reference_match import match_depths
from mgf_engine.scene.model import View

SIZE, DISTANCE = 64, 5.0


def view(x: float, turn: float = 0.0) -> View:
    rotation = cv2.Rodrigues(np.array([0.0, turn, 0.02]))[0]
    centre = np.array([x, 0.1 * x, -DISTANCE])
    return View(
        name=f"{x}", file="", original_width=SIZE, original_height=SIZE, width=SIZE, height=SIZE,
        fx=80.0, fy=84.0, cx=31.0, cy=33.0, rotation=rotation, translation=-rotation @ centre,
    )  # fmt: skip


def texture(points: np.ndarray) -> np.ndarray:
    x, y = points[..., 0], points[..., 1]
    waves = np.sin(9 * x + 2 * y) + np.sin(5 * y - 7 * x + 1) + np.sin(13 * y + 3 * x) + np.sin(17 * x - 11 * y)
    return 0.5 + 0.1 * waves


def surface(camera: View, tilt: float = 0.3, gain: float = 1.0, plain: bool = False) -> Surface:
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
    as32 = (np.ascontiguousarray(a, dtype=np.float32) for a in (grey, depth, normals))
    return Surface(camera, *as32, through)


FIRST = surface(view(0.0))
OTHERS = [surface(view(0.9, -0.15)), surface(view(-0.8, 0.1), gain=0.7)]


def test_kernel_equals_its_twin() -> None:
    generator = np.random.default_rng(0)
    noisy = replace(FIRST, depth=(FIRST.depth * generator.normal(1, 0.004, FIRST.depth.shape)).astype(np.float32))
    noisy.depth[10:20, 5:40] = 0
    pixels = generator.choice(SIZE * SIZE, 700, replace=False).astype(np.int32)
    step = generator.uniform(0.001, 0.01, len(pixels)).astype(np.float32)
    scores, counts = correlations(noisy, OTHERS[:1], pixels, step)
    v = noisy.view
    expected, seen = match_depths(
        pixels, noisy.normal.reshape(-1, 3)[pixels].astype(float), step.astype(float), scores.shape[1],
        (noisy.grey.astype(float), noisy.depth.astype(float)), np.array([1 / v.fx, 1 / v.fy, v.cx, v.cy]),
        between(v, OTHERS[0].view), (OTHERS[0].grey.astype(float), OTHERS[0].depth.astype(float)),
        JUMP, HIDDEN, TEXTURE,
    )  # fmt: skip
    assert 100 < seen.sum() < 600
    # A pixel whose depth lies on a threshold to the last bit may be judged either way.
    same = counts == seen
    assert same.mean() > 0.995
    assert np.abs(scores - expected)[same].max() < 2e-3
    assert np.abs(scores - expected)[same].mean() < 2e-5


def inner(a: np.ndarray) -> np.ndarray:
    return a[12:-12, 12:-12]


@pytest.mark.parametrize("error", [-0.01, -0.004, 0.006, 0.012])
def test_a_wrong_depth_is_moved_onto_the_surface(error: float) -> None:
    start = replace(FIRST, depth=FIRST.depth * np.float32(1 + error))
    others = [replace(o, depth=o.depth * np.float32(1 + error)) for o in OTHERS]
    matched = match_surface(start, others)
    pixels = inner(np.abs(matched.depth / FIRST.depth - 1)) * 80.0 * 0.9 / DISTANCE  # of parallax
    assert inner(matched.likeness > 0.9).mean() > 0.95
    assert np.median(pixels) < 0.02 and np.percentile(pixels, 90) < 0.06


def test_without_texture_the_depth_stays() -> None:
    others = [surface(o.view, plain=True) for o in OTHERS]
    start = surface(FIRST.view, plain=True)
    matched = match_surface(start, others)
    assert (matched.likeness == 0).all()
    assert np.array_equal(matched.depth, start.depth)


def test_a_neighbour_that_sees_something_else_has_no_say() -> None:
    blocked = [replace(o, depth=0.8 * o.depth) for o in OTHERS]
    assert (match_surface(FIRST, blocked).likeness == 0).all()


def test_unseen_pixels_stay_unseen_and_no_neighbour_changes_nothing() -> None:
    holes = replace(FIRST, depth=np.where(np.arange(SIZE) % 9 < 2, 0, FIRST.depth).astype(np.float32))
    matched = match_surface(holes, OTHERS)
    assert (matched.depth[holes.depth == 0] == 0).all() and np.isfinite(matched.depth).all()
    alone = match_surface(FIRST, [])
    assert np.array_equal(alone.depth, FIRST.depth) and not alone.likeness.any()
