# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry of the synthetic buildings: known sizes, real openings, outward faces."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from benchmarks import buildings
from benchmarks.buildings import BUILDINGS
from benchmarks.scenes import element_ids
from benchmarks.shapes import Builder, Casing, Opening, Part, true_mesh, wall_row
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.model.masks import BUILDING, FIRST_ELEMENT, IGNORE


def area(parts: list[Part]) -> float:
    t = np.concatenate([p.triangles() for p in parts])
    return float(0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum())


def volume(parts: list[Part]) -> float:
    """Signed volume by the divergence theorem: positive for outward faces."""
    t = np.concatenate([p.triangles() for p in parts])
    return float(np.einsum("nd,nd->n", t[:, 0], np.cross(t[:, 1], t[:, 2])).sum() / 6)


def test_box_has_outward_faces() -> None:
    b = Builder()
    b.box((1, 2, 3), (2, 4, 6), "stone")
    assert volume(b.parts()) == pytest.approx(1 * 2 * 3)
    assert area(b.parts()) == pytest.approx(2 * (2 + 3 + 6))


def test_beam_has_its_length_and_width() -> None:
    b = Builder()
    b.beam((0, 0, 0), (3, 4, 12), 0.2, "steel")
    assert volume(b.parts()) == pytest.approx(13 * 0.04)


def test_roof_slab_has_its_thickness() -> None:
    b = Builder()
    b.roof_slab([(0, 0, 0), (4, 0, 0), (4, 3, 4), (0, 3, 4)], 0.1, "tiles", "wood", "roof")
    assert volume(b.parts()) == pytest.approx(4 * 5 * 0.1)


def test_wall_leaves_out_its_openings() -> None:
    b = Builder()
    b.wall((0, 0), (10, 0), (0, 4), "brick", [Opening(2, 1, 4, 3, "void")], "south", casing=Casing(trim="stone"))
    brick = [p for p in b.parts() if p.material == "brick"]
    assert area(brick) == pytest.approx(10 * 4 - 2 * 2)
    reveals = [p for p in b.parts() if p.material == "stone"]
    assert area(reveals) == pytest.approx(8 * 0.18)
    corners = brick[0].triangles()
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 1] < 0).all()  # seen from the south


def test_windows_lie_inside_the_wall_and_frames_in_front_of_the_glass() -> None:
    b = Builder()
    b.wall((0, 0), (6, 0), (0, 3), "brick", wall_row(6, 2, 1.2, 1.0, 1.4), "south")
    parts = {p.material: p for p in b.parts() if "window" in p.element}
    assert parts["glass"].vertices[:, 1] == pytest.approx(0.18)
    assert parts["frame"].vertices[:, 1].min() == pytest.approx(0.12)
    assert {p.element for p in b.parts()} >= {"south", "south.window0", "south.window1"}


@pytest.mark.parametrize("kind", sorted(BUILDINGS))
def test_every_building_is_a_sound_true_mesh(kind: str) -> None:
    parts = BUILDINGS[kind]("brick")
    vertices, faces = true_mesh(parts)
    surface = Surface(vertices, faces.astype(np.int64))
    assert surface.areas.sum() == pytest.approx(area(parts), rel=1e-3)
    assert vertices[:, 2].min() > -0.1  # ends of slanting beams dip into the ground
    assert 5 < np.ptp(vertices[:, 2]) < 40
    assert len(np.unique(vertices, axis=0)) == len(vertices)
    # Normals point away from the building: just outside a face the nearest face is that face or a neighbour in front.
    points, face = surface.sample(2000, np.random.default_rng(0))
    corners = vertices[faces[face]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    middle = vertices.mean(0)
    high = points[:, 2] > np.quantile(points[:, 2], 0.2)
    outwards = -1 if kind == "plaster_court" else 1  # what stands around a court faces its middle
    assert outwards * ((points - middle) * normal).sum(1)[high].mean() > 0.5


def test_element_ids_stay_inside_the_labels_even_with_many_elements() -> None:
    many = [Part(f"p{i}", "glass", np.zeros((3, 3)), ((0, 1, 2),), f"window{i}") for i in range(400)]
    ids = element_ids(many)
    assert ids[""] == BUILDING
    values = {v for k, v in ids.items() if k}
    assert min(values) == FIRST_ELEMENT and max(values) < IGNORE
    hall = element_ids(BUILDINGS["town_hall"]("brick"))
    assert len(set(hall.values())) == len(hall)


def test_only_the_building_is_in_the_true_mesh() -> None:
    tri = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    parts = [Part("a", "brick", tri, ((0, 1, 2),)), Part("b", "leaves", tri + 5, ((0, 1, 2),), building=False)]
    vertices, faces = true_mesh(parts)
    assert len(faces) == 1 and vertices.max() == 1


@pytest.mark.parametrize("kind", sorted(BUILDINGS))
def test_every_material_of_a_building_can_be_rendered(kind: str) -> None:
    source = Path(buildings.__file__).with_name("blender") / "materials.py"  # it imports bpy, which is not here
    tables = [n for n in ast.walk(ast.parse(source.read_text(encoding="utf-8"))) if isinstance(n, ast.AnnAssign)]
    (table,) = (n.value for n in tables if isinstance(n.target, ast.Name) and n.target.id == "MATERIALS")
    assert isinstance(table, ast.Dict)
    known = {key.value for key in table.keys if isinstance(key, ast.Constant)}
    assert {p.material for p in BUILDINGS[kind]("brick")} <= known
