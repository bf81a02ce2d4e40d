# SPDX-License-Identifier: GPL-3.0-or-later
"""From the Models panel to levels of detail in the scene: options, the run, one object with levels."""

from __future__ import annotations

import ctypes
import json
import struct
from pathlib import Path

import addon_utils
import bpy
import numpy as np
import pytest
from finished_work import SIZES, TO_SCENE, write_models
from layouts import draw

from mgf_blender.models.lods import levels_of, shown_level
from mgf_blender.models.panel import MGF_PT_models
from mgf_blender.reconstruct.panel import MGF_PT_reconstruct
from mgf_blender.scene_import.imported_scene import ImportedScene


@pytest.fixture
def made(tmp_path):
    return write_models(tmp_path / "made models")


@pytest.fixture
def finished(made, addon, engine, house):
    """An imported finished job, whose engine makes those models."""
    engine("ok", FAKE_MODELS=made)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.import_result(directory=str(house.job))
    return bpy.context.scene.mgf


def world(obj: bpy.types.Object) -> np.ndarray:
    bpy.context.view_layer.update()
    return np.array([obj.matrix_world @ v.co for v in obj.data.vertices])


def test_no_job_no_panel(addon, engine):
    assert draw(MGF_PT_models).said == ""
    for name in ("make_models", "import_lods", "show_lod"):
        with pytest.raises(RuntimeError):
            getattr(bpy.ops.mgf, name)()


def test_button_to_levels(finished, house):
    drawn = draw(MGF_PT_models).said
    assert "Make Models" in drawn and "Import LODs" not in drawn and "0: chosen automatically" in drawn
    assert bpy.ops.mgf.make_models() == {"FINISHED"}
    line = json.loads((house.job / "arguments.json").read_text())
    assert line[:2] == ["models", str(house.job)] and "--cancel-on-eof" in line and "--detail" not in line
    assert line[line.index("--only") + 1] == "ifc,lod,points,solid,tiles,usd"
    drawn = draw(MGF_PT_models).said
    assert "Models finished in " in drawn and "Import LODs" in drawn and "Level 0" not in drawn
    assert "Models finished" not in draw(MGF_PT_reconstruct).said
    assert bpy.ops.mgf.import_lods() == {"FINISHED"}
    assert "Level 0: 2 faces\nLevel 1: 2 faces\nLevel 2: 2 faces" in draw(MGF_PT_models).said
    finished.models.kinds, finished.models.detail = {"solid"}, 30
    bpy.ops.mgf.make_models()
    line = " ".join(json.loads((house.job / "arguments.json").read_text()))
    assert "--only solid" in line and "--detail 30" in line and "--draco" not in line
    finished.models.draco = True
    bpy.ops.mgf.make_models()
    assert "--draco" in json.loads((house.job / "arguments.json").read_text())
    finished.models.kinds = set()
    with pytest.raises(RuntimeError, match="Nothing is chosen to be made"):
        bpy.ops.mgf.make_models()


def compress(path: Path) -> None:
    """Say in a GLB that its mesh is compressed, as the engine does; its first bytes stand for Draco's."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    imported = json.loads(data[20 : 20 + length])
    primitive = imported["meshes"][0]["primitives"][0]
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    for accessor in imported["accessors"]:
        del accessor["bufferView"]  # what they describe comes out of the extension
    imported["extensionsUsed"] = imported["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    text = json.dumps(imported).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    path.write_bytes(head + text + rest)


def test_a_blender_without_draco_says_what_to_do(finished, house, monkeypatch):
    def missing(self, name):
        raise OSError(f"{name}: cannot open shared object file: No such file or directory")

    monkeypatch.setattr(ctypes.LibraryLoader, "LoadLibrary", missing)
    bpy.ops.mgf.make_models()
    folder = house.job / "models"
    compress(folder / "mesh_lod1.glb")
    before = {block.name_full for block in (*bpy.data.objects, *bpy.data.meshes, *bpy.data.images)}
    with pytest.raises(RuntimeError, match=r"mesh_lod1.glb' is compressed, which this Blender cannot read; switch Com"):
        bpy.ops.mgf.import_lods()
    assert {block.name_full for block in (*bpy.data.objects, *bpy.data.meshes, *bpy.data.images)} == before


def test_a_damaged_level_is_refused_and_nothing_changes(finished, house):
    """Of compressed data that is none, Blender's importer makes a mesh without faces."""
    bpy.ops.mgf.make_models()
    bpy.ops.mgf.import_lods()
    path = house.job / "models" / "mesh_lod1.glb"
    before = {block.name_full for block in (*bpy.data.objects, *bpy.data.meshes, *bpy.data.images)}
    compress(path)
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"mesh_lod1.glb' (cannot be read; make the models again|is compressed)"):
            bpy.ops.mgf.import_lods()
        assert {block.name_full for block in (*bpy.data.objects, *bpy.data.meshes, *bpy.data.images)} == before
        path.write_bytes(b"draco")


