# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows of the painted house, known to the millimetre, as openings of the solid in CityJSON and IFC."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import ifcopenshell
import ifcopenshell.util.element
import numpy as np
import pytest
from support.finished_job import WINDOWS, FinishedJob

from benchmarks.synthetic.house import OFFSET
from mgf_engine.drawings.load import read_survey
from mgf_engine.drawings.model import Survey
from mgf_engine.models.solid.build import build_solid
from mgf_engine.models.solid.checks import faults_of, volume_of
from mgf_engine.models.solid.model import WALL, WINDOW, Solid
from mgf_engine.models.solid.openings import add_openings


@pytest.fixture(scope="module")
def survey(job: FinishedJob) -> Survey:
    return read_survey(job.folder)


@pytest.fixture(scope="module")
def solid(survey: Survey) -> Solid:
    return build_solid(survey)


@pytest.fixture(scope="module")
def detailed(survey: Survey, solid: Solid) -> Solid:
    found = add_openings(solid, survey)
    assert found is not None
    return found


def test_windows_lie_where_they_are_painted(survey: Survey, detailed: Solid) -> None:
    found = []
    for face in detailed.faces:
        if face.kind == WINDOW:
            at = survey.georeference.scene(detailed.vertices[list(face.rings[0])] @ survey.turn) - OFFSET
            (left, y, bottom), (right, _, top) = at.min(0), at.max(0)
            found.append((np.sign(y), left, right, bottom, top))
    wanted = [(side, *window) for side in (-1, 1) for window in WINDOWS]
    assert len(found) == len(wanted)
    for window in wanted:
        nearest = min(found, key=lambda own: np.abs(np.subtract(own, window)).max())
        assert np.abs(np.subtract(nearest, window)).max() < survey.working_pixel


def test_the_solid_stays_closed_and_each_window_is_a_hole_of_its_wall(solid: Solid, detailed: Solid) -> None:
    assert detailed.level == 3 and faults_of(detailed, 0.1 * solid.detail) == []
    assert volume_of(detailed) == pytest.approx(volume_of(solid), rel=1e-9)
    for face in detailed.faces:
        if face.kind == WINDOW:
            wall = detailed.faces[face.wall]
            assert wall.kind == WALL and face.rings[0][::-1] in wall.rings[1:]
            assert detailed.normal(face) @ detailed.normal(wall) == pytest.approx(1)
    area = sum(solid.area(face) for face in solid.faces)
    assert sum(detailed.area(face) for face in detailed.faces) == pytest.approx(area, rel=1e-9)


def test_nothing_is_made_up_where_no_window_was_clicked(survey: Survey, solid: Solid) -> None:
    assert add_openings(solid, replace(survey, parts={})) is None
    assert add_openings(solid, replace(survey, parts={"balcony": survey.parts["window"]})) is None
    assert add_openings(replace(solid, level=1), survey) is None
    assert add_openings(solid, replace(survey, parts={"Doors": survey.parts["window"]})) is not None


def test_the_files_carry_them(models: Path) -> None:
    (building,) = json.loads((models / "building.city.json").read_text())["CityObjects"].values()
    plain, fine = building["geometry"]
    assert (plain["lod"], fine["lod"]) == ("2", "3")
    surfaces = fine["semantics"]["surfaces"]
    windows = [k for k, surface in enumerate(surfaces) if surface["type"] == "Window"]
    assert len(windows) == 2 * len(WINDOWS)
    assert all(k in surfaces[surfaces[k]["parent"]]["children"] for k in windows)
    index = json.loads((models / "models.json").read_text())["files"]["building.city.json"]
    assert index["openings"] == len(windows)
    model = ifcopenshell.open(models / "building.ifc")
    sizes = sorted((round(w.OverallWidth, 1), round(w.OverallHeight, 1)) for w in model.by_type("IfcWindow"))
    assert sizes == sorted((round(r - left, 1), round(t - b, 1)) for left, r, b, t in WINDOWS for _ in range(2))
