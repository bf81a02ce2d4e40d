# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh in true coordinates takes the place of an earlier one whole or not at all."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.georef import export
from mgf_engine.georef.export import FOLDER, comments, extras, write_georeferenced
from mgf_engine.georef.model import METRE, Georeference, read_georeference
from mgf_engine.model.mesh import Mesh

MESH = Mesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]], np.int32), np.full((3, 3), 9, np.uint8)
)


def placed(scale: float, crs: str | None = "EPSG:25832") -> Georeference:
    matrix = np.diag([scale, scale, scale, 1.0])
    return Georeference(matrix, (691_234.0, 5_334_876.0, 0.0), crs, METRE, True, True, "control")


def files(job: Path) -> set[str]:
    return {path.name for path in (job / FOLDER).iterdir()}


def test_formats_that_are_not_wanted_any_more_go(tmp_path: Path) -> None:
    write_georeferenced(MESH, placed(2.0), tmp_path, None, obj=True, glb=True)
    assert {"mesh.ply", "mesh.obj", "mesh.glb", "mesh.prj", "georef.json"} <= files(tmp_path)
    assert write_georeferenced(MESH, placed(3.0, None), tmp_path, None, obj=False, glb=False) == tmp_path / FOLDER
    assert files(tmp_path) == {"mesh.ply", "georef.json"}
    assert read_ply(tmp_path / FOLDER / "mesh.ply").vertices[1] == pytest.approx([3, 0, 0])
    assert read_georeference(tmp_path / FOLDER).scale == pytest.approx(3.0)


def test_without_a_scale_there_is_none(tmp_path: Path) -> None:
    write_georeferenced(MESH, placed(2.0), tmp_path, None, obj=False, glb=False)
    assert write_georeferenced(MESH, Georeference(), tmp_path, None, obj=False, glb=False) is None
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_the_earlier_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_georeferenced(MESH, placed(2.0), tmp_path, None, obj=False, glb=False)
    before = {path: path.read_bytes() for path in (tmp_path / FOLDER).iterdir()}

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(export, "write_georeference", full)
    with pytest.raises(OSError, match="No space left"):
        write_georeferenced(MESH, placed(3.0), tmp_path, None, obj=True, glb=True)
    assert {path: path.read_bytes() for path in (tmp_path / FOLDER).iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == [FOLDER]


def test_headers_say_what_is_to_be_added() -> None:
    said = comments(placed(1.0))
    assert "add the offset 691234.000 5334876.000 0.000 for easting, northing, height" in said
    assert "coordinate reference system EPSG:25832" in said and "y north" in said[0]
    assert extras(placed(1.0))["offset"] == [691_234.0, 5_334_876.0, 0.0]
    assert comments(Georeference(unit=METRE)) == ["local coordinates in metres, z up"]
