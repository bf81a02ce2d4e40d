# SPDX-License-Identifier: GPL-3.0-or-later
"""IFC, USD and points open in the programs of others, where the building is and as it looks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import ifcopenshell
import ifcopenshell.geom
import ifcopenshell.util.geolocation
import ifcopenshell.validate
import laspy
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade, UsdValidation
from support.finished_job import FinishedJob

from mgf_engine.cli.main import main
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models.points import surface_points
from tests.models.conftest import CORNER


class Heard:
    """What ifcopenshell's validator complains of."""

    def __init__(self) -> None:
        self.statements: list[str] = []

    def error(self, message: Any, *rest: Any) -> None:
        self.statements.append(str(message))

    warning = log = error

    def set_state(self, key: str, value: Any) -> None: ...

    def info(self, *rest: Any) -> None: ...

    debug = info


@pytest.fixture(scope="module")
def ifc(models: Path) -> Any:
    return ifcopenshell.open(str(models / "building.ifc"))


def test_ifc_keeps_to_its_schema_and_rules(ifc: Any) -> None:
    heard = Heard()
    ifcopenshell.validate.validate(ifc, heard, express_rules=True)
    assert heard.statements == []
    assert ifc.schema == "IFC4"


def test_ifc_has_the_parts_and_the_volume_of_the_house(ifc: Any) -> None:
    found = {kind: len(ifc.by_type(kind)) for kind in ("IfcWall", "IfcRoof", "IfcSlab", "IfcBuilding")}
    assert found == {"IfcWall": 4, "IfcRoof": 2, "IfcSlab": 1, "IfcBuilding": 1}
    settings = ifcopenshell.geom.settings()
    shape: Any = ifcopenshell.geom.create_shape(settings, ifc.by_type("IfcBuilding")[0])
    points = np.array(shape.geometry.verts).reshape(-1, 3)
    faces = np.array(shape.geometry.faces).reshape(-1, 3)
    a, b, c = (points[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(31.2, rel=0.004)


def test_ifc_lies_where_the_building_is(ifc: Any) -> None:
    (conversion,) = ifc.by_type("IfcMapConversion")
    assert conversion.TargetCRS.Name == "EPSG:32632"
    assert ifcopenshell.util.geolocation.auto_xyz2enh(ifc, 0.0, 0.0, 0.0) == pytest.approx(CORNER)


@pytest.fixture(scope="module")
def stage(models: Path) -> Any:
    return Usd.Stage.Open(str(models / "building.usdz"))


def test_usd_passes_every_validator(stage: Any) -> None:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetMessage() for error in errors] == []


def test_usd_has_every_level_with_its_texture(stage: Any, index: dict[str, Any]) -> None:
    variants = stage.GetDefaultPrim().GetVariantSet("lod")
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    for name in variants.GetVariantNames():
        variants.SetVariantSelection(name)
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Building/Mesh"))
        assert len(mesh.GetFaceVertexCountsAttr().Get()) == index["files"][f"mesh_{name}.glb"]["faces"]
        low, high = np.array(mesh.GetExtentAttr().Get())
        assert low == pytest.approx([-2, -1.5, 0], abs=0.1) and high == pytest.approx([2, 1.5, 3.2], abs=0.1)
        material = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
        picture = UsdShade.Shader(stage.GetPrimAtPath(material.GetPath().AppendChild("Picture")))
        assert picture.GetInput("file").Get().resolvedPath.endswith(f"{name}.jpg]")
    assert len(variants.GetVariantNames()) == 4


def test_points_lie_on_the_house_in_utm_with_its_colors(models: Path) -> None:
    with laspy.open(models / "surface.laz") as file:
        assert file.header.parse_crs().to_epsg() == 32632
        cloud = file.read()
    points = cloud.xyz - CORNER
    assert points.min(0) == pytest.approx([-2, -1.5, 0], abs=0.03)
    assert points.max(0) == pytest.approx([2, 1.5, 3.2], abs=0.03)
    wall = points[:, 2] < 1.9
    away = np.minimum(np.abs(np.abs(points[:, 0]) - 2), np.abs(np.abs(points[:, 1]) - 1.5))
    assert np.sqrt((away[wall] ** 2).mean()) < 0.006
    red, blue = (np.asarray(channel)[wall].mean() for channel in (cloud.red, cloud.blue))
    assert red > 1.4 * blue  # brick
    outward = (points[wall][:, :2] * np.stack([cloud.normal_x, cloud.normal_y], 1)[wall]).sum(1)
    assert (outward > 0).mean() > 0.99


def test_points_are_as_many_as_the_spacing_says_and_have_the_texture_at_their_place() -> None:
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32),
                np.full((4, 3), 9, np.uint8))  # fmt: skip
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, 32:] = 200
    uv = mesh.vertices[mesh.faces][..., :2].astype(np.float32)
    points, colors, normals = surface_points(mesh, Texture(uv, image), 0.02)
    assert len(points) == 2500 and normals == pytest.approx(np.tile([0, 0, 1], (2500, 1)))
    sure = np.abs(points[:, 0] - 0.5) > 0.02
    assert (colors[sure, 0] == np.where(points[sure, 0] > 0.5, 200, 0)).all()
    assert (surface_points(mesh, None, 0.1)[1] == 9).all()


def test_more_points_than_a_file_should_have_are_said_to_be_fewer(
    job: FinishedJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("mgf_engine.models.points.MAX_POINTS", 500)
    out = tmp_path / "models"
    assert main(["models", str(job.folder), "--only", "points", "--spacing", "0.01", "--out", str(out)]) == 0
    said = capsys.readouterr().err
    assert "would be more than" in said and "apart" in said
    facts = json.loads((out / "models.json").read_text())["files"]["surface.laz"]
    assert 499 <= facts["points"] <= 500 and facts["spacing"] > 1e-3
