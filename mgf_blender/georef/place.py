# SPDX-License-Identifier: GPL-3.0-or-later
"""Place the Blender scene in the world: its world is the job's local frame, and properties hold where that lies."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..scene_import.cameras import set_clipping
from ..scene_import.imported_scene import ImportedScene
from .files import Placement

#: Custom properties of the scene. The first five are those of BlenderGIS, so that its maps lie where they should.
CRS, EAST, NORTH, LATITUDE, LONGITUDE = "SRID", "crs x", "crs y", "latitude", "longitude"
HEIGHT, NORTH_ANGLE = "crs z", "north"
_HELP = {
    CRS: "Coordinate reference system",
    EAST: "Added to X for the easting",
    NORTH: "Added to Y for the northing",
    HEIGHT: "Added to Z for the height",
    LATITUDE: "Of the scene's origin, in degrees (WGS 84)",
    LONGITUDE: "Of the scene's origin, in degrees (WGS 84)",
    NORTH_ANGLE: "Direction of north in degrees clockwise from Y",
}


def place_scene(scene: bpy.types.Scene, imported: ImportedScene, found: Placement) -> None:
    """Move, turn and scale the scene's empty so that Blender's world is the local frame in metres, and note where."""
    imported.root.matrix_world = Matrix(root_matrix(imported, found).tolist())
    for obj in imported.objects("Cameras"):
        set_clipping(obj.data, imported)
    note_place(scene, found)


def note_place(scene: bpy.types.Scene, found: Placement) -> None:
    """Note where a scene whose world is the local frame lies, in its custom properties."""
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 1.0
    values: dict[str, str | float] = dict(zip((EAST, NORTH, HEIGHT), found.offset, strict=True))
    if found.crs:
        values[CRS] = found.crs
    if found.origin is not None:
        values[LATITUDE], values[LONGITUDE] = found.origin[:2]
    if found.north_known:
        values[NORTH_ANGLE] = 0.0
    for name, text in _HELP.items():
        if name in values:
            scene[name] = values[name]
            scene.id_properties_ui(name).update(description=text)
        elif name in scene:
            del scene[name]


def root_matrix(imported: ImportedScene, found: Placement) -> np.ndarray:
    """Return the empty's world matrix [4, 4] for objects that hold scene coordinates less the scene's offset."""
    shift = np.eye(4)
    shift[:3, 3] = imported.offset
    return np.asarray(found.to_local @ shift)


def is_placed(scene: bpy.types.Scene, imported: ImportedScene, found: Placement) -> bool:
    """Tell whether the scene still lies as :func:`place_scene` put it for this georeference."""
    if [scene.get(name) for name in (EAST, NORTH, HEIGHT)] != list(found.offset):
        return False
    wanted, now = root_matrix(imported, found), np.array(imported.root.matrix_world)
    return bool(np.abs(now - wanted).max() <= 1e-5 * max(1.0, float(np.abs(wanted).max())))
