# SPDX-License-Identifier: GPL-3.0-or-later
"""Solids of known buildings: closed, with the true volume and roofs, and CityJSON that others read."""

from __future__ import annotations

import gzip
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import shapely
import trimesh
from support.finished_job import FinishedJob
from support.solid_shapes import BUILDINGS, Wing, building, gable, volume

from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import Survey
from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh
from mgf_engine.models.cityjson import make_cityjson
from mgf_engine.models.make import make_models
from mgf_engine.models.solid.build import NoSolid, SolidOptions, build_solid
from mgf_engine.models.solid.checks import faults_of, triangles
from mgf_engine.models.solid.model import GROUND, ROOF, WALL, Solid
from mgf_engine.models.solid.party_walls import PartyWallOptions
from mgf_engine.models.work import ModelOptions
from tests.models.conftest import CORNER

PIXEL = 0.03  # metres on the building, of its photos


@pytest.fixture(scope="module")
def survey(job: FinishedJob) -> Survey:
    return read_survey(job.folder)


def of(survey: Survey, mesh: Mesh) -> Survey:
    """The survey with another building in it, and no points around."""
    scene = replace(survey.scene, points=np.zeros((0, 3)))
    masks = replace(survey.masks, point_mask=np.zeros(0, bool))
    return replace(
        survey, mesh=mesh, normalised=mesh, scene=scene, masks=masks, pixel=PIXEL, working_pixel=PIXEL
    )  # fmt: skip


def as_trimesh(solid: Solid) -> Any:
    return trimesh.Trimesh(solid.vertices, triangles(solid)[0], process=False)


def roofs(solid: Solid) -> int:
    return sum(face.kind == ROOF for face in solid.faces)


@pytest.mark.parametrize("name", BUILDINGS)
def test_a_known_building_gets_its_volume_and_its_roofs(survey: Survey, name: str) -> None:
    wings: list[Wing] = BUILDINGS[name]
    solid = build_solid(of(survey, building(wings, step=0.15)))
    assert solid.level == 2 and faults_of(solid, 0.02) == [] and solid.party == 0
    assert solid.volume == pytest.approx(volume(wings, 0.15), rel=0.004)
    body = as_trimesh(solid)
    assert body.is_watertight and body.is_winding_consistent
    assert body.volume == pytest.approx(solid.volume, rel=1e-4)
    assert solid.deviation is not None and solid.deviation.p90 < 0.02 and solid.unseen[ROOF] < 0.01
    heights = {
        round(float(solid.vertices[row][2]), 1) for face in solid.faces if face.kind == GROUND for row in face.rings[0]
    }
    assert heights == {0.0}


ARC = np.linspace(0, np.pi / 2, 9)
#: Radius and height of the roof of a round tower, from its eaves at 9 m to its tip.
TOWERS = {
    "dome": np.stack([1.6 * np.cos(ARC), 9 + 1.6 * np.sin(ARC)], 1),
    "spire": np.array([[1.6, 9.0], [0.0, 14.0]]),
}


@pytest.mark.parametrize("name", TOWERS)
def test_a_round_tower_keeps_its_height(survey: Survey, name: str) -> None:
    """Its roof lies in no plane, and its ground plan was given to the roof of the nave."""
    nave, profile, at = gable((-6, -3, 6, 3), 5, 8), TOWERS[name], np.array([-6.0, -3.0])
    tower = trimesh.creation.revolve(np.concatenate([[[1.6, 0.0]], profile]), sections=64)
    tower = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(np.add(tower.vertices, (*at, 0.0)), tower.faces, 0.3))
    church = building([nave], step=0.15)
    body = trimesh.util.concatenate([trimesh.Trimesh(church.vertices, church.faces, process=False), tower])
    place = body.vertices + np.random.default_rng(0).normal(0, 0.03, body.vertices.shape)
    mesh = Mesh(place, np.array(body.faces, np.int32), np.zeros((len(place), 3), np.uint8))
    solid = build_solid(of(survey, mesh), 0.45)
    assert solid.level == 2 and faults_of(solid, 0.045) == []
    x, y = np.meshgrid(np.arange(-8, 6.5, 0.02), np.arange(-5, 3.5, 0.02))
    away, true = np.hypot(x - at[0], y - at[1]), np.maximum(nave.heights(x, y).min(0), 0)
    roof = np.interp(away, profile[::-1, 0], profile[::-1, 1])
    true = np.where(away < 1.6, np.maximum(roof, true), true)
    assert solid.volume == pytest.approx(float(true.sum()) * 0.02**2, rel=0.02)
    assert solid.vertices[:, 2].max() == pytest.approx(profile[-1, 1], abs=1.0)


