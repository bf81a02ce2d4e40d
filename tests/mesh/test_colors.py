# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from support.analytic import ball, camera, ring
from support.meshes import empty

from benchmarks.synthetic.meshes import merged
from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.geometry.rasterize import corners, render_mesh
from mgf_engine.mesh.colors import ColorOptions, _samples, color_from_photos
from mgf_engine.model.pixels import sample_pixels


def true_color(points: np.ndarray) -> np.ndarray:
    """A smooth pattern on space, [N, 3] in 0..255."""
    return 127 + 100 * np.sin(2.0 * points + np.array([0.0, 1.0, 2.0]))


def photographed(mesh, view):
    """What a camera sees of a mesh painted with the pattern, and where."""
    buffers = render_mesh(mesh, view)
    rows, columns = np.nonzero(buffers.face >= 0)
    depth = buffers.depth[rows, columns]
    local = np.column_stack([(columns + 0.5 - view.cx) / view.fx, (rows + 0.5 - view.cy) / view.fy, np.ones(len(rows))])
    points = (local * depth[:, None] - view.translation) @ view.rotation
    photo = np.zeros((view.height, view.width, 3), np.uint8)
    photo[rows, columns] = true_color(points)
    return photo, buffers.face >= 0


def test_vertices_take_the_color_of_their_place():
    mesh, views = ball(subdivisions=4), ring(12)
    photos = [photographed(mesh, v) for v in views]
    colored = color_from_photos(mesh, views, lambda i: photos[i][0], [p[1] for p in photos])
    error = np.abs(colored.colors - true_color(mesh.vertices)).max(1)
    assert np.median(error) < 4 and np.quantile(error, 0.98) < 15


def test_one_bad_photo_among_several_is_left_out():
    mesh, views = ball(subdivisions=3), ring(12)
    photos = [photographed(mesh, v) for v in views]
    spoiled = [np.where(i == 3, 255 - p[0], p[0]).astype(np.uint8) for i, p in enumerate(photos)]
    inside = [p[1] for p in photos]
    good = color_from_photos(mesh, views, lambda i: photos[i][0], inside).colors.astype(int)
    robust = color_from_photos(mesh, views, lambda i: spoiled[i], inside).colors.astype(int)
    assert np.mean(np.abs(good - robust).max(1) < 20) > 0.97


def test_hidden_vertices_do_not_take_what_hides_them():
    hidden, screen = ball(0.3, 3), ball(0.6, 3)
    mesh = merged(hidden, replace(screen, vertices=screen.vertices + np.array([1.5, 0, 0])))
    view = camera((4.0, 0, 0))
    photo = np.zeros((view.height, view.width, 3), np.uint8)
    photo[:] = (250, 0, 0)
    inside = np.ones(photo.shape[:2], bool)
    seen = color_from_photos(mesh, [view], lambda i: photo, [inside])
    assert (seen.colors == (250, 0, 0)).all()  # nothing else is known, so the colour is spread
    side = camera((0.0, 4.0, 0.0))
    blue = np.zeros_like(photo)
    blue[:] = (0, 0, 250)
    both = color_from_photos(mesh, [view, side], lambda i: (photo, blue)[i], [inside, inside])
    small = both.colors[: len(hidden.vertices)]
    assert (small == (0, 0, 250)).all(1).mean() > 0.9


def test_nothing_seen_and_nothing_there():
    away = camera((4.0, 0, 0), target=(8.0, 0, 0))
    photo = np.zeros((away.height, away.width, 3), np.uint8)
    inside = np.ones(photo.shape[:2], bool)
    grey = color_from_photos(ball(subdivisions=2), [away], lambda i: photo, [inside]).colors
    assert (grey == 160).all()
    assert color_from_photos(empty(), [away], lambda i: photo, [inside]).colors.shape == (0, 3)


def test_vertices_are_seen_as_the_plain_formulas_say() -> None:
    mesh, view = ball(subdivisions=4), camera((2.5, -2.0, 1.0))
    rng = np.random.default_rng(3)
    photo = rng.integers(0, 256, (view.height, view.width, 3), dtype=np.uint8)
    inside = rng.random((view.height, view.width)) < 0.9
    normals = vertex_normals(mesh)
    index, weight, shown = _samples(mesh, normals, view, photo, inside, ColorOptions())

    at = corners(mesh.vertices, view)
    farthest = cv2.dilate(render_mesh(mesh, view).depth, np.ones((3, 3), np.uint8))
    expected = []
    for i, (u, v, inverse) in enumerate(at):
        if not (inverse > 0 and 1 < u < view.width - 1 and 1 < v < view.height - 1 and inside[int(v), int(u)]):
            continue
        toward = view.centre - mesh.vertices[i]
        distance = np.linalg.norm(toward)
        facing = normals[i] @ toward / distance
        if farthest[int(v), int(u)] * (1 + ColorOptions.hidden) * inverse >= 1 and facing > ColorOptions.least_facing:
            expected.append((i, (facing * view.fx / distance) ** 2))
    assert 300 < len(expected) < len(at) / 2
    np.testing.assert_array_equal(index, [i for i, _ in expected])
    np.testing.assert_allclose(weight, [w for _, w in expected], rtol=1e-6)
    np.testing.assert_array_equal(shown, sample_pixels(photo, at[index, :2]))
