# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.analytic import as_trimesh, ball, box, cuboid, ring, scene_of
from support.mesh_stage import mesh_options

from mgf_engine.errors import BadInput
from mgf_engine.geometry.clip import clip
from mgf_engine.mesh.extract import extract_mesh
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh
from mgf_engine.scene.crop import parse_crop_box

HALF_TURNED = np.array([[0.6, 0.8, 0.0, -0.1]])


def test_areas_add_up_and_cuts_are_shared():
    whole = ball()
    parts = [clip(whole, HALF_TURNED), clip(whole, -HALF_TURNED)]
    areas = [as_trimesh(p).area for p in parts]
    assert sum(areas) == pytest.approx(as_trimesh(whole).area, rel=1e-12)
    # A cap of a sphere of radius 1 cut at distance 0.1 has 2 pi (1 - 0.1), here of an icosphere.
    assert areas[0] == pytest.approx(2 * np.pi * 0.9, rel=0.01)
    for part, sign in zip(parts, (1, -1), strict=True):
        side = sign * (part.vertices @ HALF_TURNED[0, :3] + HALF_TURNED[0, 3])
        assert side.min() > -1e-12
        closed = as_trimesh(part)
        rim = closed.edges_unique[np.bincount(closed.edges_unique_inverse) == 1]
        assert len(rim) > 20 and np.abs(side[rim]).max() < 1e-12  # open along the cut and nowhere else
        assert (
            closed.is_winding_consistent
            and (np.einsum("ij,ij->i", closed.face_normals, closed.triangles_center) > 0).all()
        )


def test_colors_go_evenly_along_cut_edges():
    triangle = Mesh(
        np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]), np.array([[0, 1, 2]], np.int32),
        np.array([[0, 0, 0], [200, 0, 0], [0, 100, 40]], np.uint8),
    )  # fmt: skip
    cut = clip(triangle, np.array([[-1.0, 0, 0, 1.0]]))  # x <= 1
    assert len(cut.faces) == 2
    at = {tuple(p): tuple(c) for p, c in zip(cut.vertices.tolist(), cut.colors.tolist(), strict=True)}
    assert at[1.0, 0.0, 0.0] == (50, 0, 0) and at[1.0, 3.0, 0.0] == (50, 75, 30)


def test_all_or_nothing():
    whole = cuboid()
    same = clip(whole, parse_crop_box("-9 -9 -9 9 9 9").planes())
    assert same is whole
    assert len(clip(whole, parse_crop_box("5 5 5 6 6 6").planes()).faces) == 0


def test_the_mesh_ends_at_the_crop_box():
    field, truth = box(0.12), cuboid()
    scene, masks = scene_of(ring(16), truth)
    reporter = Reporter(lambda message: None)
    reporter.stage("mesh")
    options = mesh_options({"level_steps": 4, "crop_box": "-2 -2 -2 0.25 2 2"})
    mesh = extract_mesh(field, scene, masks, options, reporter)
    assert mesh.vertices[:, 0].max() == pytest.approx(0.25, abs=1e-9)
    assert mesh.vertices[:, 0].min() < -0.95
    near = mesh.vertices[(mesh.vertices[:, 0] > 0.1) & (mesh.vertices[:, 0] < 0.24)]
    assert np.minimum(np.abs(np.abs(near[:, 1]) - 0.7), np.abs(np.abs(near[:, 2]) - 0.5)).max() < 0.2  # walls, no lid
    reporter.stage("mesh")
    with pytest.raises(BadInput):
        extract_mesh(field, scene, masks, mesh_options({"crop_box": "5 5 5 6 6 6"}), reporter)


def test_values_are_carried_and_new_vertices_take_those_of_the_nearer_end():
    whole = ball(subdivisions=3)
    values = {"views": np.arange(len(whole.vertices), dtype=np.int32), "x": whole.vertices[:, 0].astype(np.float32)}
    part = clip(replace(whole, values=values), HALF_TURNED)
    assert set(part.values) == {"views", "x"} and part.values["views"].dtype == np.int32
    assert np.abs(part.values["x"] - part.vertices[:, 0]).max() < 0.1
    old = np.abs(part.vertices @ HALF_TURNED[0, :3] + HALF_TURNED[0, 3]) > 1e-9
    assert old.any() and np.array_equal(part.vertices[old], whole.vertices[part.values["views"][old]])