def test_eaves_stand_out_over_the_walls_and_the_solid_ends_at_them(survey: Survey) -> None:
    wings = BUILDINGS["hip roof with a flat annex"]
    solid = build_solid(of(survey, building(wings, step=0.15, overhang=0.4)))
    assert solid.volume == pytest.approx(volume(wings, 0.15), rel=0.01) and roofs(solid) == 5


def test_the_house_of_a_job_is_right_to_millimetres(survey: Survey) -> None:
    solid = build_solid(survey)
    kinds = sorted(face.kind for face in solid.faces)
    assert kinds == [GROUND, ROOF, ROOF, WALL, WALL, WALL, WALL] and abs(solid.ground) < 0.02
    assert solid.volume == pytest.approx(31.2, rel=0.004)
    for corner in ((-2, -1.5, 2.0), (2, 1.5, 2.0), (-2, 0, 3.2), (2, 0, 3.2)):
        assert np.linalg.norm(solid.vertices - corner, axis=1).min() < 0.01


def test_walls_alone_give_a_block_and_a_sentence(survey: Survey) -> None:
    mesh = building(BUILDINGS["shed roof"])
    upright = np.abs(of(survey, mesh).normals[:, 2]) < 0.3
    solid = build_solid(of(survey, Mesh(mesh.vertices, mesh.faces[upright], mesh.colors)))
    assert solid.level == 1 and roofs(solid) == 1 and faults_of(solid, 1e-6) == []
    assert solid.unseen[ROOF] > 0.7 and solid.unseen[WALL] < 0.2


UNFOUND = SolidOptions(party_walls=PartyWallOptions(found=False))


@pytest.mark.parametrize("along_x", [True, False])
def test_a_row_house_alone_is_closed_at_its_party_walls(survey: Survey, along_x: bool) -> None:
    """Front, back and roof end in two upright planes, which no map tells of."""
    wings = [gable((-3, -5, 3, 5), 5, 8, along_x)]
    mesh = building(wings, step=0.15, noise=0.02)
    shown = (np.abs(of(survey, mesh).normals[:, 0]) < 0.5) | (np.abs(of(survey, mesh).centres[:, 0]) < 2.9)
    middle = of(survey, Mesh(mesh.vertices, mesh.faces[shown], mesh.colors))
    with pytest.raises(NoSolid, match=r"of its walls$"):
        build_solid(middle, options=UNFOUND)
    solid = build_solid(middle)
    assert faults_of(solid, 0.02) == [] and solid.level == 2 and as_trimesh(solid).is_watertight
    assert solid.volume == pytest.approx(volume(wings), rel=0.03)
    assert solid.party > 0.5 and solid.unseen[WALL] < 0.02


def test_whole_buildings_with_eaves_have_no_party_walls(survey: Survey) -> None:
    for wings in BUILDINGS.values():
        assert build_solid(of(survey, building(wings, step=0.15, overhang=0.5))).party == 0


def test_eaves_over_walls_that_nobody_saw_are_no_party_walls(survey: Survey) -> None:
    wings = [gable((-3, -5, 3, 5), 5, 8, along_x=False)]
    mesh = building(wings, step=0.15, overhang=0.6)
    shown = (np.abs(of(survey, mesh).normals[:, 0]) < 0.9) | (of(survey, mesh).normals[:, 2] > 0.3)
    with pytest.raises(NoSolid, match=r"of its walls$"):
        build_solid(of(survey, Mesh(mesh.vertices, mesh.faces[shown], mesh.colors)))


def test_walls_against_neighbours_need_no_mesh(survey: Survey) -> None:
    """A house in a row: more than 40 % of its walls are party walls, which nobody sees."""
    mesh = building(BUILDINGS["shed roof"], step=0.1)
    shown = np.abs(of(survey, mesh).normals[:, 1]) < 0.9
    middle = of(survey, Mesh(mesh.vertices, mesh.faces[shown], mesh.colors))
    with pytest.raises(NoSolid, match=r"of its walls$"):
        build_solid(middle, options=UNFOUND)
    rows = [shapely.box(-3, y - 4, 3, y + 4).buffer(1.0) for y in (-6, 6)]
    solid = build_solid(middle, taken=shapely.union_all(rows))
    assert faults_of(solid, 1e-6) == [] and solid.level == 2
    assert solid.volume == pytest.approx(volume(BUILDINGS["shed roof"]), rel=0.02)
    assert solid.party > 0.5 and solid.unseen[WALL] < 0.1
    with pytest.raises(NoSolid, match=r"beside the .* against neighbours"):
        build_solid(middle, taken=rows[0].intersection(shapely.box(-9, -9, 0, 9)))


