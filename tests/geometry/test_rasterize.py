# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from support.analytic import ball, camera, cuboid, ring
from support.rays import pixel_rays

from mgf_engine.geometry.rasterize import NEAR, corners, face_normals, render_mesh, scaled_view, shaded
from mgf_engine.mesh.face_visibility import count_pixels, count_uncovered
from mgf_engine.model.masks import BACKGROUND, IGNORE
from mgf_engine.model.mesh import Mesh
from mgf_engine.native import library


def empty() -> Mesh:
    return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))


def test_depth_of_a_sphere_is_that_of_its_equation():
    view = camera((4.0, 1.0, 0.5))
    buffers = render_mesh(ball(subdivisions=6), view)
    rows, columns = np.nonzero(buffers.face >= 0)
    rays, centre = pixel_rays(view, rows, columns), view.centre
    along = -(rays @ centre)
    distance = along - np.sqrt(np.maximum(along**2 - (centre @ centre - 1), 0))
    depth = distance * (rays @ view.rotation[2])
    error = np.abs(buffers.depth[rows, columns] - depth)
    assert np.median(error) < 1e-3 and len(rows) > 3000
    silhouette = np.pi * (view.fx / np.sqrt(centre @ centre - 1)) ** 2
    assert abs(len(rows) - silhouette) / silhouette < 0.03


def test_no_cracks_between_triangles():
    buffers = render_mesh(cuboid(), camera((3.1, 2.3, 1.7)))
    inside = buffers.face >= 0
    for row in inside[inside.any(1)]:
        columns = np.flatnonzero(row)
        assert row[columns[0] : columns[-1] + 1].all()


