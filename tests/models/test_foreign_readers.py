# SPDX-License-Identifier: GPL-3.0-or-later
"""Models read by programs of others: schema of 3D Tiles, Khronos' validator of glTF, web-ifc."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from support.finished_job import FinishedJob
from support.foreign_readers import glb_issues, run_node, tileset_errors

from mgf_engine.messages import Reporter
from mgf_engine.models.make import make_models
from mgf_engine.models.work import ModelOptions

READ_IFC = """
(async () => {
  const api = new pkg.IfcAPI();
  await api.Init();
  api.SetLogLevel(pkg.LogLevel.LOG_LEVEL_OFF);
  const model = api.OpenModel(new Uint8Array(require('fs').readFileSync(process.argv[1])));
  const count = kind => api.GetLineIDsWithType(model, pkg[kind]).size();
  const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
  let triangles = 0;
  api.StreamAllMeshes(model, mesh => {
    for (let i = 0; i < mesh.geometries.size(); i++) {
      const placed = mesh.geometries.get(i), m = placed.flatTransformation;
      const shape = api.GetGeometry(model, placed.geometryExpressID);
      const data = api.GetVertexArray(shape.GetVertexData(), shape.GetVertexDataSize());
      triangles += shape.GetIndexDataSize() / 3;
      for (let k = 0; k < data.length; k += 6)
        for (let a = 0; a < 3; a++) {
          const at = m[a] * data[k] + m[4 + a] * data[k + 1] + m[8 + a] * data[k + 2] + m[12 + a];
          low[a] = Math.min(low[a], at), high[a] = Math.max(high[a], at);
        }
    }
  });
  const kinds = Object.fromEntries(['IFCWALL', 'IFCROOF', 'IFCSLAB', 'IFCBUILDING'].map(kind => [kind, count(kind)]));
  const size = high.map((h, a) => h - low[a]);
  console.log(JSON.stringify({schema: api.GetModelSchema(model), kinds, triangles, size}));
})();
"""


@pytest.fixture(scope="module")
def tileset(models: Path) -> Any:
    return json.loads((models / "tileset.json").read_text(encoding="utf-8"))


def test_the_tileset_keeps_to_the_schema_of_3d_tiles(tileset: Any) -> None:
    assert tileset_errors(tileset) == []
    wrong = copy.deepcopy(tileset)
    wrong["root"]["children"][0]["boundingVolume"] = {"box": [1.0]}
    del wrong["root"]["geometricError"]
    assert len(tileset_errors(wrong)) == 2


def test_khronos_finds_no_fault_with_the_levels(models: Path) -> None:
    assert glb_issues(*sorted(models.glob("mesh_lod*.glb"))) == []


def test_khronos_finds_no_fault_with_compressed_levels_but_that_it_cannot_look_into_them(
    job: FinishedJob, tmp_path: Path
) -> None:
    out = make_models(job.folder, tmp_path / "models", ModelOptions(("lod",), draco=True), Reporter())
    assert glb_issues(*sorted(out.glob("mesh_lod*.glb"))) == []


def test_khronos_would_find_a_fault(models: Path, tmp_path: Path) -> None:
    data = bytearray((models / "mesh_lod3.glb").read_bytes())
    at = data.index(b'"count":')
    data[at : at + 9] = b'"count":9'  # an accessor that is too long or too short
    (tmp_path / "wrong.glb").write_bytes(data)
    assert glb_issues(tmp_path / "wrong.glb")


def test_web_ifc_reads_the_parts_and_the_size_of_the_house(models: Path) -> None:
    found = run_node("web-ifc", READ_IFC, models / "building.ifc")
    assert found["schema"] == "IFC4" and found["triangles"] > 20
    assert found["kinds"] == {"IFCWALL": 4, "IFCROOF": 2, "IFCSLAB": 1, "IFCBUILDING": 1}
    assert sorted(found["size"]) == pytest.approx([3.0, 3.2, 4.0], abs=0.05)
