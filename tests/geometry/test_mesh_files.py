# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from support.analytic import ball

from mgf_engine.errors import BadInput
from mgf_engine.geometry.mesh_files import (
    IMAGE,
    in_scene,
    needs_double,
    read_ply,
    read_texture,
    write_glb,
    write_obj,
    write_ply,
    write_texture,
)
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Similarity

UTM = np.array([389_123.25, 5_712_345.75, 120.0])


def colored(offset=(0.0, 0.0, 0.0)) -> Mesh:
    mesh = ball(subdivisions=2)
    colors = np.random.default_rng(0).integers(0, 256, (len(mesh.vertices), 3)).astype(np.uint8)
    return Mesh(mesh.vertices * 0.1 + np.array(offset), mesh.faces, colors)


def placed(loaded: trimesh.Scene) -> trimesh.Trimesh:
    return loaded.to_geometry()


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), UTM])
def test_ply_round_trip(tmp_path, offset):
    mesh = colored(offset)
    write_ply(mesh, tmp_path / "mesh.ply")
    read = read_ply(tmp_path / "mesh.ply")
    assert np.abs(read.vertices - mesh.vertices).max() < 1e-7
    assert np.array_equal(read.faces, mesh.faces) and np.array_equal(read.colors, mesh.colors)


def test_further_values_of_the_vertices_are_read_where_they_are_asked_for(tmp_path):
    mesh = colored()
    views = (np.arange(len(mesh.vertices)) % 7).astype(np.uint8)
    confidence = np.linspace(0, 1, len(mesh.vertices)).astype(np.float32)
    write_ply(replace(mesh, values={"views": views, "confidence": confidence}), tmp_path / "mesh.ply")
    assert not read_ply(tmp_path / "mesh.ply").values
    read = read_ply(tmp_path / "mesh.ply", ("confidence", "warmth")).values
    assert list(read) == ["confidence"] and np.array_equal(read["confidence"], confidence)


def test_further_values_are_read_from_text_as_well(tmp_path):
    columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "views"))
    header = (
        f"ply\nformat ascii 1.0\nelement vertex 3\n{columns}element face 1\nproperty list uchar int vertex_indices\n"
    )
    (tmp_path / "mesh.ply").write_text(f"{header}end_header\n0 0 0 1\n1 0 0 2\n0 1 0 3\n3 0 1 2\n")
    assert read_ply(tmp_path / "mesh.ply", ("views",)).values["views"].tolist() == [1, 2, 3]


def test_ply_is_float_near_the_origin_and_double_far_from_it(tmp_path):
    for offset, word in (((0.0, 0.0, 0.0), b"property float x"), (UTM, b"property double x")):
        write_ply(colored(offset), tmp_path / "mesh.ply")
        assert word in (tmp_path / "mesh.ply").read_bytes()[:400]
    assert not needs_double(np.zeros((0, 3)))


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), UTM])
def test_obj_keeps_coordinates_faces_and_colors(tmp_path, offset):
    mesh = colored(offset)
    write_obj(mesh, tmp_path / "mesh.obj")
    lines = [line.split() for line in (tmp_path / "mesh.obj").read_text().splitlines()]
    table = np.array([line[1:] for line in lines if line[0] == "v"], float)
    assert np.abs(table[:, :3] - mesh.vertices).max() < 1e-7
    assert np.array_equal(np.rint(table[:, 3:] * 255), mesh.colors)
    assert np.array_equal(np.array([line[1:] for line in lines if line[0] == "f"], int) - 1, mesh.faces)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), UTM])
def test_glb_carries_its_place_in_the_node(tmp_path, offset):
    mesh = colored(offset)
    write_glb(mesh, tmp_path / "mesh.glb")
    data = (tmp_path / "mesh.glb").read_bytes()
    tree = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    largest = max(abs(v) for a in tree["accessors"] if a["type"] == "VEC3" and "max" in a for v in a["max"])
    assert largest < 1.0
    read = placed(trimesh.load(tmp_path / "mesh.glb", process=False))
    assert np.abs(np.sort(read.vertices, 0) - np.sort(mesh.vertices, 0)).max() < 1e-6
    assert np.array_equal(np.asarray(read.visual.vertex_colors)[:, :3], mesh.colors)


def test_everything_is_written_in_the_scenes_own_coordinates(tmp_path):
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    similarity = Similarity(0.05, turn, -0.05 * turn @ UTM)
    scene_mesh = Mesh(colored().vertices * 200 + UTM, colored().faces, colored().colors)
    normalised = Mesh(similarity.apply(scene_mesh.vertices), scene_mesh.faces, scene_mesh.colors)
    assert np.abs(normalised.vertices).max() < 2
    assert np.abs(in_scene(normalised, similarity).vertices - scene_mesh.vertices).max() < 1e-8
    write_ply(in_scene(normalised, similarity), tmp_path / "mesh.ply")
    write_glb(in_scene(normalised, similarity), tmp_path / "mesh.glb")
    assert np.abs(read_ply(tmp_path / "mesh.ply").vertices - scene_mesh.vertices).max() < 1e-8
    glb = placed(trimesh.load(tmp_path / "mesh.glb", process=False))
    assert np.abs(glb.vertices.mean(0) - scene_mesh.vertices.mean(0)).max() < 1e-3


