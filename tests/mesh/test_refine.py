# SPDX-License-Identifier: GPL-3.0-or-later
"""A distorted mesh of a textured ball goes back to the ball where photos show it, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import as_trimesh, ball, camera, scene_of, sphere
from support.mesh_stage import mesh_options, reporter
from support.rays import pixel_rays

from mgf_engine.geometry.clean import smooth
from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.mesh.depth_smoothing import SmoothingOptions
from mgf_engine.mesh.extract import extract_mesh
from mgf_engine.mesh.find_trusted_views import find_trusted_views
from mgf_engine.mesh.fusion_options import FusionOptions
from mgf_engine.mesh.ground_pixels import ground_pixels
from mgf_engine.mesh.hull import silhouette_masks
from mgf_engine.mesh.refine import refine
from mgf_engine.mesh.trusted_views import Photos, TrustedViews

FINE = 6  # subdivisions of the ball
UNSMOOTHED = FusionOptions(smoothing=SmoothingOptions(strength=0.0))  # what matching alone does


def painted(view, plain: bool = False) -> np.ndarray:
    """The photo of a unit ball with waves on it, as brightness."""
    rows, columns = np.indices((view.height, view.width))
    rays = pixel_rays(view, rows.ravel(), columns.ravel())
    middle = rays @ -view.centre
    inside = middle**2 - view.centre @ view.centre + 1
    depth = middle - np.sqrt(np.maximum(inside, 0))
    x, y, z = (view.centre + depth[:, None] * rays).T
    waves = np.sin(23 * x + 5 * y) + np.sin(19 * y - 11 * z + 1) + np.sin(27 * z + 7 * x) + np.sin(31 * x - 17 * y)
    grey = np.where(inside > 0, 0.5 + (0 if plain else 0.1) * waves, 0.0)
    return np.rint(255 * grey.reshape(view.height, view.width)).astype(np.uint8)


@pytest.fixture(scope="module")
def setting():
    """Cameras close together before one side of the ball; photos; and a ball with dents of up to half a pixel."""
    views = [camera((4.0, 1.2 * (k - 2), 0.6 * (-1) ** k), name=f"{k}.png") for k in range(5)]
    truth = ball(subdivisions=FINE)
    masks = scene_of(views, truth)[1]
    silhouettes = silhouette_masks(masks, range(5), 1)
    pixel = ground_pixels(truth, views)
    x, y, z = truth.vertices.T
    dents = 0.5 * np.sin(8 * y) * np.sin(8 * z + 2 * x) * pixel
    return views, silhouettes, truth, replace(truth, vertices=truth.vertices * (1 + dents)[:, None]), pixel


def trusted(views, silhouettes, greys, near) -> TrustedViews:
    return TrustedViews(list(range(len(views))), views, silhouettes, [], Photos(lambda k: greys[k], near))


def refined(setting, plain: bool, rounds: int = 1):
    views, silhouettes, _, dented, _ = setting
    greys = [painted(view, plain) for view in views]
    near = [[k for k in (n - 1, n + 1) if 0 <= k < len(views)] for n in range(len(views))]
    shares: list[float] = []
    mesh = refine(dented, trusted(views, silhouettes, greys, near), rounds, shares.append, UNSMOOTHED)
    assert shares == sorted(shares) and (not rounds or 0.5 < shares[-1] <= 1)
    return mesh


def seen_well(setting) -> np.ndarray:
    """Vertices that at least three cameras see from the front."""
    views, _, truth, _, _ = setting
    seen = np.zeros(len(truth.vertices), int)
    for view in views:
        uv, depth = view.project(truth.vertices)
        x, y = np.clip(uv, 0, (view.width - 1, view.height - 1)).astype(int).T
        facing = (vertex_normals(truth) * (view.centre - truth.vertices)).sum(1) > 2.0
        seen += facing & (np.abs(render_mesh(truth, view).depth[y, x] - depth) < 0.05)
    return seen >= 3


def off(mesh, pixel, rows) -> float:
    """Root mean square distance from the unit ball, in pixels."""
    return float(np.sqrt(np.mean(((np.linalg.norm(mesh.vertices, axis=1) - 1) / pixel)[rows] ** 2)))


def test_dents_go_where_photos_show_texture(setting):
    _, _, _, dented, pixel = setting
    rows = seen_well(setting)
    before, after = off(dented, pixel, rows), off(refined(setting, plain=False), pixel, rows)
    assert before > 0.2 and rows.sum() > 1000
    assert after < 0.4 * before
    assert off(refined(setting, plain=False, rounds=2), pixel, rows) < 0.4 * before


def test_without_texture_nothing_moves(setting):
    _, _, _, dented, pixel = setting
    mesh = refined(setting, plain=True)
    moved = np.linalg.norm(mesh.vertices - dented.vertices, axis=1) / pixel
    assert np.percentile(moved, 95) < 0.2 and moved.max() < 1


def test_a_thin_bar_does_not_shrink(setting):
    """A bar of two pixels and a half, before photos that show nothing on it: smoothing would take part of it."""
    views, silhouettes, _, _, _ = setting
    bar = ball(subdivisions=2)
    width = 1.25 * ground_pixels(bar, views).mean()
    thin = replace(bar, vertices=bar.vertices * (width, width, 1.0))
    greys = [painted(view, plain=True) for view in views]
    refined_bar = refine(thin, trusted(views, silhouettes, greys, [[] for _ in views]), 1, fusion=UNSMOOTHED)
    before, after, smoothed = (as_trimesh(mesh).volume for mesh in (thin, refined_bar, smooth(thin, 2)))
    assert smoothed < 0.93 * before and after > 0.98 * before


def test_what_no_photo_sees_stays(setting):
    _, _, truth, dented, pixel = setting
    mesh = refined(setting, plain=False)
    behind = truth.vertices[:, 0] < -0.5
    moved = np.linalg.norm(mesh.vertices - dented.vertices, axis=1) / pixel
    assert moved[behind].max() < 0.05 and (moved[behind] == 0).mean() > 0.999
    assert np.array_equal(mesh.faces, dented.faces)


def test_no_round_changes_nothing(setting):
    assert refined(setting, plain=True, rounds=0) is setting[3]


def test_the_stage_refines_only_where_photos_are_matched():
    views = [camera((4.0 * np.cos(a), 4.0 * np.sin(a), 1.0), name=f"{a}.png") for a in np.arange(0, 6, 0.5)]
    scene, masks = scene_of(views, ball(1.05))
    assert find_trusted_views(scene, masks, mesh_options({"match_photos": False})).photos is None
    assert find_trusted_views(scene, masks, mesh_options({"surface": "opacity"})).photos is not None
    rough = {"smoothing": 0, "face_error": 0.0, "refine_rounds": 0, "mesh_border.photos": 0}
    plain = extract_mesh(sphere(400), scene, masks, mesh_options(rough), reporter())
    mesh = extract_mesh(sphere(400), scene, masks, mesh_options({**rough, "refine_rounds": 1}), reporter())
    assert len(mesh.faces) == len(plain.faces) and not np.array_equal(mesh.vertices, plain.vertices)


def test_either_surface_is_matched_and_refined_and_knows_its_confidence():
    """Eq. 25 on equal terms: the same photos, the same confidence, the same cleaning, and a border that is trimmed only
    where photos are matched."""
    views = [camera((4.0 * np.cos(a), 4.0 * np.sin(a), 1.0), name=f"{a}.png") for a in np.arange(0, 6, 0.5)]
    scene, masks = scene_of(views, ball(1.05))
    given = {"smoothing": 0, "face_error": 0.0, "surface": "opacity", "flatten": False}
    steps = [
        {"match_photos": False, "drop_unseen": False, "span_dents": False},
        {"match_photos": False},
        {"refine_rounds": 0},
        {"refine_rounds": 1},
    ]
    bare, known, matched, moved = (
        extract_mesh(sphere(400), scene, masks, mesh_options({**given, **step}), reporter()) for step in steps
    )
    assert not bare.values
    for mesh in (known, matched, moved):
        assert {"views", "confidence"} <= set(mesh.values) and mesh.values["confidence"].max() > 0.3
    assert len(known.faces) == len(matched.faces) == len(moved.faces)
    assert not np.array_equal(known.vertices, matched.vertices)
    assert not np.array_equal(matched.vertices, moved.vertices)
