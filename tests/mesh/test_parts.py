# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import trimesh
from support.analytic import ball, mesh_of, ring, scene_of

from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.mesh.parts import face_parts, named_parts, write_parts


def painted(truth, named):
    """Scene and masks where the upper half of ``truth`` has label 2 or 3, by view, in the views ``named``."""
    views = ring(12)
    scene, masks = scene_of(views, truth, grow=0)
    upper = truth.vertices[truth.faces].mean(1)[:, 2] > 0
    labels = []
    for i, view in enumerate(views):
        buffers = render_mesh(truth, view)
        label = masks.labels[i].copy()
        if i in named:
            label[(buffers.face >= 0) & upper[buffers.face]] = 2 + i % 2
        labels.append(label)
    elements = {i: [2 + i % 2] for i in named}
    return scene, replace(masks, labels=tuple(labels)), elements, upper


def test_faces_take_the_part_that_most_photos_show():
    truth = ball(subdivisions=5)
    scene, masks, elements, upper = painted(truth, range(12))
    face = face_parts(truth, scene, masks, [elements, {}])
    middle = np.abs(truth.vertices[truth.faces].mean(1)[:, 2]) < 0.1
    assert set(np.unique(face)) == {0, 1}
    assert ((face == 1) == upper)[~middle].mean() > 0.97


def test_photos_without_a_named_part_do_not_outvote_those_with_one():
    truth = ball(subdivisions=5)
    scene, masks, elements, upper = painted(truth, [0, 1, 2])
    face = face_parts(truth, scene, masks, [elements])
    assert 0.1 < (face[upper] == 1).mean() < 1 and (face[~upper] == 1).mean() < 0.03


def test_hidden_faces_and_unused_photos_take_no_part():
    both = trimesh.util.concatenate([trimesh.creation.icosphere(5), trimesh.creation.icosphere(3, radius=0.5)])
    truth = mesh_of(both)
    scene, masks, elements, _ = painted(truth, range(12))
    inner = np.linalg.norm(truth.vertices[truth.faces].mean(1), axis=1) < 0.7
    assert (face_parts(truth, scene, masks, [elements])[inner] == 0).all()
    unused = replace(masks, used=np.zeros(12, bool))
    assert not face_parts(truth, scene, unused, [elements]).any()


def test_only_what_the_user_named_is_a_part(tmp_path):
    scene, _ = scene_of(ring(2), ball())
    names = [v.name for v in scene.views]
    listed = [
        {"name": "element-1", "elements": [[names[0], 5]]},
        {"name": "door", "elements": [[names[0], 2], [names[0], 4], ["gone.jpg", 9]]},
        {"name": "door", "elements": [[names[-1], 3]]},
    ]
    (tmp_path / "parts.json").write_text(json.dumps({"parts": listed}))
    found = named_parts(tmp_path, scene)
    assert list(found) == ["door"] and found["door"][0][:2] == [2, 4]
    (tmp_path / "parts.json").write_text("{")
    assert named_parts(tmp_path, scene) == {} == named_parts(tmp_path / "none", scene)


def test_the_file_holds_names_and_faces(tmp_path):
    write_parts(["door"], np.array([0, 1, 1], np.uint8), tmp_path / "mesh_parts.npz")
    with np.load(tmp_path / "mesh_parts.npz") as data:
        assert data["names"].tolist() == ["building", "door"] and data["face"].tolist() == [0, 1, 1]
    assert [p.name for p in tmp_path.iterdir()] == ["mesh_parts.npz"]
