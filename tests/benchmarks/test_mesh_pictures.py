# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the meshes that a suite has made, beside a photo."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from benchmarks.mesh_pictures import find_meshes, scene_row
from mgf_engine.errors import BadInput
from mgf_engine.geometry.mesh_files import write_ply
from mgf_engine.model.mesh import Mesh


def square(depth: float) -> Mesh:
    """Two faces of 2 x 2 m across the axis of a camera at the origin, seen from outside."""
    corners = np.array([[-1, -1, depth], [1, -1, depth], [1, 1, depth], [-1, 1, depth]], float)
    return Mesh(corners, np.array([[0, 2, 1], [0, 3, 2]], np.int32), np.full((4, 3), 200, np.uint8))


def result(out: Path, key: str, variant: str, f1: float, age: float = 0.0) -> None:
    scores = {"thresholds": [0.05, 0.1, 0.2], "f1": [f1, f1 + 10, f1 + 20]}
    (out / "results").mkdir(parents=True, exist_ok=True)
    path = out / "results" / f"{key}.json"
    path.write_text(json.dumps({"scene": "smoke", "variant": variant, "geometry": scores}))
    os.utime(path, (1e9 - age, 1e9 - age))
    (out / "jobs" / key).mkdir(parents=True)
    write_ply(square(4.0), out / "jobs" / key / "mesh.ply")


def scene(folder: Path) -> Path:
    """One camera at the origin, 80 x 60 px, looking along z, and its blue photo."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=80, height=60, params=[40, 40, 40, 30], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(name="a.jpg", camera_id=1, image_id=1)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    (folder / "sparse_truth").mkdir(parents=True)
    model.write(folder / "sparse_truth")
    (folder / "images").mkdir()
    cv2.imwrite(str(folder / "images/a.jpg"), np.full((60, 80, 3), (200, 40, 20), np.uint8))
    return folder


def test_the_newest_mesh_of_each_variant_is_taken_and_named_with_its_scores(tmp_path: Path) -> None:
    result(tmp_path, "b", "preset paper", 40.0, age=9.0)
    result(tmp_path, "a", "preset paper", 20.0)
    result(tmp_path, "c", "preset quick", 50.0)
    found = find_meshes(tmp_path, "smoke", ["preset quick", "preset paper"])
    assert list(found) == ["preset quick: F1 50.0 / 60.0 / 70.0", "preset paper: F1 20.0 / 30.0 / 40.0"]
    assert found["preset paper: F1 20.0 / 30.0 / 40.0"] == tmp_path / "jobs/a/mesh.ply"
    with pytest.raises(BadInput, match="no mesh of 'preset fine' on 'smoke'"):
        find_meshes(tmp_path, "smoke", ["preset fine"])


def test_a_mesh_stands_where_its_camera_sees_it(tmp_path: Path) -> None:
    result(tmp_path, "a", "x", 20.0)
    row = scene_row(scene(tmp_path / "scene"), 0, {"x": tmp_path / "jobs/a/mesh.ply"}, 160)
    photo, mesh = row[:120, :160], row[:120, 168:328]
    assert (np.abs(photo.astype(int) - (20, 40, 200)) < 12).all()  # RGB
    drawn = mesh.min(-1) < 250
    v, u = np.flatnonzero(drawn.any(1)), np.flatnonzero(drawn.any(0))
    assert (u[0], u[-1], v[0], v[-1]) == (60, 99, 40, 79)  # 2 m at 4 m and 80 px focal length: 40 px
    assert (row[:120, 160:168] == 255).all() and (row[120:] < 128).any()  # white between, text below
    with pytest.raises(BadInput, match="no photo 1, only 0 to 0"):
        scene_row(tmp_path / "scene", 1, {}, 160)
