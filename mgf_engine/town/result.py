# SPDX-License-Identifier: GPL-3.0-or-later
"""What comes back of a town: one table, one model, one page."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry.mesh_files import read_ply
from mgf_engine.georef.model import Georeference, read_georeference
from mgf_engine.mesh.decimate import reduce_faces
from mgf_engine.model.mesh import Mesh
from mgf_engine.system import atomic_path
from mgf_engine.town.plan import BUILDINGS, read_plan
from mgf_engine.town.tiles import FILE as TILESET
from mgf_engine.town.tiles import FOLDER as TILES_FOLDER
from mgf_engine.town.tiles import write_tiles
from mgf_engine.town.worker import DONE, FAILED, FINISHED, JOB, RUNNING, STATUS, WAITING

Array = NDArray[np.float64]
GLB, TABLE, PAGE = "town.glb", "town.gpkg", "town.html"
TILES = f"{TILES_FOLDER}/{TILESET}"
_CELL = 0.5  # metres: cells in which the top of a building is looked for


def read_rows(town: Path, running: bool) -> list[dict[str, Any]]:
    """Every building as one row: the plan, and what became of its job.

    Args:
        running: jobs may be at work; else one that says so was killed.
    """
    rows = []
    for row in read_plan(town)["buildings"]:
        folder = town / BUILDINGS / row["id"]
        status, done = _json(folder / STATUS), _json(folder / DONE)
        job = ""
        if row["state"] in ("ready", "by hand"):
            job = FINISHED if done else status.get("state", WAITING)
            if job == RUNNING and not running:
                job, status["text"] = FAILED, f"It was killed; '{folder / 'worker.txt'}' has its last words."
            if job == FINISHED and not done:  # of an earlier plan
                job = WAITING
        rows.append({**row, "job": job, "status": status, "done": done})
    return rows


def _json(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def gather(town: Path, rows: list[dict[str, Any]], most_faces: int, tiles: bool = False) -> None:
    """Write ``town.glb``, ``town.gpkg`` and 3D Tiles where wanted, and put what the meshes tell into the rows.

    Args:
        most_faces: of each building in ``town.glb``.
    """
    georeference, metre = read_georeference(town), float(read_plan(town)["metre"])
    meshes = {}
    for row in rows:
        path = town / BUILDINGS / row["id"] / JOB / "mesh.ply"
        if row["job"] != FINISHED or not path.is_file():
            continue
        try:
            mesh = read_ply(path)
        except BadInput as error:
            row["job"], row["status"]["text"] = FAILED, str(error)
            continue
        local = Mesh(georeference.local(mesh.vertices), mesh.faces, mesh.colors)
        row["measured"] = measure(local, row, metre)
        meshes[row["id"]] = reduce_faces(local, most_faces)
    write_table(town / TABLE, town, rows, georeference)
    if meshes:
        write_town(town / GLB, meshes, georeference)
        if tiles:
            write_tiles(town / TILES_FOLDER, meshes, georeference)


def measure(mesh: Mesh, row: dict[str, Any], metre: float) -> dict[str, float]:
    """Height of the highest point over the ground, and the volume under the roof, metres.

    The volume is that of columns from the ground to the highest vertex in each cell, over the footprint's area.
    """
    above = (mesh.vertices[:, 2] - row["ground"]) / metre
    cells = np.floor(mesh.vertices[:, :2] / (_CELL * metre)).astype(np.int64)
    _, index = np.unique(cells, axis=0, return_inverse=True)
    tops = np.zeros(int(index.max()) + 1)
    np.maximum.at(tops, index.ravel(), above)
    return {"height": round(float(np.percentile(above, 99.8)), 2), "volume": round(float(tops.mean()) * row["area"], 1)}


def write_table(path: Path, town: Path, rows: list[dict[str, Any]], georeference: Georeference) -> None:
    """The buildings as a GeoPackage."""
    import pyogrio
    import shapely

    features = json.loads((town / "buildings.geojson").read_text(encoding="utf-8"))["features"]
    shapes = shapely.from_geojson([json.dumps(feature["geometry"]) for feature in features])
    columns: dict[str, Any] = {
        "id": [row["id"] for row in rows], "state": [row["state"] for row in rows],
        "job": [row["job"] for row in rows],
        "note": [row["reason"] or row["status"].get("text", "") for row in rows],
        "height": [row.get("measured", {}).get("height", np.nan) for row in rows],
        "area": [row["area"] for row in rows],
        "volume": [row.get("measured", {}).get("volume", np.nan) for row in rows],
        "confidence": [row["done"].get("confidence") or np.nan for row in rows],
        "photos": [len(row["photos"]) for row in rows],
        "seconds": [row["done"].get("job_seconds", np.nan) for row in rows],
        "cpu_seconds": [row["done"].get("cpu_seconds", np.nan) for row in rows],
    }  # fmt: skip
    texts = ("id", "state", "job", "note")
    data = [np.array(values, object if name in texts else float) for name, values in columns.items()]
    with atomic_path(path) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # coordinates of a scene have no CRS
        temporary.unlink()
        pyogrio.raw.write(
            temporary, shapely.to_wkb(shapes), data, list(columns), layer="buildings", driver="GPKG",
            crs=georeference.crs, geometry_type="Unknown",
        )  # fmt: skip


def write_town(path: Path, meshes: dict[str, Mesh], georeference: Georeference) -> None:
    """All buildings in one GLB, a node each, in local coordinates with y up as the format wants it."""
    import trimesh

    scene = trimesh.Scene()
    for name, mesh in meshes.items():
        turned = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], 1)
        scene.add_geometry(
            trimesh.Trimesh(turned, mesh.faces, vertex_colors=mesh.colors, process=False),
            node_name=name,
            geom_name=name,
        )
    scene.metadata["offset"] = list(georeference.offset)
    scene.metadata["crs"] = georeference.crs
    with atomic_path(path) as temporary:
        temporary.write_bytes(trimesh.exchange.gltf.export_glb(scene))
