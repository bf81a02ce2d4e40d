# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import ball, camera, ring, scene_of, sphere

from mgf_engine.mesh.fusion_options import FusionOptions, TsdfOptions
from mgf_engine.mesh.hull import HullOptions, outside_hull, silhouette_mask, silhouette_masks
from mgf_engine.mesh.isosurface import FREE, INVALID, SOLID
from mgf_engine.mesh.opacity import OpacityField, OpacityOptions, spread_order
from mgf_engine.mesh.tsdf import fuse_gaussians
from mgf_engine.model.masks import IGNORE
from mgf_engine.raster.points import IGNORE as UNKNOWN_PIXEL
from mgf_engine.raster.points import INSIDE, NEAR, OUTSIDE
from mgf_engine.raster.reference_points import opacity_of_points

UNCARVED = HullOptions(carve=False)


@pytest.fixture(scope="module")
def setting():
    views = ring(12)
    masks = scene_of(views, ball(1.1))[1]
    return sphere(800), views, silhouette_masks(masks, range(len(views)), 1)


def make(kind, setting, agree=1):
    field, views, masks = setting
    return (
        OpacityField(field, views, masks, OpacityOptions(agree=agree))
        if kind == "opacity"
        else fuse_gaussians(field, views, masks)
    )


@pytest.mark.parametrize("kind", ["opacity", "fused"])
def test_inside_is_solid_and_outside_free(kind, setting):
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (3000, 3))  # in every frame
    radius = np.linalg.norm(points, axis=1)
    state = make(kind, setting).classify(points)
    assert (state[radius < 0.85] == SOLID).all()  # discs are flat: their rims stand off the sphere
    assert (state[radius > 1.2] == FREE).all()


@pytest.mark.parametrize("kind", ["opacity", "fused"])
def test_what_no_view_sees_is_invalid(kind, setting):
    points = np.array([[0.0, 0, 0], [0, 0, 50.0], [0, 0, -60.0]])
    state = make(kind, setting).classify(points)
    assert state.tolist() == [SOLID, INVALID, INVALID]


def test_minimum_over_views_matches_the_reference(setting):
    field, views, masks = setting
    points = np.random.default_rng(1).normal(size=(60, 3)) * 0.55
    points = points.astype(np.float32).astype(np.float64)
    all_inside = [np.full_like(m, INSIDE) for m in masks]
    state = OpacityField(field, views, all_inside).classify(points)
    each = np.stack([opacity_of_points(points, field, v, NEAR).numpy() for v in views])
    lowest = each.min(0)
    clear = np.abs(lowest - 0.5) > 1e-3
    assert np.array_equal((state == SOLID)[clear], (lowest >= 0.5)[clear])
    assert 5 < (state == SOLID).sum() < 55
    second = OpacityField(field, views, all_inside, OpacityOptions(agree=2)).classify(points)
    lowest2 = np.sort(each, 0)[1]
    clear = np.abs(lowest2 - 0.5) > 1e-3
    assert np.array_equal((second == SOLID)[clear], (lowest2 >= 0.5)[clear])


@pytest.mark.parametrize("kind", ["opacity", "fused"])
def test_certain_background_frees_even_solid_points(kind, setting):
    field, views, masks = setting
    blank = [np.full_like(m, OUTSIDE) if i < 8 else m for i, m in enumerate(masks)]
    state = make(kind, (field, views, blank)).classify(np.zeros((1, 3)))
    assert state[0] == FREE


@pytest.mark.parametrize("kind", ["opacity", "fused"])
def test_unknown_pixels_decide_nothing(kind, setting):
    field, views, masks = setting
    outside = np.array([[1.4, 0.0, 0.0], [0.0, 0.0, 0.0]])
    hidden = [np.full_like(m, UNKNOWN_PIXEL) for m in masks]
    assert (make(kind, (field, views, hidden)).classify(outside) == INVALID).all()
    some = [np.full_like(m, UNKNOWN_PIXEL) if i < 8 else m for i, m in enumerate(masks)]
    assert make(kind, (field, views, some)).classify(outside).tolist() == [FREE, SOLID]


