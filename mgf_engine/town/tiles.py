# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a town as 3D Tiles 1.1: a tile for each building with several levels of detail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine import __version__
from mgf_engine.files.atomic import write_json
from mgf_engine.geometry.mesh_files import IMAGE, write_glb
from mgf_engine.georef.export import GLTF_AXES
from mgf_engine.georef.model import Georeference
from mgf_engine.mesh.decimate import reduce_faces
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models.lod import measure_deviation
from mgf_engine.models.place import place_on_earth
from mgf_engine.models.tiles import make_tileset

FOLDER, FILE, TERRAIN = "tiles", "tileset.json", "terrain.glb"
_COARSE, _SAMPLES = 0.1, 20_000  # share of the faces from afar; points that tell how far off that is


def write_tiles(
    folder: Path, meshes: dict[str, Mesh], georeference: Georeference, terrain: tuple[Mesh, Texture] | None = None
) -> bool:
    """Write the tileset, two GLB files for each building, and one of the terrain.

    Args:
        folder: of the tileset.
        meshes: by name, local frame.
        georeference: local frame and CRS.
        terrain: local frame, with its texture, whose picture lies in ``terrain`` beside the folder.

    Returns:
        Whether anybody knows where on Earth the town lies; else it is at the centre of the globe.
    """
    folder.mkdir(parents=True, exist_ok=True)
    place = place_on_earth(georeference, lambda points: points + np.array(georeference.offset), np.eye(3))
    children: list[dict[str, Any]] = []
    for name, mesh in meshes.items():
        coarse = reduce_faces(mesh, max(50, round(_COARSE * len(mesh.faces))))
        names = [f"{name}_lod0.glb", f"{name}_lod1.glb"]
        for file, level in zip(names, (mesh, coarse), strict=True):
            write_glb(level, folder / file, turn=GLTF_AXES)
        error = measure_deviation(mesh, coarse, _SAMPLES).p95
        children.append(make_tileset(names, [0.0, error], mesh.vertices, None)["root"])
    everything = np.concatenate([mesh.vertices for mesh in meshes.values()])
    if terrain is not None:
        ground, texture = terrain
        write_glb(ground, folder / TERRAIN, texture, GLTF_AXES, picture=folder.parent / "terrain" / IMAGE)
        children.append(make_tileset([TERRAIN], [0.0], ground.vertices, None)["root"])
        everything = np.concatenate([everything, ground.vertices])
    low, high = everything.min(0), everything.max(0)
    box = [*(0.5 * (low + high)).tolist(), *np.diag(0.5 * (high - low)).ravel().tolist()]
    size = float(np.linalg.norm(high - low))
    root: dict[str, Any] = {
        "boundingVolume": {"box": box}, "geometricError": size, "refine": "ADD",
        "children": children,
    }  # fmt: skip
    if place is not None:
        root["transform"] = place.T.ravel().tolist()  # column by column
    asset = {"version": "1.1", "generator": f"mgf {__version__}"}
    write_json(folder / FILE, {"asset": asset, "geometricError": size, "root": root})
    return place is not None
