# SPDX-License-Identifier: GPL-3.0-or-later
"""A column before a wall: rays to the wall behind it must not cut it away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.scene import View
from mgf_engine.start.cut import cut_surface
from mgf_engine.start.dense import DensePoints
from mgf_engine.start.evidence import gather_evidence
from mgf_engine.start.options import StartOptions
from mgf_engine.start.planes import fit_planes_to_lines
from mgf_engine.start.views import Silhouettes, StartViews

PIXEL = 0.01
WIDTH, HEIGHT, FOCAL = 200, 150, 400.0
RADIUS, BEFORE = 8 * PIXEL, 60 * PIXEL  # of the column, and how far its axis stands before the wall


def camera(x: float) -> View:
    """A camera 4 before the wall y = 0 that looks straight at it."""
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return View(f"{x}", f"{x}.png", WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, rotation,
                -rotation @ [x, -4.0, 0], WIDTH, HEIGHT, None)  # fmt: skip


def column_and_wall(cameras: list[View], noise: float = 0.5, kept_share: float = 0.4) -> DensePoints:
    """Points 3 px apart with noise across the wall, in px; only a share of the column's."""
    rng = np.random.default_rng(0)
    x, z = (3 * PIXEL * grid.ravel() for grid in np.mgrid[-26:27, -18:19])
    behind = np.stack([x, 0 * x, z], 1)
    angle, height = (grid.ravel() for grid in np.meshgrid(np.radians(np.arange(-80, 81, 20)), np.unique(z)))
    front = np.stack([RADIUS * np.sin(angle), -BEFORE - RADIUS * np.cos(angle), height], 1)
    points = np.concatenate([behind, front])
    shown = np.zeros((len(points), len(cameras)), bool)
    for n, view in enumerate(cameras):
        to = view.centre - points
        across = to[:, 0] * (-BEFORE - points[:, 1]) + to[:, 1] * points[:, 0]
        hidden = np.abs(across) < RADIUS * np.linalg.norm(to[:, :2], axis=1)
        facing = ((points - [0, -BEFORE, 0]) * to)[:, :2].sum(1) > RADIUS**2
        shown[:, n] = np.where(np.arange(len(points)) < len(behind), ~hidden, facing)
    kept = (shown.sum(1) >= 2) & (
        rng.random(len(points)) < np.where(np.arange(len(points)) < len(behind), 1, kept_share)
    )
    normals = np.concatenate([np.tile([0.0, -1, 0], (len(behind), 1)),
                              np.stack([np.sin(angle), -np.cos(angle), 0 * angle], 1)])  # fmt: skip
    points[:, 1] += rng.normal(0, noise * PIXEL, len(points))
    seen = [np.flatnonzero(row) for row in shown[kept]]
    return DensePoints(points[kept], seen, np.full(len(seen), 0.3), normals[kept])


@pytest.fixture(scope="module")
def views() -> StartViews:
    cameras = [camera(x) for x in np.linspace(-1.5, 1.5, 9)]
    labels = [np.ones((HEIGHT, WIDTH), np.uint8)] * len(cameras)
    box = np.array([[-1.2, -1.2, -1.2], [1.2, 0.6, 1.2]])
    return StartViews(None, list(range(9)), cameras, labels, Silhouettes.of(cameras, labels),  # type: ignore[arg-type]
                      np.zeros((0, 3)), [], PIXEL, box[0], box[1], np.zeros((0, 3)))  # fmt: skip


def column_share(views: StartViews, options: StartOptions) -> float:
    """Share of the column's middle that the middle camera sees within 5 px of its depth."""
    dense = column_and_wall(views.views)
    planes = fit_planes_to_lines([], PIXEL, options.planes)
    mesh, _ = cut_surface(views, gather_evidence(views, [], planes, dense, options), options.cut, lambda: None)
    view = views.views[4]
    depth = render_mesh(mesh, view).depth[25:-25, WIDTH // 2 - 3 : WIDTH // 2 + 3]
    return float((np.abs(depth - (4 - BEFORE - RADIUS)) < 5 * PIXEL).mean())


def test_a_column_before_a_wall_stays(views: StartViews) -> None:
    assert column_share(views, StartOptions()) > 0.9


def test_points_that_hardly_speak_for_what_lies_behind_them_let_rays_to_the_wall_cut_it_away(views: StartViews) -> None:
    o = StartOptions()
    assert column_share(views, replace(o, cut=replace(o.cut, off_surface=0.0, behind=0.3, depth=2.0))) < 0.5