def test_fused_depth_has_no_bias(setting):
    """The surface of the fused field lies on the discs; eq. 25 finds it where half the light is gone, further out."""
    directions = np.random.default_rng(2).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radii = np.linspace(0.9, 1.15, 51)
    points = (directions[:, None] * radii[None, :, None]).reshape(-1, 3)
    found = {}
    for kind in ("opacity", "fused"):
        solid = make(kind, setting).classify(points).reshape(200, 51) == SOLID
        found[kind] = np.median(radii[solid.sum(1).clip(1) - 1])
    assert abs(found["fused"] - 1.0) < 0.025
    assert found["fused"] < found["opacity"] < 1.1


def test_the_level_is_calibrated_on_points_of_the_surface(setting):
    """Half of the points lie in what is solid then; too few points leave the level where it was."""
    directions = np.random.default_rng(3).normal(size=(400, 3))
    points = 1.03 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    field = make("opacity", setting)
    assert field.calibrate(points[:30]) == 0.5
    level = field.calibrate(points)
    assert 0.05 < level < 0.95 and abs(level - 0.5) > 0.01
    assert (field.classify(points) == SOLID).mean() == pytest.approx(0.5, abs=0.02)


def test_points_where_the_field_is_empty_do_not_calibrate_the_level(setting):
    """Screening may have removed most of the surface (a tree before a clicked photo): the level is of what is left."""
    field, views, masks = setting
    directions = np.random.default_rng(3).normal(size=(600, 3))
    points = 1.03 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    left = points[:, 0] > 0.5
    wanted = make("opacity", setting).calibrate(points[left])
    part = field.select(field.positions[:, 0] > 0.3)
    level = OpacityField(part, views, masks).calibrate(points)
    assert left.mean() < 0.3 and level == pytest.approx(wanted, abs=0.1)
    assert OpacityField(part, views, masks).calibrate(points[points[:, 0] < 0]) == 0.5  # none is left: as it was


def test_without_the_hull_background_frees_nothing(setting):
    field, views, masks = setting
    blank = [np.full_like(m, OUTSIDE) if i < 8 else m for i, m in enumerate(masks)]
    assert OpacityField(field, views, blank, OpacityOptions(hull=UNCARVED)).classify(np.zeros((1, 3)))[0] == SOLID
    fused = fuse_gaussians(field, views, blank, options=FusionOptions(TsdfOptions(hull=UNCARVED)))
    assert fused.classify(np.zeros((1, 3)))[0] == SOLID


def test_views_that_show_a_point_on_background_count_where_every_view_does(setting):
    """Behind the ball: the one view that shows the point inside its mask sees the ball first, others see the point."""
    field, views, masks = setting
    masks = [masks[0], *(np.full_like(m, OUTSIDE) for m in masks[1:])]
    behind = -1.4 * views[0].centre / np.linalg.norm(views[0].centre)
    points, uncarved = np.array([behind, [0.0, 0.0, 0.0]]), OpacityOptions(hull=UNCARVED)
    assert OpacityField(field, views, masks, uncarved).classify(points).tolist() == [SOLID, SOLID]
    every = OpacityField(field, views, masks, replace(uncarved, every_view=True))
    assert every.classify(points).tolist() == [FREE, SOLID]
    assert every.classify(np.array([[0, 0, 50.0]])).tolist() == [INVALID]


def test_no_points(setting):
    for kind in ("opacity", "fused"):
        assert make(kind, setting).classify(np.zeros((0, 3))).shape == (0,)


def test_silhouette_mask():
    labels = np.zeros((20, 30), np.uint8)
    labels[5:15, 5:15] = 7
    labels[:, 25:] = IGNORE
    mask = silhouette_mask(labels, 2)
    assert mask[10, 10] == INSIDE and mask[10, 16] == INSIDE and mask[10, 18] == OUTSIDE
    assert mask[10, 27] == UNKNOWN_PIXEL and mask[10, 24] == INSIDE  # next to the unknown nothing is certain
    assert silhouette_mask(labels, 0)[10, 15] == OUTSIDE


def test_hull_rule():
    background = np.array([0, 1, 1, 3, 3, 3, 5])
    seen = np.array([0, 0, 1, 0, 2, 20, 5])
    assert outside_hull(background, seen).tolist() == [False, True, False, True, True, False, True]


def test_spread_order_starts_far_apart():
    centres = np.array([camera(p).centre for p in ((4.0, 0, 0), (3.9, 0.1, 0), (-4.0, 0, 0), (0, 4.0, 0))])
    order = spread_order(centres)
    assert sorted(order) == [0, 1, 2, 3] and order[-1] in (0, 1)  # two cameras in one place are never both early
    assert spread_order(np.zeros((0, 3))) == []