def test_values_per_vertex_are_properties_of_the_ply(tmp_path):
    mesh = colored()
    count = len(mesh.vertices)
    values = {"views": np.arange(count).astype(np.uint8), "confidence": np.linspace(0, 1, count).astype(np.float32)}
    write_ply(replace(mesh, values=values), tmp_path / "mesh.ply")
    header, body = (tmp_path / "mesh.ply").read_bytes().split(b"end_header\n", 1)
    assert b"property uchar views\nproperty float confidence\n" in header
    kind = [("xyz", "<f4", 3), ("rgb", "u1", 3), ("views", "u1"), ("confidence", "<f4")]
    table = np.frombuffer(body, kind, count)
    assert np.array_equal(table["views"], values["views"])
    assert np.array_equal(table["confidence"], values["confidence"])
    assert np.array_equal(read_ply(tmp_path / "mesh.ply").faces, mesh.faces)


@pytest.mark.parametrize("content", [b"", b"ply\n", b"not a mesh", None])
def test_damaged_files_are_refused(tmp_path, content):
    path = tmp_path / "mesh.ply"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadInput, match=r"mesh\.ply"):
        read_ply(path)


def test_of_a_missing_file_is_said_that_it_is_missing(tmp_path):
    with pytest.raises(BadInput, match="No such file"):
        read_ply(tmp_path / "mesh.ply")


def test_truncated_files_are_refused(tmp_path):
    write_ply(colored(), tmp_path / "mesh.ply")
    data = (tmp_path / "mesh.ply").read_bytes()
    for length in np.linspace(0, len(data) - 1, 25).astype(int):
        (tmp_path / "cut.ply").write_bytes(data[:length])
        with pytest.raises(BadInput, match=r"cut\.ply"):
            read_ply(tmp_path / "cut.ply")


def textured(offset=UTM) -> tuple[Mesh, Texture]:
    """Every face with a place of its own in the picture, neighbours in pairs."""
    mesh = colored(offset)
    rng = np.random.default_rng(1)
    uv = rng.uniform(0, 1, (len(mesh.faces), 3, 2)).astype(np.float32)
    uv[1::2, 0] = uv[::2, 0]
    return mesh, Texture(uv, np.full((32, 64, 3), (200, 100, 50), np.uint8))


def test_a_textured_obj_names_its_picture_and_every_corner_has_its_place(tmp_path):
    mesh, texture = textured()
    write_texture(texture, tmp_path)
    write_obj(mesh, tmp_path / "mesh.obj", texture)
    lines = [line.split() for line in (tmp_path / "mesh.obj").read_text().splitlines()]
    places = np.array([line[1:] for line in lines if line[0] == "vt"], float)
    corners = np.array([[c.split("/") for c in line[1:]] for line in lines if line[0] == "f"], int) - 1
    assert np.array_equal(corners[..., 0], mesh.faces)
    assert np.abs(places[corners[..., 1]] - texture.uv).max() < 1e-6 and len(places) < 3 * len(mesh.faces)
    loaded = trimesh.load(tmp_path / "mesh.obj", process=False)
    assert loaded.visual.material.image.size == (64, 32)


@pytest.mark.parametrize("name", ["texture.jpg", "mesh_texture.npz"])
def test_a_texture_is_read_as_it_was_written_or_refused(tmp_path, name):
    _, texture = textured()
    write_texture(texture, tmp_path)
    read = read_texture(tmp_path)
    assert np.array_equal(read.uv, texture.uv) and np.abs(read.image.astype(int) - texture.image).max() < 4
    for content in (b"", b"PK", (tmp_path / name).read_bytes()[:-40]):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInput, match=r"again"):
            read_texture(tmp_path)


def test_a_textured_glb_holds_the_picture(tmp_path):
    mesh, texture = textured()
    write_texture(texture, tmp_path)
    write_glb(mesh, tmp_path / "mesh.glb", texture)
    loaded = placed(trimesh.load(tmp_path / "mesh.glb", process=False))
    assert np.abs(loaded.vertices[loaded.faces] - mesh.vertices[mesh.faces]).max() < 1e-4
    assert np.abs(loaded.visual.uv[loaded.faces] - texture.uv).max() < 1e-5
    image = loaded.visual.material.baseColorTexture
    assert image.size == (64, 32) and b"image/jpeg" in (tmp_path / "mesh.glb").read_bytes()
    assert np.abs(np.asarray(image.convert("RGB")).astype(int) - (200, 100, 50)).max() < 4
    assert (tmp_path / IMAGE).read_bytes() in (tmp_path / "mesh.glb").read_bytes()  # as it is, not encoded once more


@pytest.mark.parametrize("index", [-1, -400_000_000, 4, 2_000_000_000])
@pytest.mark.parametrize("colors", ["", "property uchar red\nproperty uchar green\nproperty uchar blue\n"])
def test_faces_with_vertices_that_do_not_exist_are_refused(tmp_path: Path, index: int, colors: str) -> None:
    header = f"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n{colors}"
    header += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [f"{x} {y} 0{' 9 9 9' if colors else ''}" for x, y in ((0, 0), (1, 0), (0, 1), (1, 1))]
    (tmp_path / "mesh.ply").write_text(header + "\n".join([*rows, "3 0 1 2", f"3 0 1 {index}"]) + "\n")
    with pytest.raises(BadInput, match="give a PLY file with triangles"):
        read_ply(tmp_path / "mesh.ply")
