# SPDX-License-Identifier: GPL-3.0-or-later
"""The cube of Blender's startup file gives way to the building, unless somebody has touched it."""

from __future__ import annotations

import bpy
import pytest


@pytest.fixture
def startup(addon):
    """The scene of Blender's startup file."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=False)
    assert {"Cube", "Camera", "Light"} <= set(bpy.data.objects.keys())
    return bpy.context.scene


@pytest.mark.parametrize("operator", ["import_colmap", "import_result"])
def test_it_goes_with_the_first_import(startup, house, operator):
    given = {"filepath": str(house.folder)} if operator == "import_colmap" else {"directory": str(house.job)}
    getattr(bpy.ops.mgf, operator)(**given)
    assert "Cube" not in bpy.data.objects and "Cube" not in bpy.data.meshes
    assert {"Camera", "Light"} <= set(bpy.data.objects.keys())


def _add_modifier(cube):
    cube.modifiers.new("Bevel", "BEVEL")


def _move(cube):
    cube.location.x = 3


def _edit(cube):
    cube.data.vertices[0].co.z = 2


def _share(cube):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Second", cube.data))


def _parent(cube):
    bpy.data.objects["Light"].parent = cube


def _paint(cube):
    cube.data.materials[0] = bpy.data.materials.new("Brick")


def _rename(cube):
    cube.name = "Plinth"


@pytest.mark.parametrize("touch", [_add_modifier, _move, _edit, _share, _parent, _paint, _rename])
def test_one_that_was_touched_stays(startup, house, touch):
    cube = bpy.data.objects["Cube"]
    touch(cube)
    name = cube.name
    bpy.context.view_layer.update()
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert name in bpy.data.objects


def test_one_of_a_saved_file_stays(startup, house, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert "Cube" in bpy.data.objects


def test_one_that_is_added_later_stays(startup, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.mgf.reload_scene()
    bpy.ops.mgf.import_result(directory=str(house.job))
    assert "Cube" in bpy.data.objects
