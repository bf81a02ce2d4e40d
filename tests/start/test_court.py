# SPDX-License-Identifier: GPL-3.0-or-later
"""A court that photos are taken in: no mask tells that it is free, only the rays to its walls do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.scene import View
from mgf_engine.start.cut import cut_surface
from mgf_engine.start.dense import DensePoints
from mgf_engine.start.evidence import gather_evidence
from mgf_engine.start.options import MinimumCutOptions, StartOptions
from mgf_engine.start.planes import fit_planes_to_lines
from mgf_engine.start.views import Silhouettes, StartViews

PIXEL = 0.01
WIDTH, HEIGHT, FOCAL = 200, 150, 400.0
DEPTH = 4.0  # from the cameras to either wall
LARGE = MinimumCutOptions(volume=1.5e-3)  # as if the court were half as wide again


def camera(x: float, towards: int) -> View:
    """A camera in the middle, y = 0, that looks along +y or -y at a wall that fills its photo."""
    rotation = np.array([[towards, 0, 0], [0, 0, -1], [0, towards, 0]], float)
    return View(f"{x} {towards}", "", WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, rotation,
                -rotation @ [x, 0, 0], WIDTH, HEIGHT, None)  # fmt: skip


def court() -> tuple[StartViews, DensePoints]:
    """Two walls that face each other, and five photos of each from between them."""
    cameras = [camera(x, towards) for towards in (1, -1) for x in np.linspace(-0.5, 0.5, 5)]
    x, z = (3 * PIXEL * grid.ravel() for grid in np.mgrid[-26:27, -18:19])
    walls = [np.stack([x, np.full(len(x), towards * DEPTH), z], 1) for towards in (1, -1)]
    seen = [np.arange(5) + (0 if towards > 0 else 5) for towards in (1, -1) for _ in x]
    normals = np.repeat([[0.0, -1, 0], [0.0, 1, 0]], len(x), 0)
    labels = [np.ones((HEIGHT, WIDTH), np.uint8)] * len(cameras)
    views = StartViews(None, list(range(10)), cameras, labels, Silhouettes.of(cameras, labels),  # type: ignore[arg-type]
                       np.zeros((0, 3)), [], PIXEL, np.array([-1.0, -5, -1]), np.array([1.0, 5, 1]),
                       np.zeros((0, 3)))  # fmt: skip
    return views, DensePoints(np.concatenate(walls), seen, np.full(len(seen), 0.3), normals)


def shown_share(options: MinimumCutOptions) -> float:
    """Share of the middle of two photos, one of each wall, that shows the wall within 5 px of its depth."""
    (views, dense), o = court(), replace(StartOptions(), cut=options)
    planes = fit_planes_to_lines([], PIXEL, o.planes)
    mesh, _ = cut_surface(views, gather_evidence(views, [], planes, dense, o), o.cut, lambda: None)
    depths = [render_mesh(mesh, views.views[k]).depth[30:-30, 40:-40] for k in (2, 7)]
    return float((np.abs(np.stack(depths) - DEPTH) < 5 * PIXEL).mean())


def test_the_court_is_free() -> None:
    assert shown_share(LARGE) > 0.95


def test_without_the_rays_its_volume_would_be_filled() -> None:
    assert shown_share(replace(LARGE, free_space=1e9)) < 0.5
