# SPDX-License-Identifier: GPL-3.0-or-later
"""The masks' vote on faces cuts what they call background, and nothing of the building."""

from __future__ import annotations

import numpy as np
import trimesh
from support.analytic import ball, cuboid, ring, scene_of

from mgf_engine.geometry.clean import large_parts, with_faces
from mgf_engine.mesh.mask_votes import MaskVoteOptions, cut_background
from mgf_engine.model.masks import BACKGROUND, IGNORE
from mgf_engine.model.mesh import Mesh


def ball_with_skirt() -> Mesh:
    """A ball of radius 1 and a flat ring around its waist that reaches out to 1.3."""
    truth = ball()
    skirt = trimesh.creation.annulus(0.95, 1.3, 0.02, sections=96).subdivide().subdivide()
    vertices = np.concatenate([truth.vertices, skirt.vertices])
    faces = np.concatenate([truth.faces, skirt.faces + len(truth.vertices)]).astype(np.int32)
    return Mesh(vertices, faces, np.zeros((len(vertices), 3), np.uint8))


def test_a_skirt_of_ground_goes_and_the_building_stays() -> None:
    scene, masks = scene_of(ring(16), ball())
    cut = cut_background(ball_with_skirt(), scene.views, masks.labels)
    cut = with_faces(cut, cut.faces[large_parts(cut, 0.01)])
    radius = np.linalg.norm(cut.vertices, axis=1)
    assert radius.max() < 1.06
    away = np.abs(cut.vertices[:, 2]) > 0.1  # where the skirt is not, the whole ball is left
    whole = ball()
    assert away.sum() == (np.abs(whole.vertices[:, 2]) > 0.1).sum()


def test_what_removed_faces_hid_is_tested_in_the_next_round() -> None:
    """A box within a box beside the building: no photo sees the inner one before the outer one is gone."""
    scene, masks = scene_of(ring(16), ball())
    parts = [ball(), cuboid((0.12, 0.12, 0.12)), cuboid((0.06, 0.06, 0.06))]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    places = np.array([[0, 0, 0], [0, 0, 1.3], [0, 0, 1.3]])
    vertices = np.concatenate([part.vertices + place for part, place in zip(parts, places, strict=True)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    mesh = Mesh(vertices, faces.astype(np.int32), np.zeros((len(vertices), 3), np.uint8))

    def inner(rounds: int) -> int:
        cut = cut_background(mesh, scene.views, masks.labels, options=MaskVoteOptions(rounds=rounds))
        return int((np.abs(cut.vertices[cut.faces] - places[2]).max((1, 2)) < 0.07).sum())

    assert inner(1) == len(parts[2].faces) and inner(3) == 0


def test_a_mask_that_is_wrong_is_outvoted() -> None:
    scene, masks = scene_of(ring(16), ball())
    labels = list(masks.labels)
    labels[3] = np.full_like(labels[3], BACKGROUND)
    mesh = ball()
    assert len(cut_background(mesh, scene.views, labels).faces) == len(mesh.faces)


def test_what_nobody_knows_stays() -> None:
    scene, masks = scene_of(ring(16), ball())
    mesh = ball_with_skirt()
    labels = [np.full_like(label, IGNORE) for label in masks.labels]
    assert len(cut_background(mesh, scene.views, labels).faces) == len(mesh.faces)
