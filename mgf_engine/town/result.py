# SPDX-License-Identifier: GPL-3.0-or-later
"""Collect the results of a town: one table, one model, one page."""

from __future__ import annotations

import io
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import atomic_path, write_json
from mgf_engine.geometry.mesh_files import IMAGE, read_ply, read_texture, textured, write_ply
from mgf_engine.georef.export import GLTF_AXES
from mgf_engine.georef.model import Georeference, read_georeference
from mgf_engine.mesh.decimate import reduce_faces
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.town.hulls import WITH_JOB
from mgf_engine.town.plan import BUILDINGS
from mgf_engine.town.plan_files import read_plan
from mgf_engine.town.solid import merge_cityjson, read_solids
from mgf_engine.town.terrain import DONE as TERRAIN_DONE
from mgf_engine.town.terrain import FOLDER as TERRAIN_FOLDER
from mgf_engine.town.terrain import LOG as TERRAIN_TEXT
from mgf_engine.town.terrain import MESH as TERRAIN_MESH
from mgf_engine.town.tiles import FILE as TILESET
from mgf_engine.town.tiles import FOLDER as TILES_FOLDER
from mgf_engine.town.tiles import write_tiles
from mgf_engine.town.worker import DONE, FAILED, FINISHED, JOB, RUNNING, STATUS, WAITING, read_record
from mgf_engine.town.workflow import OptionalProducts

Array = NDArray[np.float64]
GLB, TABLE, PAGE, CITYJSON = "town.glb", "town.gpkg", "town.html", "town.city.json"
TERRAIN, TERRAIN_LOG = f"{TERRAIN_FOLDER}/{TERRAIN_DONE}", f"{TERRAIN_FOLDER}/{TERRAIN_TEXT}"
#: A building with few faces, in its folder: at most, and as a share of those in ``town.glb`` (LoD 2 of ``mgf models``).
LIGHT, MOST_LIGHT, LIGHT_SHARE = "light.ply", 2000, 0.06
TILES = f"{TILES_FOLDER}/{TILESET}"
_CELL = 0.5  # metres: cells in which the top of a building is looked for


def read_rows(town: Path, running: bool) -> list[dict[str, Any]]:
    """Read every building as one row: the plan, and what became of its job.

    Args:
        running: jobs may be at work; else one that says so was killed.
    """
    rows = []
    for row in read_plan(town)["buildings"]:
        folder = town / BUILDINGS / row["id"]
        status, done = read_record(folder / STATUS), read_record(folder / DONE)
        job = ""
        if row["state"] in WITH_JOB:
            job = FINISHED if done else status.get("state", WAITING)
            if job == RUNNING and not running:
                job, status["text"] = FAILED, f"It was killed; '{folder / 'worker.txt'}' has its last words."
            if job == FINISHED and not done:  # of an earlier plan
                job = WAITING
        rows.append({**row, "job": job, "status": status, "done": done})
    return rows