def test_nearer_mesh_hides_the_farther():
    small, view = ball(0.3, 3), camera((4.0, 0, 0))
    both = Mesh(
        np.concatenate([ball().vertices, small.vertices + np.array([2.0, 0, 0])]),
        np.concatenate([ball().faces, small.faces + len(ball().vertices)]).astype(np.int32),
        np.zeros((len(ball().vertices) + len(small.vertices), 3), np.uint8),
    )
    buffers = render_mesh(both, view)
    assert buffers.face[view.height // 2, view.width // 2] >= len(ball().faces)


def test_faces_behind_or_at_the_camera_and_odd_sizes():
    mesh = ball()
    assert (render_mesh(mesh, camera((4.0, 0, 0), target=(8.0, 0, 0))).face == -1).all()
    inside = render_mesh(mesh, camera((0.1, 0, 0.1)))  # a camera in the ball sees it all around
    assert (inside.face >= 0).all()
    for width, height in ((1, 1), (7, 33), (640, 2)):
        assert render_mesh(mesh, camera((4.0, 0, 0), width=width, height=height)).face.shape == (height, width)
    broken = replace(mesh, vertices=np.where(mesh.vertices > 0.99, np.nan, mesh.vertices))
    assert np.isfinite(render_mesh(broken, camera((4.0, 0, 0))).depth).all()


def test_nothing_to_see():
    buffers = render_mesh(empty(), camera((4.0, 0, 0)))
    assert (buffers.face == -1).all() and (buffers.depth == 0).all()
    assert (shaded(empty(), camera((4.0, 0, 0))) == 255).all()


def test_same_result_for_any_number_of_threads():
    library.set_threads(1)
    alone = render_mesh(ball(), camera((3.0, 1, 1)))
    library.set_threads(3)
    together = render_mesh(ball(), camera((3.0, 1, 1)))
    library.set_threads(0)
    assert np.array_equal(alone.face, together.face) and np.array_equal(alone.depth, together.depth)


def test_picture_is_lit_from_the_camera_and_marks_back_faces():
    view = camera((4.0, 0, 0))
    picture = shaded(ball(), view)
    centre, rim = picture[view.height // 2, view.width // 2], picture[view.height // 2, view.width // 2 + 43]
    assert picture.shape == (view.height, view.width, 3) and (picture[0, 0] == 255).all()
    assert centre[0] > rim[0] + 20 and centre[0] == centre[1] == centre[2]
    turned = shaded(replace(ball(), faces=ball().faces[:, ::-1].copy()), view)
    assert turned[view.height // 2, view.width // 2, 0] > turned[view.height // 2, view.width // 2, 2] + 30


def test_light_from_the_side_shows_what_light_from_the_camera_hides():
    view = camera((4.0, 0, 0), width=200, height=200)
    y, z = np.meshgrid(np.linspace(-0.8, 0.8, 33), np.linspace(-0.8, 0.8, 33))
    row = np.arange(32 * 33).reshape(32, 33)[:, :-1].ravel()
    faces = np.concatenate([np.stack([row, row + 1, row + 34], 1), np.stack([row, row + 34, row + 33], 1)])
    bumps = 0.004 * np.random.default_rng(0).standard_normal(y.size)  # slopes of a few degrees
    wall = Mesh(np.c_[bumps, y.ravel(), z.ravel()], faces.astype(np.int32), np.zeros((y.size, 3), np.uint8))
    front, side = (shaded(wall, view, from_side=lit)[60:140, 60:140, 0].astype(float) for lit in (False, True))
    assert side.std() / side.mean() > 5 * front.std() / front.mean()
    assert (shaded(wall, view, from_side=True)[0, 0] == 255).all()


def test_scaled_view_keeps_directions():
    view = camera((4.0, 0, 0))
    twice = scaled_view(view, 2)
    point = np.array([[0.3, 0.2, -0.1]])
    assert np.allclose(2 * view.project(point)[0], twice.project(point)[0])


def test_a_large_mesh_is_quick():
    mesh = ball(subdivisions=7)  # 330,000 faces
    started = time.process_time()
    render_mesh(mesh, camera((4.0, 0, 0), width=750, height=500, focal=700))
    assert time.process_time() - started < 3.0  # takes about 0.2 s; the bound only catches a change of kind


def test_corners_are_projections_and_zero_behind_the_camera():
    view = camera((3.0, -2.0, 1.0))
    points = np.random.default_rng(0).normal(size=(20_000, 3)) * 3
    at = corners(points, view)
    uv, depth = view.project(points)
    front = depth > NEAR
    assert 0.2 < front.mean() < 1
    np.testing.assert_allclose(at[front, :2], uv[front], rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(at[front, 2], 1 / depth[front], rtol=1e-12)
    assert (at[~front] == 0).all()
    assert corners(np.zeros((0, 3)), view).shape == (0, 3)


@pytest.mark.parametrize("threads", [1, 3])
def test_pixels_are_counted_by_side_and_by_label(threads: int):
    mesh, views = ball(subdivisions=4), ring(5)
    mesh = replace(mesh, faces=np.where(np.arange(len(mesh.faces))[:, None] % 3, mesh.faces, mesh.faces[:, ::-1]))
    labels = [
        np.random.default_rng(k).choice([BACKGROUND, 1, 7, IGNORE], (v.height, v.width)) for k, v in enumerate(views)
    ]
    expected = np.zeros((4, len(mesh.faces)), int)
    for view, label in zip(views, labels, strict=True):
        buffers = render_mesh(mesh, view)
        rows, columns = np.nonzero(buffers.face >= 0)
        faces, said = buffers.face[rows, columns], label[rows, columns]
        front = (face_normals(mesh)[faces] * pixel_rays(view, rows, columns)).sum(1) < 0
        for row, of in zip(
            expected, (front, ~front, (said != IGNORE) & (said != BACKGROUND), said != IGNORE), strict=True
        ):
            np.add.at(row, faces[of], 1)
    library.set_threads(threads)
    found = count_pixels(mesh, views, [label.astype(np.uint8) for label in labels])
    blind = count_pixels(mesh, views)
    library.set_threads(0)
    for row, column in zip(expected, (found.front, found.back, found.inside, found.known), strict=True):
        assert row.sum() > 1000 and np.array_equal(row, column)
    assert np.array_equal(blind.front, found.front) and not blind.known.any()


@pytest.mark.parametrize("threads", [1, 3])
def test_pixels_behind_faces_that_go_are_counted_as_if_all_were_drawn_again(threads: int):
    outer, views = ball(subdivisions=4), ring(5)
    faces = np.concatenate([outer.faces, outer.faces[::3], outer.faces[::5] + len(outer.vertices)])  # some twice
    mesh = Mesh(
        np.concatenate([outer.vertices, 0.7 * outer.vertices]), faces, np.zeros((2 * len(outer.vertices), 3), np.uint8)
    )
    views.append(replace(views[0], translation=-views[0].rotation @ np.array([0.85, 0.0, 0.0])))  # between both
    rng = np.random.default_rng(0)
    labels = [rng.choice([BACKGROUND, 1, IGNORE], (v.height, v.width)).astype(np.uint8) for v in views]
    middle = mesh.vertices[mesh.faces].mean(1)
    library.set_threads(threads)
    before = count_pixels(mesh, views, labels)
    for left in (middle[:, 2] < 0.5, rng.random(len(mesh.faces)) < 0.9, middle[:, 2] < -0.6):
        expected = count_pixels(replace(mesh, faces=mesh.faces[left]), views, labels)
        found = count_uncovered(mesh, left, before, views, labels)
        for name in ("front", "back", "inside", "known"):
            assert np.array_equal(getattr(found, name)[left], getattr(expected, name))
        for some, all_ in zip(found.face_images, expected.face_images, strict=True):
            seen = all_.unpacked()
            assert np.array_equal(some.unpacked(), np.where(seen >= 0, np.flatnonzero(left)[seen], -1))
    library.set_threads(0)


def test_faces_from_behind_are_grey_where_colors_mean_something():
    """Reddish, they would look like another confidence."""
    mesh = replace(ball(subdivisions=2), colors=np.full((162, 3), (0, 200, 0), np.uint8))
    inside_out = replace(mesh, faces=np.ascontiguousarray(mesh.faces[:, ::-1]))
    view = camera((4.0, 1.0, 0.5))
    front, behind = (shaded(m, view, color=True, grey_behind=True) for m in (mesh, inside_out))
    shown = (front != 255).any(-1)
    assert (front[shown, 1] > front[shown, 0]).all()
    assert np.ptp(behind[shown].astype(int), axis=1).max() == 0 and (behind[shown] < 255).all()
