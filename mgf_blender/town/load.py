# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a town into a Blender scene, whose world is then the town's local frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..common.materials import vertex_color_material
from ..common.meshes import MeshData, make_mesh, prepare_mesh
from ..common.ply import read_ply
from ..common.textures import texture_material
from ..georef.files import read_placement
from ..georef.place import note_place
from ..results.load import SHARP_ANGLE
from ..results.surface import show
from ..results.texture import check_picture, load_texture, read_uv
from ..scene_import.imported_scene import check_own, is_own, objects_below
from .files import COORDINATES, MESH, PICTURE, TERRAIN, TERRAIN_MESH, Building, Town

#: On the collection of a town: its folder. On a building's object: its name, its job folder, and its simplified mesh
#: while the full one is shown.
TOWN_KEY, BUILDING_KEY, JOB_KEY, LIGHT_KEY = "mgf_town", "mgf_building", "mgf_building_job", "mgf_light"


def find_town(scene: bpy.types.Scene, folder: Path | None = None) -> bpy.types.Collection | None:
    """Find the collection of the town in a folder, or of any; those of other files are not ours."""
    towns = [c for c in scene.collection.children_recursive if TOWN_KEY in c and is_own(c)]
    return next((c for c in towns if folder is None or Path(bpy.path.abspath(c[TOWN_KEY])) == folder), None)


def import_steps(scene: bpy.types.Scene, town: Town) -> Iterator[float]:
    """Import a town, yielding the share that is done; one of the same folder is replaced.

    Raises:
        UserError: a file is damaged, or the scene is linked from another file; it is then unchanged.
    """
    check_own(scene)
    meshes, steps = list[MeshData](), 2 * len(town.buildings) + 2
    for building in town.buildings:  # all is read before anything changes
        surface = read_ply(building.light)
        meshes.append(prepare_mesh(surface.positions, surface.triangles, surface.colors()))
        yield len(meshes) / steps
    folder = town.folder / TERRAIN
    terrain = _read_textured(folder / TERRAIN_MESH, folder, np.eye(4)) if (folder / TERRAIN_MESH).is_file() else None
    yield (len(meshes) + 1) / steps
    old = find_town(scene, town.folder)
    if old is not None:
        remove_town(old)
    top = bpy.data.collections.new(town.folder.name)
    top[TOWN_KEY] = str(town.folder)
    scene.collection.children.link(top)
    note_place(scene, town.placement)
    for count, (building, data) in enumerate(zip(town.buildings, meshes, strict=True), len(meshes) + 2):
        _add_building(top, building, data)
        yield count / steps
    if terrain is not None:
        _add_object(top, "Terrain", _make_textured("Terrain", terrain))
    yield 1.0


def remove_town(top: bpy.types.Collection) -> None:
    """Remove the collection of a town with all that the add-on put there; what the user put there stays."""
    del top[TOWN_KEY]
    ours = [o for o in objects_below(top) if BUILDING_KEY in o]
    meshes = {mesh for o in ours for mesh in (o.data, o.get(LIGHT_KEY)) if mesh is not None}
    bpy.data.batch_remove(ours)
    bpy.data.batch_remove([mesh for mesh in meshes if mesh.users == 0])
    bpy.data.batch_remove([c for c in (*top.children_recursive, top) if next(objects_below(c), None) is None])


def _add_building(top: bpy.types.Collection, building: Building, data: MeshData) -> None:
    mesh = make_mesh(building.name, data, SHARP_ANGLE)
    mesh.materials.append(vertex_color_material())
    obj = _add_object(top, building.name, mesh)
    obj[JOB_KEY] = str(building.job)
    if building.confidence is not None:
        obj["confidence"] = building.confidence


def _add_object(top: bpy.types.Collection, name: str, mesh: bpy.types.Mesh) -> bpy.types.Object:
    own = bpy.data.collections.new(name)
    top.children.link(own)
    obj = bpy.data.objects.new(name, mesh)
    obj[BUILDING_KEY] = name
    own.objects.link(obj)
    return obj


@dataclass(frozen=True)
class _Textured:
    """A mesh as read, and its picture where it has one."""

    data: MeshData
    picture: Path | None


def _read_textured(file: Path, folder: Path, to_local: np.ndarray) -> _Textured:
    """Read a mesh with the texture in a folder, where there is one, else with its vertex colours.

    Raises:
        UserError: a file is gone or damaged.
    """
    surface = read_ply(file)
    positions = surface.positions @ to_local[:3, :3].T + to_local[:3, 3]
    picture, coordinates = folder / PICTURE, folder / COORDINATES
    uv = None
    if picture.is_file() and coordinates.is_file():
        check_picture(picture)
        uv = read_uv(coordinates, len(surface.triangles))
    data = prepare_mesh(positions, surface.triangles, surface.colors(), None, uv)
    return _Textured(data, None if uv is None else picture)


def _make_textured(name: str, read: _Textured) -> bpy.types.Mesh:
    mesh = make_mesh(name, read.data, SHARP_ANGLE)
    if read.picture is None:
        mesh.materials.append(vertex_color_material())
    else:
        mesh.materials.append(texture_material(name, load_texture(read.picture)))
        show(mesh, "TEXTURE")
    return mesh


def town_of(obj: bpy.types.Object) -> Path:
    """Return the folder of the town that a building is of: its job is ``TOWN/buildings/ID/job``."""
    return Path(bpy.path.abspath(obj[JOB_KEY])).parents[2]


def show_full(obj: bpy.types.Object) -> None:
    """Show the full mesh of a building, with its texture.

    Raises:
        UserError: a file is gone or damaged; the simplified mesh then stays.
    """
    if obj.get(LIGHT_KEY) is not None:
        return
    job, placement = Path(bpy.path.abspath(obj[JOB_KEY])), read_placement(town_of(obj))
    to_local = np.eye(4) if placement is None else np.asarray(placement.to_local, np.float64)
    mesh = _make_textured(f"{obj[BUILDING_KEY]} full", _read_textured(job / MESH, job, to_local))
    obj[LIGHT_KEY] = obj.data
    obj.data = mesh


def show_light(obj: bpy.types.Object) -> None:
    """Show the simplified mesh of a building again; the full one is given up."""
    light = obj.get(LIGHT_KEY)
    if light is None:
        return
    full, obj.data = obj.data, light
    del obj[LIGHT_KEY]
    if full.users == 0:
        bpy.data.meshes.remove(full)
