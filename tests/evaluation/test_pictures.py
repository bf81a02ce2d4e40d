# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures for the report show what they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from mgf_engine.evaluation.pictures import (
    ERROR_LIMIT,
    error_picture,
    mask_overlay,
    normal_picture,
    on_white,
    turntable_views,
)
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, Similarity, View
from mgf_engine.scene.gravity import up_from_cameras


def test_overlay_dims_the_surroundings_and_tints_elements() -> None:
    photo = np.full((100, 120, 3), 200, np.uint8)
    labels = np.zeros((100, 120), np.uint8)
    labels[20:80, 20:100] = 1
    labels[30:40, 30:40] = 2
    labels[50:60, 50:60] = 255
    picture = mask_overlay(photo, labels)
    assert (picture[:10] == 60).all()
    assert (picture[70, 70] == 200).all()
    assert (picture[35, 35] != 200).any() and (picture[55, 55] != picture[35, 35]).any()
    assert picture[20, 60].tolist() == [255, 255, 0]  # the outline
    assert picture[55, 55].tolist() == [200, 158, 98]  # ochre, as on the contact sheet
    assert (photo == 200).all()


def test_normals_are_colors_of_directions() -> None:
    normals = np.zeros((1, 4, 3))
    normals[0, 0] = (0, 0, -2.0)  # towards the camera, any length
    normals[0, 1] = (1, 0, 0)
    normals[0, 2] = (0, -1, 0)  # up
    normals[0, 3] = (1, 0, 0)
    picture = normal_picture(normals, np.array([[1.0, 1.0, 1.0, 0.0]]))
    assert picture[0].tolist() == [[127, 127, 255], [255, 127, 127], [127, 255, 127], [255, 255, 255]]


def test_error_grows_brighter_and_stays_inside() -> None:
    photo = np.full((4, 40, 3), 100, np.uint8)
    render = photo + np.linspace(0, ERROR_LIMIT * 255, 40).astype(np.uint8)[None, :, None]
    mask = np.ones((4, 40), bool)
    mask[3] = False
    picture = error_picture(photo, render, mask).astype(int).sum(-1)
    assert picture[0, -1] > picture[0, 20] > picture[0, 0]
    assert (picture[3] == picture[3, 0]).all()
    assert (on_white(render, mask)[3] == 255).all()


def scene_of(centres: np.ndarray, rotations: list[np.ndarray] | None = None) -> Scene:
    """Cameras at the given centres, upright (world y is down) where no rotations are given."""
    rotations = rotations or [np.eye(3)] * len(centres)
    views = tuple(
        View(f"{i}", "", 60, 40, 50.0, 50.0, 30.0, 20.0, r, -r @ c, 60, 40)
        for i, (c, r) in enumerate(zip(centres, rotations, strict=True))
    )
    empty = np.empty((0, 3))
    return Scene(
        views, empty, empty.astype(np.uint8), np.empty(0, np.float32), np.zeros(1, np.int64), np.empty(0, np.int32),
        np.empty((0, 2), np.float32), Similarity(1.0, np.eye(3), np.zeros(3)), (), (), Path(),
    )  # fmt: skip


def test_up_is_found_although_all_cameras_look_down() -> None:
    """Half a ring of cameras tilted by 40 degrees: the mean of the photos' up leans over, their sides stay level."""
    views = []
    for angle in np.linspace(0, np.pi, 9):
        forward = np.array([-np.cos(angle), 0.84, -np.sin(angle)])
        forward /= np.linalg.norm(forward)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        views.append(np.stack([right, np.cross(forward, right), forward]))
    scene = scene_of(np.zeros((9, 3)), views)
    assert np.allclose(up_from_cameras(scene.views), [0, -1, 0], atol=1e-9)
    mean = -np.mean([v[1] for v in views], axis=0)
    assert mean[1] / np.linalg.norm(mean) > -0.95


@pytest.mark.parametrize(
    "centres",
    [
        np.array([[0.0, 0, -5], [1, 0, -5]]),  # one side only
        np.array([[0.0, 0, -5], [0, 0, 5], [5, 0, 0], [-5, 0, 0]]),  # all around
        np.array([[0.0, -5, 0]]),  # straight above
    ],
)
def test_the_whole_mesh_is_in_every_picture_upright(centres: np.ndarray) -> None:
    box = trimesh.creation.box((1.0, 2.0, 0.5)).subdivide().subdivide()
    mesh = Mesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32), np.zeros((len(box.vertices), 3), np.uint8))
    views = turntable_views(mesh, scene_of(centres), 8, (160, 120))
    assert len(views) == 8
    for view in views:
        assert np.allclose(view.rotation @ view.rotation.T, np.eye(3)) and np.linalg.det(view.rotation) > 0
        uv, depth = view.project(mesh.vertices)
        assert (depth > 0).all() and (uv >= 0).all() and (uv <= (160, 120)).all()
        assert np.ptp(uv, axis=0).max() > 80  # and it fills a good part of the frame
        top, bottom = uv[mesh.vertices[:, 1] < -0.99].mean(0), uv[mesh.vertices[:, 1] > 0.99].mean(0)
        assert top[1] < bottom[1]
    spots = np.array([view.centre for view in views])
    assert np.linalg.norm(spots - np.roll(spots, 1, 0), axis=1).min() > 0.5


def test_a_long_facade_fills_the_pictures() -> None:
    slab = trimesh.creation.box((8.0, 2.0, 0.3)).subdivide().subdivide().subdivide()
    mesh = Mesh(
        np.asarray(slab.vertices), np.asarray(slab.faces, np.int32), np.zeros((len(slab.vertices), 3), np.uint8)
    )
    views = turntable_views(mesh, scene_of(np.array([[0.0, 0, -5]])), 8, (160, 120))
    reach = [np.ptp(view.project(mesh.vertices)[0], axis=0) / (160, 120) for view in views]
    assert 0.85 < np.max(reach) < 1 and len({view.fx for view in views}) == 1


def test_a_spire_of_few_vertices_is_in_the_picture_and_a_splinter_far_off_is_not() -> None:
    box = trimesh.creation.box((1.0, 2.0, 1.0)).subdivide().subdivide().subdivide()
    tip, splinter = [[0.0, -1.5, 0.0]], [[0.0, 60.0, 0.0]]  # up is minus y
    vertices = np.concatenate([np.asarray(box.vertices), tip, splinter])
    mesh = Mesh(vertices, np.asarray(box.faces, np.int32), np.zeros((len(vertices), 3), np.uint8))
    for view in turntable_views(mesh, scene_of(np.array([[0.0, 0, -5]])), 4, (160, 120)):
        uv, _ = view.project(vertices)
        assert (uv[:-1] >= 0).all() and (uv[:-1] <= (160, 120)).all()
        assert np.ptp(uv[:-1], axis=0).max() > 40