def test_one_wall_makes_no_solid(survey: Survey) -> None:
    mesh = building(BUILDINGS["shed roof"])
    side = of(survey, mesh).normals[:, 1] > 0.9
    with pytest.raises(NoSolid):
        build_solid(of(survey, Mesh(mesh.vertices, mesh.faces[side], mesh.colors)))


def test_what_is_smaller_than_the_detail_is_left_out(survey: Survey) -> None:
    wings = BUILDINGS["church"]
    fine, coarse = (build_solid(of(survey, building(wings, step=0.15)), detail) for detail in (0.25, 1.2))
    assert len(coarse.faces) < len(fine.faces) and faults_of(coarse, 0.1) == []


def test_faults_are_found() -> None:
    box = trimesh.creation.box()
    solid = Solid(np.array(box.vertices), [])
    assert faults_of(solid, 1e-6) == ["it has no volume"]


@pytest.fixture(scope="module")
def written(models: Path) -> Path:
    return models / "building.city.json"


def test_cityjson_keeps_to_the_schema(written: Path) -> None:
    schema = json.loads(gzip.decompress((Path(__file__).parent / "cityjson.schema.json.gz").read_bytes()))
    faults = jsonschema.Draft7Validator(schema).iter_errors(json.loads(written.read_text(encoding="utf-8")))
    assert [fault.message for fault in faults] == []


#: In a process of its own: cjio changes how Python's json writes numbers.
READ = """
import json, sys
from cjio import cityjson
model = cityjson.reader(open(sys.argv[1], encoding="utf-8"))
building, = model.j["CityObjects"].values()
doubles, orphans = model.remove_duplicate_vertices(), model.remove_orphan_vertices()
print(json.dumps([model.get_epsg(), doubles, orphans, model.calculate_bbox(), building["geometry"]]))
"""


def test_cjio_reads_the_building(written: Path) -> None:
    told = subprocess.run([sys.executable, "-c", READ, written], check=True, capture_output=True, text=True).stdout
    epsg, doubles, orphans, box, (geometry, detailed) = json.loads(told)
    assert detailed["lod"] == "3"
    assert (epsg, doubles, orphans) == (32632, 0, 0)
    assert geometry["type"] == "Solid" and geometry["lod"] == "2"
    kinds = [surface["type"] for surface in geometry["semantics"]["surfaces"]]
    assert sorted(kinds) == ["GroundSurface", *["RoofSurface"] * 2, *["WallSurface"] * 4]
    low, high = np.array(box).reshape(2, 3) - CORNER
    assert low == pytest.approx([-2, -1.5, 0], abs=0.02) and high == pytest.approx([2, 1.5, 3.2], abs=0.02)


def test_val3dity_finds_no_fault(survey: Survey, tmp_path: Path) -> None:
    program = os.environ.get("MGF_VAL3DITY") or shutil.which("val3dity")
    if program is None:
        pytest.skip("val3dity is not on this machine (it is C++ and has no wheel; MGF_VAL3DITY names it)")
    for number, wings in enumerate(BUILDINGS.values()):
        solid = build_solid(of(survey, building(wings, step=0.15)))
        path = tmp_path / f"{number}.city.json"
        path.write_text(json.dumps(make_cityjson(solid, survey, "house")))
        report = tmp_path / "report.json"
        subprocess.run([program, "-r", report, path], check=True, capture_output=True)
        assert json.loads(report.read_text())["validity"], report.read_text()


def test_a_job_that_encloses_nothing_says_so(job: FinishedJob, tmp_path: Path) -> None:
    from mgf_engine.geometry.mesh_files import read_ply, write_ply

    copy = tmp_path / "job"
    shutil.copytree(job.folder, copy)
    mesh = read_ply(copy / "mesh.ply")
    low = mesh.vertices[:, 1].min()
    wall = (mesh.vertices[mesh.faces][..., 1] < low + 0.05).all(1)
    write_ply(Mesh(mesh.vertices, mesh.faces[wall], mesh.colors), copy / "mesh.ply")
    told: list[str] = []
    reporter = Reporter(lambda message: told.append(message.get("text", "")))
    folder = make_models(copy, tmp_path / "out", ModelOptions(("solid",)), reporter)
    assert "There is no solid of this building (it has no volume); take photos from all sides." in told
    assert [path.name for path in folder.iterdir()] == ["models.json"]


def test_a_detail_larger_than_the_building_is_to_be_smaller(job: FinishedJob, tmp_path: Path) -> None:
    told: list[str] = []
    reporter = Reporter(lambda message: told.append(message.get("text", "")))
    make_models(job.folder, tmp_path / "out", ModelOptions(("solid",), detail=50.0), reporter)
    said = "(the mesh covers no ground); give a --detail below 5000, or take photos from all sides."
    assert f"There is no solid of this building {said}" in told
