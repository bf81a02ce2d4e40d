# SPDX-License-Identifier: GPL-3.0-or-later
"""Marked points are placed where their rays meet, wrong marks left out, and what cannot be placed says why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import camera
from support.small_scene import make_scene

from mgf_engine.georef.control_points import ControlPoints, Mark
from mgf_engine.georef.options import MarkOptions
from mgf_engine.georef.triangulate import (
    meeting,
    outlier_limits,
    place_points,
    project_point,
    ray_of,
    triangulate,
)
from mgf_engine.georef.validation import wrong_marks
from mgf_engine.model.scene import Scene

POINT = np.array([0.2, -0.3, 0.4])


def ring(count: int = 5, original: int = 1) -> Scene:
    """Cameras on a circle of 6 around the origin; the photos as taken are ``original`` times as large."""
    angles = 2 * np.pi * np.arange(count) / count
    views = [camera((6 * np.cos(a), 6 * np.sin(a), 1.5), (0, 0, 0), name=f"{k}.jpg") for k, a in enumerate(angles)]
    views = [
        replace(v, original_width=original * v.width, original_height=original * v.height) for v in views
    ]  # fmt: skip
    return make_scene(views, np.zeros((0, 3)), [])


def marks(scene: Scene, point: np.ndarray = POINT, name: str = "P") -> list[Mark]:
    found = []
    for k, view in enumerate(scene.views):
        pixel = project_point(view, point)
        assert pixel is not None
        found.append(Mark(name, k, pixel))
    return found


@pytest.mark.parametrize("original", [1, 4])
def test_exact_marks_meet_in_the_point(original: int) -> None:
    scene = ring(original=original)
    found = triangulate(scene, tuple(marks(scene)))
    assert not isinstance(found, str)
    assert found.position == pytest.approx(POINT, abs=1e-6) and found.good.all() and found.rms < 1e-4


def test_a_mark_on_something_else_is_left_out() -> None:
    scene = ring(original=8)
    given = marks(scene)
    limit = float(outlier_limits(scene.views)[0])
    x, y = given[2].pixel
    given[2] = replace(given[2], pixel=(x + 5 * limit, y))
    found = triangulate(scene, tuple(given))
    assert not isinstance(found, str)
    assert found.good.tolist() == [True, True, False, True, True]
    assert found.position == pytest.approx(POINT, abs=1e-4)
    assert found.residuals[2, 0] == pytest.approx(-5 * limit, rel=0.01)
    (said,) = wrong_marks(scene, ControlPoints(marks=tuple(given)), {"P": found})
    assert "'P' in '2.jpg'" in said and "left out" in said
    loose = triangulate(scene, tuple(given), MarkOptions(outlier=500.0))
    assert not isinstance(loose, str) and loose.good.all()


def test_small_errors_of_clicks_are_averaged() -> None:
    scene = ring(8, original=8)
    rng = np.random.default_rng(0)
    given = [replace(m, pixel=tuple(np.add(m.pixel, rng.normal(0, 1.0, 2)).tolist())) for m in marks(scene)]
    found = triangulate(scene, tuple(given))
    assert not isinstance(found, str) and found.good.all()
    pixel = 6 / scene.views[0].fx / 8  # at the point
    assert np.linalg.norm(found.position - POINT) < 2 * pixel
    assert 0.5 < found.rms < 2.0


def test_what_cannot_be_placed_says_why() -> None:
    scene = ring()
    given = marks(scene)
    near = make_scene([camera((6, 0.001 * k, 1.5), (0, 0, 0), name=f"{k}") for k in range(3)], np.zeros((0, 3)), [])
    apart = [replace(m, pixel=(float(3 + 9 * k % 20), float(2 + 13 * k % 17))) for k, m in enumerate(given[:2])]
    placed, failed = place_points(scene, [*given, replace(given[0], point="Q"), replace(given[0], point="Q")])
    assert set(placed) == {"P"} and failed == {"Q": "marked in one photo only"}
    assert triangulate(near, tuple(marks(near))) == "marked in photos from nearly the same place only"
    assert triangulate(scene, tuple(apart), MarkOptions(outlier=0.5)) == "its marks contradict each other"


def test_rays_are_unit_and_meet_where_they_cross() -> None:
    scene = ring()
    rays = np.array([ray_of(v, m.pixel) for v, m in zip(scene.views, marks(scene), strict=True)])
    centres = np.array([v.centre for v in scene.views])
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    assert meeting(centres, rays) == pytest.approx(POINT, abs=1e-9)
    skew = meeting(np.array([[0.0, 0, 0], [0, 0, 2.0]]), np.array([[1.0, 0, 0], [0, 1.0, 0]]))
    assert skew == pytest.approx([0, 0, 1])


def test_a_point_behind_or_beside_a_photo_is_not_in_it() -> None:
    (view,) = ring(1).views
    assert project_point(view, POINT) is not None
    assert project_point(view, view.centre + 5 * (view.centre - POINT)) is None
    assert project_point(view, POINT + np.array([0.0, 50.0, 0.0])) is None
