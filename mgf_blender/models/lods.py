# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels of detail in the scene: one empty that moves them all, a mesh object per level, one of them shown.

The objects are named ``NAME_LOD0`` … as game engines expect, and the empty carries ``fbx_type`` = ``LodGroup``, which
Blender's FBX exporter writes and Unreal reads as one mesh with levels.
"""

from __future__ import annotations

from pathlib import Path

import addon_utils
import bpy
import numpy as np
from mathutils import Matrix

from ..common.errors import UserError
from ..scene_import.imported_scene import ImportedScene, hide
from .index import Levels

KIND, LEVEL_KEY, _OURS = "LODs", "mgf_level", "mgf_lod"
_ADDON = "io_scene_gltf2"


def levels_of(imported: ImportedScene) -> list[bpy.types.Object]:
    """Return the imported levels, the finest first."""
    return sorted((o for o in imported.objects(KIND) if LEVEL_KEY in o), key=lambda o: o[LEVEL_KEY])


def import_levels(imported: ImportedScene, levels: Levels, name: str) -> list[bpy.types.Object]:
    """Import the levels of detail and show the finest; earlier ones are replaced, the mesh is hidden.

    Args:
        name: of the building.

    Raises:
        UserError: a file cannot be read, or Blender's importer is switched off; the scene is then unchanged.
    """
    if not addon_utils.check(_ADDON)[1]:
        raise UserError("Blender's own importer of glTF is off; enable 'glTF 2.0 format' among the add-ons.")
    read: list[bpy.types.Object] = []
    try:
        for path in levels.files:
            read.append(_read(path))
    except UserError:
        _remove(read)
        raise
    clear_levels(imported)
    group = bpy.data.objects.new(name, None)
    group["fbx_type"] = "LodGroup"
    group.empty_display_type, group.empty_display_size = "CUBE", 0.1 * imported.radius
    shift = np.eye(4)
    shift[:3, 3] = -imported.offset
    place = shift @ levels.to_scene
    imported.add(KIND, group, np.eye(4))
    for level, obj in enumerate(read):
        obj.name = obj.data.name = f"{name}_LOD{level}"
        obj[LEVEL_KEY] = level
        imported.add(KIND, obj, place @ np.array(obj.matrix_world, np.float64))
        obj.parent, obj.matrix_parent_inverse = group, Matrix.Identity(4)
    show_level(imported, 0)
    for mesh in imported.objects("Mesh"):
        hide(mesh)  # the finest level lies on it
    return read


def show_level(imported: ImportedScene, level: int) -> None:
    """Show one level, in viewports and renders; none where there is no such level."""
    for obj in levels_of(imported):
        hide(obj, obj[LEVEL_KEY] != level)
        obj.hide_render = obj[LEVEL_KEY] != level


def shown_level(imported: ImportedScene) -> int | None:
    """Return the level that is shown; None when none is."""
    return next((int(o[LEVEL_KEY]) for o in levels_of(imported) if not o.hide_render and not o.hide_get()), None)


def clear_levels(imported: ImportedScene) -> None:
    """Remove the imported levels with their materials and pictures."""
    imported.clear(KIND)
    _remove_unused()


def _read(path: Path) -> bpy.types.Object:
    """Return the mesh object of a GLB, in no collection; its materials and pictures carry our mark.

    Raises:
        UserError: the file cannot be read.
    """
    new = _import_glb(path)
    for block in new:
        if isinstance(block, bpy.types.Material | bpy.types.Image):
            block[_OURS] = True
    objects = [block for block in new if isinstance(block, bpy.types.Object)]
    found = [obj for obj in objects if obj.type == "MESH"][:1]
    bpy.context.view_layer.update()
    for obj in found:
        world = obj.matrix_world.copy()
        obj.parent, obj.matrix_world = None, world
        for collection in tuple(obj.users_collection):
            collection.objects.unlink(obj)
    collections = [block for block in new if isinstance(block, bpy.types.Collection)]
    bpy.data.batch_remove([*(obj for obj in objects if obj not in found), *collections])
    if not found or not found[0].data.polygons:  # the importer passes over compressed data that is damaged
        _remove(found)
        raise UserError("'{path}' cannot be read; make the models again.", path=path)
    return found[0]


def _import_glb(path: Path) -> list[bpy.types.ID]:
    """Import a GLB by Blender's own importer and return what is new in the file.

    Raises:
        UserError: it cannot be read; nothing of it is left then.
    """
    stores = (bpy.data.objects, bpy.data.materials, bpy.data.images, bpy.data.meshes, bpy.data.collections)
    before = [{block.name_full for block in store} for store in stores]

    def new_blocks() -> list[bpy.types.ID]:
        return [b for store, names in zip(stores, before, strict=True) for b in store if b.name_full not in names]

    try:
        bpy.ops.import_scene.gltf(filepath=str(path))
    except RuntimeError as error:
        bpy.data.batch_remove(new_blocks())
        if _is_compressed(path):  # for a build without Draco's library, as Debian's
            raise UserError(
                "'{path}' is compressed, which this Blender cannot read; switch Compress off and make the models "
                "again.",
                path=path,
            ) from error
        raise UserError("'{path}' cannot be read; make the models again.", path=path) from error
    return new_blocks()


def _is_compressed(path: Path) -> bool:
    """Tell whether the head of a GLB asks for Draco."""
    with path.open("rb") as file:
        head = file.read(20)
        return b"KHR_draco_mesh_compression" in file.read(int.from_bytes(head[12:16], "little"))


def _remove(objects: list[bpy.types.Object]) -> None:
    """Remove what was read before a file that cannot be."""
    meshes = [o.data for o in objects]
    bpy.data.batch_remove(objects)
    bpy.data.batch_remove([m for m in meshes if m.users == 0])
    _remove_unused()


def _remove_unused() -> None:
    """Remove our materials and pictures that nothing uses."""
    for store in (bpy.data.materials, bpy.data.images):  # in this order: materials use pictures
        for block in [b for b in store if _OURS in b and b.users == 0]:
            store.remove(block)