def gather(town: Path, rows: list[dict[str, Any]], most_faces: int, tiles: bool, wanted: OptionalProducts) -> None:
    """Write ``town.glb``, ``town.gpkg``, ``town.city.json`` and 3D Tiles, and put what meshes tell into the rows.

    Args:
        town: its folder.
        rows: of the table, changed in place.
        most_faces: of each building in ``town.glb``.
        tiles: 3D Tiles are wanted.
        wanted: what every building's job makes.
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
        write_light(meshes[row["id"]], town / BUILDINGS / row["id"] / LIGHT)
    write_table(town / TABLE, town, rows, georeference)
    terrain = read_terrain(town) if wanted.terrain else None
    if meshes:
        write_town(town / GLB, meshes, georeference, terrain)
        if tiles:
            write_tiles(town / TILES_FOLDER, meshes, georeference, terrain)
    solids = read_solids([town / BUILDINGS / row["id"] for row in rows if row["job"] == FINISHED])
    if wanted.solids and solids:
        write_json(town / CITYJSON, merge_cityjson(solids, town.resolve().name))


def write_light(mesh: Mesh, path: Path) -> None:
    """Write the building with few faces for a first look at the whole town, local frame; kept where it is newer."""
    source = path.parent / JOB / "mesh.ply"
    if not path.is_file() or path.stat().st_mtime_ns < source.stat().st_mtime_ns:
        coarse = reduce_faces(mesh, max(MOST_LIGHT // 10, min(MOST_LIGHT, round(LIGHT_SHARE * len(mesh.faces)))))
        write_ply(coarse, path, comments=("in the local frame of the town, z up",))


def read_terrain(town: Path) -> tuple[Mesh, Texture] | None:
    """Read the terrain, local frame, and its texture; None where there is none."""
    folder = town / TERRAIN_FOLDER
    if not (town / TERRAIN).is_file():
        return None
    return read_ply(folder / TERRAIN_MESH), read_texture(folder)


def measure(mesh: Mesh, row: dict[str, Any], metre: float) -> dict[str, float]:
    """Measure the height of the highest point over the ground, and the volume under the roof, metres.

    The volume is that of columns from the ground to the highest vertex in each cell, over the footprint's area.
    """
    above = (mesh.vertices[:, 2] - row["ground"]) / metre
    cells = np.floor(mesh.vertices[:, :2] / (_CELL * metre)).astype(np.int64)
    _, index = np.unique(cells, axis=0, return_inverse=True)
    tops = np.zeros(int(index.max()) + 1)
    np.maximum.at(tops, index.ravel(), above)
    return {"height": round(float(np.percentile(above, 99.8)), 2), "volume": round(float(tops.mean()) * row["area"], 1)}


def write_table(path: Path, town: Path, rows: list[dict[str, Any]], georeference: Georeference) -> None:
    """Write the buildings as a GeoPackage.

    Args:
        path: of the GeoPackage.
        town: its folder.
        rows: of the table.
        georeference: local frame and CRS.
    """
    import pyogrio

    features = json.loads((town / "buildings.geojson").read_text(encoding="utf-8"))["features"]
    shapes = shapely.from_geojson([json.dumps(feature["geometry"]) for feature in features])
    columns: dict[str, Any] = {
        "id": [row["id"] for row in rows], "state": [row["state"] for row in rows],
        "job": [row["job"] for row in rows],
        "note": [row["reason"] or row["status"].get("text", "") for row in rows],
        "height": [row.get("measured", {}).get("height", np.nan) for row in rows],
        "area": [row["area"] for row in rows],
        "volume": [row.get("measured", {}).get("volume", np.nan) for row in rows],
        "confidence": [row["done"].get("confidence") for row in rows],
        "photos": [len(row["photos"]) for row in rows],
        "seconds": [row["done"].get("job_seconds", np.nan) for row in rows],
        "cpu_seconds": [row["done"].get("cpu_seconds", np.nan) for row in rows],
    }  # fmt: skip
    texts = ("id", "state", "job", "note")
    data = [np.array(values, object if name in texts else float) for name, values in columns.items()]
    made = io.BytesIO()  # in memory first: SQLite's words about a full disk are no sentence
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # coordinates of a scene have no CRS
        pyogrio.raw.write(
            made, shapely.to_wkb(shapes), data, list(columns), layer="buildings", driver="GPKG",
            crs=georeference.crs, geometry_type="Unknown",
        )  # fmt: skip
    with atomic_path(path) as temporary:
        temporary.write_bytes(made.getvalue())


def write_town(
    path: Path, meshes: dict[str, Mesh], georeference: Georeference, terrain: tuple[Mesh, Texture] | None = None
) -> None:
    """Write all buildings and the terrain in one GLB, a node each, in local coordinates with y up as the format wants
    it.

    Args:
        path: of the GLB file.
        meshes: mesh of each building by its name, scene frame.
        georeference: of the town.
        terrain: mesh and texture, local frame; None without.
    """
    import trimesh

    scene = trimesh.Scene()
    if terrain is not None:
        ground, texture = terrain
        y_up = replace(ground, vertices=ground.vertices @ GLTF_AXES.T)
        surface = textured(y_up, texture, path.parent / TERRAIN_FOLDER / IMAGE)
        scene.add_geometry(surface, node_name="terrain", geom_name="terrain")
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
