# SPDX-License-Identifier: GPL-3.0-or-later
"""Compressed levels of detail: the same mesh and texture coordinates when Draco opens them again, and far smaller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
import pytest
from support.finished_job import FinishedJob

from mgf_engine.geometry.mesh_files import write_glb
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh
from mgf_engine.models.draco import EXTENSION, compress_glb, read_accessor, read_glb
from mgf_engine.models.make import make_models
from mgf_engine.models.work import ModelOptions


def opened(path: Path) -> tuple[dict[str, Any], Any, dict[str, int], bytes]:
    """The JSON, what Draco reads, attribute -> number in there, and the picture."""
    tree, binary = read_glb(path)
    extension = tree["meshes"][0]["primitives"][0]["extensions"][EXTENSION]
    parts = [binary[v["byteOffset"] : v["byteOffset"] + v["byteLength"]] for v in tree["bufferViews"]]
    picture = parts[tree["images"][0]["bufferView"]] if "images" in tree else b""
    return tree, DracoPy.decode(parts[extension["bufferView"]]), extension["attributes"], picture


def corners(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Corners of all faces in an order that both files share: by where each face lies, [F, 3, n]."""
    found = points[faces]
    order = np.lexsort(np.round(found[..., :3].mean(1), 4).T)
    return found[order]


def test_a_level_is_the_same_but_for_rounding(models: Path, tmp_path: Path) -> None:
    plain, small = models / "mesh_lod1.glb", tmp_path / "small.glb"
    small.write_bytes(plain.read_bytes())
    compress_glb(small)
    before, binary = read_glb(plain)
    primitive = before["meshes"][0]["primitives"][0]
    place, uv = (read_accessor(before, binary, primitive["attributes"][name]) for name in ("POSITION", "TEXCOORD_0"))
    faces = read_accessor(before, binary, primitive["indices"]).reshape(-1, 3)
    tree, mesh, ids, picture = opened(small)
    by_id = {own["unique_id"]: own for own in mesh.attributes}
    assert set(ids) == {"POSITION", "TEXCOORD_0"}
    assert by_id[ids["POSITION"]]["num_components"] == 3 and by_id[ids["TEXCOORD_0"]]["num_components"] == 2
    accessors = tree["accessors"]
    own = tree["meshes"][0]["primitives"][0]
    assert accessors[own["attributes"]["POSITION"]]["count"] == len(mesh.points)
    assert accessors[own["indices"]]["count"] == 3 * len(mesh.faces) == faces.size
    assert len(mesh.faces) == len(faces)
    was, now = (
        np.sort(corners(np.column_stack([p, t]), f).reshape(-1, 5), axis=0)
        for p, t, f in ((place, uv, faces), (mesh.points, mesh.tex_coord, mesh.faces))
    )
    size = float(np.ptp(place, axis=0).max())
    assert np.abs(was[:, :3] - now[:, :3]).max() < size / 2**15
    assert np.abs(was[:, 3:] - now[:, 3:]).max() < 1 / 2**13
    picture_view = before["bufferViews"][before["images"][0]["bufferView"]]
    begun = picture_view.get("byteOffset", 0)
    assert picture == binary[begun : begun + picture_view["byteLength"]]
    assert tree["nodes"] == before["nodes"] and tree["asset"] == before["asset"]
    plain_size, small_size = plain.stat().st_size - len(picture), small.stat().st_size - len(picture)
    assert small_size < plain_size / 4


def test_colors_are_kept_where_there_is_no_texture(tmp_path: Path) -> None:
    grid = np.array([(x, y, 0.1 * x * y) for x in range(20) for y in range(20)], float)
    faces = np.array([(20 * x + y, 20 * x + y + 20, 20 * x + y + 21) for x in range(19) for y in range(19)], np.int32)
    colors = np.column_stack([grid[:, :2] * 12, np.full(len(grid), 9)]).astype(np.uint8)
    write_glb(Mesh(grid, faces, colors), tmp_path / "a.glb")
    compress_glb(tmp_path / "a.glb")
    _, mesh, ids, picture = opened(tmp_path / "a.glb")
    assert set(ids) == {"POSITION", "COLOR_0"} and picture == b""
    middle = 0.5 * (grid.min(0) + grid.max(0)).round(3)
    away = np.linalg.norm(mesh.points[:, None] + middle - grid, axis=2)
    assert away.min(1).max() < 0.01 and (mesh.colors[:, :3] == colors[away.argmin(1)]).all()


def test_the_command_writes_levels_and_tiles_of_them(job: FinishedJob, models: Path, tmp_path: Path) -> None:
    out = make_models(job.folder, tmp_path / "models", ModelOptions(("lod", "tiles"), draco=True), Reporter())
    for level in range(4):
        tree, mesh, _, _ = opened(out / f"mesh_lod{level}.glb")
        assert tree["extensionsRequired"] == [EXTENSION] and len(mesh.faces) > 0
        assert (out / f"mesh_lod{level}.glb").stat().st_size < (models / f"mesh_lod{level}.glb").stat().st_size


def test_without_the_package_one_sentence_says_so_before_anything_is_made(
    models: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from mgf_engine.cli.main import main
    from mgf_engine.models import command

    monkeypatch.setattr(command, "is_installed", lambda module: module != "DracoPy")
    command.require_packages(("lod",))
    command.require_packages(("solid",), draco=True)  # which nothing compresses
    out = tmp_path / "out"
    assert main(["models", str(models.parent), "--out", str(out), "--only", "lod", "--draco"]) == 2
    said = capsys.readouterr().err.strip()
    assert said == (
        "Error: Compressed levels of detail need DracoPy; install with: pip install 'mgf-engine[models]', in the "
        "engine's environment, or leave out --draco."
    )
    assert not out.exists()