def test_levels_stand_where_the_building_stands(finished, house):
    bpy.ops.mgf.make_models()
    bpy.ops.mgf.import_lods()
    scene = bpy.context.scene
    imported = ImportedScene.find(scene)
    found = levels_of(imported)
    assert [o.name.rsplit("_", 1)[1] for o in found] == ["LOD0", "LOD1", "LOD2"]
    assert len({o.parent for o in found}) == 1 and found[0].parent["fbx_type"] == "LodGroup"
    assert {c.name for o in found for c in o.users_collection} == {"LODs"}
    assert not any(o.name.startswith("building") for o in scene.collection.objects)
    root = np.array(imported.root.matrix_world)
    for obj, size in zip(found, SIZES, strict=True):
        local = np.array([(0, 0, 1), (size, 0, 1), (size, size, 1), (0, size, 1)], float)
        wanted = local @ TO_SCENE[:3, :3].T + TO_SCENE[:3, 3] - imported.offset
        wanted = wanted @ root[:3, :3].T + root[:3, 3]
        at = world(obj)
        nearest = np.linalg.norm(at[:, None] - wanted, axis=2).min(0)
        assert nearest.max() < 1e-4 * np.abs(wanted).max()
    before = world(found[1])
    found[0].parent.location.x += 5  # all levels move with their object
    assert np.abs(np.linalg.norm(world(found[1]) - before, axis=1) - 5 * np.linalg.norm(root[:3, 0])).max() < 1e-3


def test_one_level_is_shown_and_the_mesh_gives_way(finished):
    bpy.ops.mgf.make_models()
    bpy.ops.mgf.import_lods()
    imported = ImportedScene.find(bpy.context.scene)
    assert shown_level(imported) == 0 and all(o.hide_get() for o in imported.objects("Mesh"))
    bpy.ops.mgf.show_lod(level=2)
    assert shown_level(imported) == 2 and [o.hide_render for o in levels_of(imported)] == [True, True, False]
    bpy.ops.mgf.paint_mesh(kind="COLOR")
    assert shown_level(imported) is None and not any(o.hide_get() for o in imported.objects("Mesh"))


@pytest.mark.parametrize("kind", ["PHOTO", "RENDER", "ERROR", "MESH"])
def test_no_level_covers_what_the_camera_shows(finished, kind):
    """Renders are clear beside the building, where a level would look through; on the mesh it would flicker."""
    bpy.ops.mgf.make_models()
    bpy.ops.mgf.import_lods()
    imported = ImportedScene.find(bpy.context.scene)
    bpy.context.scene.camera = imported.objects("Renders")[0].parent
    bpy.ops.mgf.show_in_camera(kind=kind)
    assert all(o.hide_get() for o in levels_of(imported)) and imported.objects("Mesh")[0].hide_get() == (kind != "MESH")


def test_levels_come_into_a_collection_that_is_excluded(finished):
    bpy.ops.mgf.make_models()
    for child in bpy.context.view_layer.layer_collection.children:
        child.exclude = True
    assert bpy.ops.mgf.import_lods() == {"FINISHED"}
    assert len(levels_of(ImportedScene.find(bpy.context.scene))) == len(SIZES)


def test_importing_again_leaves_nothing_behind(finished):
    bpy.ops.mgf.make_models()
    bpy.ops.mgf.import_lods()
    counts = [len(store) for store in (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.images)]
    bpy.ops.mgf.import_lods()
    again = [len(store) for store in (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.images)]
    assert again == counts
    bpy.ops.ed.undo_push(message="import")
    bpy.ops.mgf.show_lod(level=1)
    bpy.ops.ed.undo_push(message="show")
    bpy.ops.ed.undo()
    assert shown_level(ImportedScene.find(bpy.context.scene)) == 0 and "Level 0" in draw(MGF_PT_models).said


def test_what_cannot_be_read_is_one_sentence_and_changes_nothing(finished, house):
    bpy.ops.mgf.make_models()
    before = {o.name for o in bpy.data.objects}, {c.name for c in bpy.data.collections}, len(bpy.data.meshes)
    folder = house.job / "models"
    (folder / "mesh_lod1.glb").write_bytes(b"glTF and no more")
    with pytest.raises(RuntimeError, match=r"mesh_lod1\.glb' cannot be read; make the models again"):
        bpy.ops.mgf.import_lods()
    (folder / "mesh_lod1.glb").unlink()
    with pytest.raises(RuntimeError, match=r"The models lack 'mesh_lod1\.glb'"):
        bpy.ops.mgf.import_lods()
    for text in ("{", "[]", '{"files": {}}', '{"files": 3, "to_scene": 4}'):
        (folder / "models.json").write_text(text)
        with pytest.raises(RuntimeError, match="cannot be read; make the models again"):
            bpy.ops.mgf.import_lods()
    assert before == ({o.name for o in bpy.data.objects}, {c.name for c in bpy.data.collections}, len(bpy.data.meshes))


def test_a_missing_package_and_a_missing_importer_say_how(finished, engine, monkeypatch):
    bpy.ops.mgf.make_models()
    monkeypatch.setattr(addon_utils, "check", lambda name: (False, False))
    with pytest.raises(RuntimeError, match=r"enable 'glTF 2\.0 format'"):
        bpy.ops.mgf.import_lods()
    engine("bad")
    with pytest.raises(RuntimeError, match="ifcopenshell"):
        bpy.ops.mgf.make_models()
    assert "tick Models in the preferences" in " ".join(draw(MGF_PT_models).said.split())
