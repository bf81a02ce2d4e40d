# SPDX-License-Identifier: GPL-3.0-or-later
"""Odd states of Blender's data and modes."""

from __future__ import annotations

import bpy

from mgf_blender.scene_import.imported_scene import ROLE_KEY, ImportedScene
from odd.stage import Stage


def as_it_is(stage: Stage) -> None: ...


def no_active_camera(stage: Stage) -> None:
    bpy.context.scene.camera = None


def foreign_camera(stage: Stage) -> None:
    camera = bpy.data.objects.new("mine", bpy.data.cameras.new("mine"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera


def camera_is_a_cube(stage: Stage) -> None:
    """Blender lets any object be the camera."""
    bpy.context.scene.camera = _cube()


def cameras_deleted(stage: Stage) -> None:
    bpy.data.batch_remove(_objects("Cameras"))


def origin_deleted(stage: Stage) -> None:
    if _imported() is not None:
        bpy.data.objects.remove(_imported().root)


def origin_scaled_to_zero(stage: Stage) -> None:
    if _imported() is not None:
        _imported().root.scale = 0, 0, 0


def origin_flattened(stage: Stage) -> None:
    if _imported() is not None:
        _imported().root.scale = 1, 0, 1


def origin_hung_elsewhere(stage: Stage) -> None:
    if _imported() is not None:
        _imported().root.parent = _cube()


def origin_locked_away(stage: Stage) -> None:
    """In a collection outside the scene."""
    if _imported() is not None:
        bpy.context.scene.collection.children.unlink(_imported().collection)


def collection_deleted(stage: Stage) -> None:
    if _imported() is not None:
        bpy.data.collections.remove(_imported().collection)


def collections_below_deleted(stage: Stage) -> None:
    if _imported() is not None:
        bpy.data.batch_remove(list(_imported().collection.children))


def collection_excluded(stage: Stage) -> None:
    for child in bpy.context.view_layer.layer_collection.children:
        child.exclude = True


def everything_hidden(stage: Stage) -> None:
    for obj in bpy.context.view_layer.objects:
        obj.hide_set(True)


def everything_selected(stage: Stage) -> None:
    for obj in bpy.context.view_layer.objects:
        obj.select_set(True)


def everything_unlinked(stage: Stage) -> None:
    for obj in list(bpy.data.objects):
        for collection in list(obj.users_collection):
            collection.objects.unlink(obj)


def mesh_deleted(stage: Stage) -> None:
    bpy.data.batch_remove(_objects("Mesh"))


def mesh_data_emptied(stage: Stage) -> None:
    if _mesh() is not None:
        _mesh().data.clear_geometry()


def mesh_without_colors_or_materials(stage: Stage) -> None:
    if _mesh() is not None:
        _mesh().data.materials.clear()
        for layer in list(_mesh().data.color_attributes):
            _mesh().data.color_attributes.remove(layer)


def materials_without_nodes(stage: Stage) -> None:
    for material in bpy.data.materials:
        if material.node_tree is not None:
            material.node_tree.nodes.clear()


def mesh_with_empty_slots(stage: Stage) -> None:
    if _mesh() is not None:
        _mesh().data.materials.append(None)


def mesh_duplicated(stage: Stage) -> None:
    for obj in (_mesh(), *_objects("Cameras")[:1], *_objects("Points")[:1]):
        if obj is not None:
            double = obj.copy()
            double.data = obj.data.copy()
            obj.users_collection[0].objects.link(double)


def tree_duplicated(stage: Stage) -> None:
    if _imported() is not None:
        double = _imported().collection.copy()
        bpy.context.scene.collection.children.link(double)


def second_import(stage: Stage) -> None:
    bpy.ops.mgf.import_colmap(filepath=str(stage.work / "plain"), replace=False)


def properties_of_ours_removed(stage: Stage) -> None:
    for obj in bpy.data.objects:
        for name in [n for n in sorted(obj.keys()) if n.startswith("mgf_") and n not in {"mgf_kind", ROLE_KEY}]:
            del obj[name]


def mesh_in_edit_mode(stage: Stage) -> None:
    _enter(_mesh(), "EDIT")


def mesh_in_sculpt_mode(stage: Stage) -> None:
    _enter(_mesh(), "SCULPT")


def mesh_in_vertex_paint(stage: Stage) -> None:
    _enter(_mesh(), "VERTEX_PAINT")


def points_in_edit_mode(stage: Stage) -> None:
    _enter(next(iter(_objects("Points")), None), "EDIT")


def cube_in_edit_mode(stage: Stage) -> None:
    _enter(_cube(), "EDIT")


def text_in_edit_mode(stage: Stage) -> None:
    text = bpy.data.objects.new("text", bpy.data.curves.new("text", "FONT"))
    bpy.context.scene.collection.objects.link(text)
    _enter(text, "EDIT")


def armature_in_pose_mode(stage: Stage) -> None:
    bones = bpy.data.objects.new("bones", bpy.data.armatures.new("bones"))
    bpy.context.scene.collection.objects.link(bones)
    _enter(bones, "POSE")


def two_meshes_selected(stage: Stage) -> None:
    for number in range(2):
        cube = _cube()
        cube.select_set(True)
        cube.location.x = number


def new_scene_shown(stage: Stage) -> None:
    show_scene(bpy.data.scenes.new("new"))


def full_copy_shown(stage: Stage) -> None:
    bpy.ops.scene.new(type="FULL_COPY")


def linked_copy_shown(stage: Stage) -> None:
    bpy.ops.scene.new(type="LINK_COPY")


def scene_removed(stage: Stage) -> None:
    """The one with the work; another is shown."""
    old = bpy.context.scene
    show_scene(bpy.data.scenes.new("other"))
    bpy.data.scenes.remove(old)


def collections_linked(stage: Stage) -> None:
    """From a file of another; the own scene is empty."""
    bpy.ops.wm.open_mainfile(filepath=str(stage.folder / "empty.blend"), load_ui=False)
    _append(stage, "collections")
    for collection in bpy.data.collections:
        if collection.library is not None and collection.get(ROLE_KEY) == "tree":
            bpy.context.scene.collection.children.link(collection)
    for collection in bpy.data.collections:
        if collection.library is not None and "mgf_town" in collection:
            bpy.context.scene.collection.children.link(collection)
    for obj in bpy.context.view_layer.objects:
        obj.select_set(True)


def collections_overridden(stage: Stage) -> None:
    collections_linked(stage)
    for child in list(bpy.context.scene.collection.children):
        child.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)


def linked_beside_own(stage: Stage) -> None:
    _append(stage, "collections")
    for collection in bpy.data.collections:
        if collection.library is not None and (collection.get(ROLE_KEY) == "tree" or "mgf_town" in collection):
            bpy.context.scene.collection.children.link(collection)


def linked_scene_shown(stage: Stage) -> None:
    _append(stage, "scenes")
    show_scene(next(scene for scene in bpy.data.scenes if scene.library is not None))


def images_without_files(stage: Stage) -> None:
    for image in bpy.data.images:
        image.filepath = "//gone.png"


def images_removed(stage: Stage) -> None:
    bpy.data.batch_remove([i for i in bpy.data.images if i.library is None])


def images_generated(stage: Stage) -> None:
    for image in bpy.data.images:
        image.source = "GENERATED"


def undo_off(stage: Stage) -> None:
    bpy.context.preferences.edit.use_global_undo = False


def unsaved(stage: Stage) -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def _imported() -> ImportedScene | None:
    return ImportedScene.find(bpy.context.scene)


def _objects(kind: str) -> list[bpy.types.Object]:
    imported = _imported()
    return imported.objects(kind) if imported is not None else []


def _mesh() -> bpy.types.Object | None:
    return next(iter(_objects("Mesh")), None)


def _cube() -> bpy.types.Object:
    mesh = bpy.data.meshes.new("cube")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    cube = bpy.data.objects.new("cube", mesh)
    bpy.context.scene.collection.objects.link(cube)
    return cube


def _enter(obj: bpy.types.Object | None, mode: str) -> None:
    if obj is None:
        return
    bpy.context.view_layer.update()
    if obj.name not in bpy.context.view_layer.objects:
        return
    obj.hide_set(False)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode=mode)


def show_scene(scene: bpy.types.Scene) -> None:
    bpy.context.window.scene = scene
    bpy.context.view_layer.update()


def _append(stage: Stage, kind: str) -> None:
    with bpy.data.libraries.load(str(stage.folder / "library.blend"), link=True) as (there, here):
        setattr(here, kind, list(getattr(there, kind)))
