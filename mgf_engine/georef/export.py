# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the mesh in true coordinates: the folder ``georeferenced`` with PLY, OBJ and GLB in the local frame.

Float32 resolves half a metre at the northings of UTM, so the files hold local coordinates (metres, x east, y north, z
up) and say what is to be added: in a comment, in ``georef.json`` beside them, and the CRS in ``mesh.prj``.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.files.atomic import atomic_folder
from mgf_engine.geometry.mesh_files import IMAGE, write_glb, write_obj, write_ply
from mgf_engine.georef.crs import ProjectedCrs
from mgf_engine.georef.model import Georeference, write_georeference
from mgf_engine.model.mesh import Mesh, Texture

FOLDER = "georeferenced"
#: x east, y north, z up -> glTF's axes: x east, y up, z south.
GLTF_AXES = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def write_georeferenced(
    mesh: Mesh, georeference: Georeference, job: Path, texture: Texture | None, obj: bool, glb: bool
) -> Path | None:
    """Write the mesh (scene frame) in the local frame below the job folder; None where nothing tells its scale.

    The folder takes the place of an earlier one when all of it is written.

    Args:
        mesh: scene frame.
        georeference: scene frame to local frame, and its CRS.
        job: its folder.
        texture: where the mesh has one; its picture lies in the job folder.
        obj, glb: the formats to write beside PLY.
    """
    folder = job / FOLDER
    if not georeference.metric:
        shutil.rmtree(folder, ignore_errors=True)
        return None
    local = replace(mesh, vertices=georeference.local(mesh.vertices))
    says = comments(georeference)
    with atomic_folder(folder) as beside:
        write_ply(local, beside / "mesh.ply", says)
        if texture is not None and (obj or glb):
            shutil.copyfile(job / IMAGE, beside / IMAGE)
        if obj:
            write_obj(local, beside / "mesh.obj", texture, says)
        if glb:
            write_glb(local, beside / "mesh.glb", texture, GLTF_AXES, extras(georeference))
        write_georeference(georeference, beside)
        if georeference.crs is not None:
            (beside / "mesh.prj").write_text(ProjectedCrs(georeference.crs).wkt(), encoding="ascii", errors="replace")
    return folder


def comments(georeference: Georeference) -> list[str]:
    """Describe the coordinates for the headers of files, in ASCII."""
    x, y, z = georeference.offset
    axes = "x east, y north, z up" if georeference.north_known else "z up"
    lines = [f"local coordinates in metres, {axes}"]
    if any(georeference.offset):
        lines.append(f"add the offset {x:.3f} {y:.3f} {z:.3f} for easting, northing, height")
    if georeference.crs is not None:
        lines.append(f"coordinate reference system {georeference.crs}")
    if georeference.origin is not None:
        lines.append("origin at latitude {:.8f} longitude {:.8f} height {:.3f}".format(*georeference.origin))
    return [line.encode("ascii", "replace").decode().replace("\n", " ") for line in lines]


def extras(georeference: Georeference) -> dict[str, Any]:
    """Return the same for glTF."""
    return {
        "crs": georeference.crs, "offset": list(georeference.offset), "unit": georeference.unit,
        "axes": "x east, y up, z south; add the offset (easting, northing, height) to (x, -z, y)",
    }  # fmt: skip
