# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail lie near the mesh, keep its outline and its texture, and stand on the globe where they should."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import igl
import numpy as np
import pyproj
import pytest
import trimesh
from support.finished_job import FinishedJob

from benchmarks.synthetic.house import OFFSET
from mgf_engine.cli.main import main
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models import lod
from mgf_engine.models.lod import LodOptions, measure_deviation, reduce_chain, silhouette_overlap
from mgf_engine.models.make import make_models
from mgf_engine.models.work import ModelOptions
from mgf_engine.scene.store import read_saved_scene
from mgf_engine.texture.draw import draw_textured
from tests.models.conftest import CORNER, fine_house

FROM_GLTF = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # y up -> z up, as points @ this


def read_level(path: Path) -> tuple[Mesh, Texture]:
    """A GLB as trimesh reads it, in the local frame."""
    loaded: Any = trimesh.load(path, process=False).to_geometry()
    mesh = Mesh(
        loaded.vertices @ FROM_GLTF, np.asarray(loaded.faces, np.int32), np.zeros_like(loaded.vertices, np.uint8)
    )
    image = np.array(loaded.visual.material.baseColorTexture.convert("RGB"))
    return mesh, Texture(np.asarray(loaded.visual.uv, np.float32)[mesh.faces], image)


def validator() -> list[str] | None:
    """How to start the validator of 3D Tiles (npm ``3d-tiles-validator``), None where it is not installed."""
    given = os.environ.get("MGF_TILES_VALIDATOR")
    if given:
        return ["node", given]
    found = shutil.which("3d-tiles-validator")
    return [found] if found else None


def test_levels_have_their_share_of_the_faces_and_say_how_far_they_lie(index: dict[str, Any], models: Path) -> None:
    levels = [index["files"][f"mesh_lod{k}.glb"] for k in range(4)]
    assert [level["share"] for level in levels] == pytest.approx([1, 0.25, 0.06, 0.015], rel=0.06)
    errors = [level["deviation"]["rms"] for level in levels]
    assert errors[0] == 0 and 0 < errors[1] <= errors[2] <= errors[3] < 0.03  # of 3.2 m, with 4 mm of noise
    for k, level in enumerate(levels):
        mesh, texture = read_level(models / f"mesh_lod{k}.glb")
        assert len(mesh.faces) == level["faces"] and level["silhouette"] > 0.985
        assert texture.uv.min() >= 0 and texture.uv.max() <= 1


def test_the_error_is_that_of_an_independent_measurement(index: dict[str, Any], models: Path) -> None:
    full, coarse = (read_level(models / f"mesh_lod{k}.glb")[0] for k in (0, 3))
    away = [_off(_samples(a), to) for a, to in ((full, coarse), (coarse, full))]
    rms = float(np.sqrt((np.concatenate(away) ** 2).mean()))
    assert index["files"]["mesh_lod3.glb"]["deviation"]["rms"] == pytest.approx(rms, rel=0.05)


def test_a_coarse_level_looks_like_the_full_mesh(job: FinishedJob, models: Path, index: dict[str, Any]) -> None:
    scene, to_scene = read_saved_scene(job.folder / "scene"), np.array(index["to_scene"])
    pictures = []
    for k in (0, 2, 3):
        mesh, texture = read_level(models / f"mesh_lod{k}.glb")
        at = scene.to_normalised.apply(mesh.vertices @ to_scene[:3, :3].T + to_scene[:3, 3])
        pictures.append(draw_textured(Mesh(at, mesh.faces, mesh.colors), texture, scene.views[0]))
    photo = scene.photo(0).astype(float)
    for picture, seen in pictures[1:]:
        both = seen & pictures[0][1]
        assert both.sum() > 0.97 * pictures[0][1].sum()
        off = np.abs(picture.astype(float) - photo)[both].mean()
        assert off < np.abs(pictures[0][0].astype(float) - photo)[both].mean() + 12  # grey levels; the paint is mottled


def test_levels_by_error_stay_within_it() -> None:
    from benchmarks.synthetic.house import house_mesh

    mesh = fine_house(house_mesh())
    chain = reduce_chain(mesh, (0.01, 0.05))
    for coarse, error in zip(chain[1:], (0.01, 0.05), strict=True):
        assert _off(mesh.vertices, coarse).max() <= 1.01 * error
    assert len(chain[2].faces) < len(chain[1].faces) < 0.5 * len(mesh.faces)


def rings(count: int) -> Mesh:
    """A wall of upright square rings, as a ragged mesh has tunnels: each of them 0.4 wide with a hole of 0.2."""
    side = np.array([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)])
    corners = [(x, y, z) for k in (0.05, -0.05) for y in (k,) for ring in (side, 0.5 * side) for x, z in ring]
    quads = []
    for k in range(4):
        n = (k + 1) % 4
        quads += [
            (k, n, 4 + n, 4 + k),
            (12 + k, 12 + n, 8 + n, 8 + k),
            (8 + k, 8 + n, n, k),
            (4 + k, 4 + n, 12 + n, 12 + k),
        ]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    ring = trimesh.Trimesh(corners, faces, process=False).subdivide().subdivide().subdivide()
    many = trimesh.util.concatenate(
        [ring.copy().apply_translation((0.5 * (k % 10), 0, 0.5 * (k // 10))) for k in range(count)]
    )
    rng = np.random.default_rng(0)
    vertices = many.vertices + rng.normal(0, 0.001, many.vertices.shape)
    return Mesh(vertices, np.asarray(many.faces, np.int32), np.full(vertices.shape, 128, np.uint8))


def test_a_level_keeps_the_outline_even_if_that_takes_more_faces() -> None:
    mesh = rings(40)
    most = round(0.006 * len(mesh.faces))
    coarse = reduce_chain(mesh, options=replace(LodOptions(), shares=(0.1, 0.05, 0.006)))[3]
    assert silhouette_overlap(mesh, coarse) > 0.9 and len(coarse.faces) <= 3.2 * most


def test_a_decimation_that_stops_early_is_no_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """fast-simplification ends on some flattened meshes at the same number of faces whatever is asked for, far off:
    level 3 had more faces than level 2 and ten times its error."""
    from benchmarks.synthetic.house import house_mesh

    mesh = fine_house(house_mesh(), 0.1, 0.05)
    stuck = lod.reduce_faces(mesh, 1900)
    stuck = replace(stuck, vertices=stuck.vertices + np.random.default_rng(0).normal(0, 0.1, stuck.vertices.shape))
    monkeypatch.setattr(lod, "_simplified", lambda mesh, most, options: stuck)
    chain = reduce_chain(mesh, options=replace(LodOptions(), least_silhouette=0.95))
    errors = [measure_deviation(mesh, coarse, 20_000).rms for coarse in chain]
    assert errors == sorted(errors) and len(chain[2].faces) > len(chain[3].faces)
    assert len(chain[3].faces) <= 3.2 * 0.015 * len(mesh.faces) and silhouette_overlap(mesh, chain[3]) > 0.93


def _samples(mesh: Mesh) -> np.ndarray:
    return np.asarray(trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.faces), 20_000, seed=1)[0])


def _off(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    return np.sqrt(igl.point_mesh_squared_distance(points, mesh.vertices, mesh.faces.astype(np.int64))[0])


def test_deviation_and_outline_of_a_moved_box_are_known() -> None:
    box = trimesh.creation.box((2, 2, 2))
    one = Mesh(np.array(box.vertices), np.array(box.faces, np.int32), np.zeros((8, 3), np.uint8))
    other = Mesh(one.vertices * 1.1, one.faces, one.colors)
    deviation = measure_deviation(one, other)
    assert deviation.p90 == pytest.approx(0.1, abs=0.02) and deviation.largest <= 0.1 * np.sqrt(3) + 1e-9
    assert silhouette_overlap(one, other) == pytest.approx(1 / 1.21, abs=0.02)


def test_the_tileset_puts_the_building_where_its_coordinates_say(models: Path) -> None:
    root = json.loads((models / "tileset.json").read_text(encoding="utf-8"))["root"]
    matrix = np.array(root["transform"]).reshape(4, 4).T
    mesh = read_level(models / "mesh_lod0.glb")[0]
    crs = pyproj.CRS("EPSG:32632").to_3d()
    transform = pyproj.Transformer.from_crs(crs, "EPSG:4978", always_xy=True)
    true = np.stack(transform.transform(*(mesh.vertices + CORNER).T), 1)
    assert np.abs(mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3] - true).max() < 0.001
    assert np.abs(mesh.vertices.min(0) - [-2, -1.5, 0]).max() < 0.03


def test_coarser_tiles_come_first_and_promise_less(models: Path) -> None:
    tileset = json.loads((models / "tileset.json").read_text(encoding="utf-8"))
    tile, errors, names = tileset["root"], [tileset["geometricError"]], []
    while tile:
        errors.append(tile["geometricError"])
        names.append(tile["content"]["uri"])
        tile = (tile.get("children") or [None])[0]
    assert names == [f"mesh_lod{k}.glb" for k in (3, 2, 1, 0)]
    assert errors == sorted(errors, reverse=True) and errors[-1] == 0


def test_the_validator_finds_no_fault(models: Path, tmp_path: Path) -> None:
    command = validator()
    if command is None:
        pytest.skip("the npm package 3d-tiles-validator is not on this machine (MGF_TILES_VALIDATOR names its main.js)")
    report = tmp_path / "report.json"
    subprocess.run([*command, "-t", models / "tileset.json", "-r", report], check=True, capture_output=True)
    found = json.loads(report.read_text(encoding="utf-8"))
    assert found["numErrors"] == 0 and found["numWarnings"] == 0, json.dumps(found)[:3000]


def test_a_job_without_place_or_texture_says_so(job: FinishedJob, tmp_path: Path) -> None:
    copy = tmp_path / "job"
    shutil.copytree(job.folder, copy)
    for name in ("georef.json", "texture.jpg"):
        (copy / name).unlink()
    told: list[str] = []
    reporter = Reporter(lambda message: told.append(message.get("text", "")))
    folder = make_models(copy, tmp_path / "out", ModelOptions(("tiles",)), reporter)
    assert any("no true coordinates" in text for text in told) and any("centre of the globe" in text for text in told)
    assert "transform" not in json.loads((folder / "tileset.json").read_text(encoding="utf-8"))["root"]
    loaded: Any = trimesh.load(folder / "mesh_lod3.glb", process=False).to_geometry()
    assert loaded.visual.kind == "vertex"
    again = make_models(copy, tmp_path / "out", ModelOptions(("lod",)), Reporter())
    assert not (again / "tileset.json").exists()


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--only", "lod,castle"], "not 'castle'"),
        (["--error", "5,1"], "growing distances"),
        (["--error", "a"], "growing distances"),
        (["--error", "-1"], "growing distances"),
    ],
)
def test_bad_arguments_end_with_one_sentence(
    job: FinishedJob, flags: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["models", str(job.folder), "--progress", "none", "=".join(flags)]) == 2
    assert says in capsys.readouterr().err


def test_a_folder_with_other_files_is_left_alone(job: FinishedJob, tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("mine")
    assert main(["models", str(job.folder), "--out", str(tmp_path), "--progress", "none"]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


def test_a_missing_package_is_named(
    job: FinishedJob, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import importlib.util

    known = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "xatlas" else known(name))
    assert main(["models", str(job.folder), "--only", "lod", "--progress", "none"]) == 2
    assert "These models need xatlas; install with: pip install 'mgf-engine[models]'" in capsys.readouterr().err


def test_offset_of_the_house_is_the_origin(index: dict[str, Any]) -> None:
    assert index["offset"] == pytest.approx(CORNER) and index["crs"] == "EPSG:32632"
    assert np.array(index["to_scene"])[:3, 3] == pytest.approx(OFFSET)


def test_options_it_does_not_use_are_refused(job: FinishedJob, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", str(job.folder), "--progress", "none", "--set", "tsdf.band=2"]) == 2
    assert "'mgf models' does not use the option 'tsdf.band'" in capsys.readouterr().err
