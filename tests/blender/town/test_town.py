# SPDX-License-Identifier: GPL-3.0-or-later
"""A town comes in as a collection for each building, light at first, and the full meshes on demand."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from finished_work import OFFSET, write_town
from layouts import draw

from mgf_blender.common.ply import read_ply
from mgf_blender.town.load import LIGHT_KEY, find_town
from mgf_blender.town.panel import MGF_PT_town


@pytest.fixture
def town(house, tmp_path) -> Path:
    """See :func:`finished_work.write_town`."""
    return write_town(tmp_path / "Ostviertel", house.job)


def choose(*names: str) -> None:
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj.name in names)


def test_a_town_is_a_collection_of_collections_in_true_coordinates(addon, town):
    assert bpy.ops.mgf.import_town(directory=str(town)) == {"FINISHED"}
    scene = bpy.context.scene
    top = find_town(scene)
    assert top.name == "Ostviertel" and sorted(c.name for c in top.children) == ["Terrain", "a", "b"]
    house = bpy.data.objects["b"]
    assert house.users_collection == (bpy.data.collections["b"],) and len(house.data.polygons) == 4
    low = np.array(house.bound_box).min(0)
    assert low == pytest.approx([20, 0, 1], abs=1e-5) and house["confidence"] == 0.75
    assert [scene[k] for k in ("SRID", "crs x", "crs y", "crs z")] == ["EPSG:25832", *OFFSET]
    said = draw(MGF_PT_town).said
    assert "2 buildings, 0 in full" in said and "Import Town" in said


def test_full_meshes_come_on_demand_and_go_again(addon, town):
    bpy.ops.mgf.import_town(directory=str(town))
    with pytest.raises(RuntimeError, match="Select buildings of a town first"):
        choose("Terrain")
        bpy.ops.mgf.show_full_building()
    choose("a")
    assert bpy.ops.mgf.show_full_building() == {"FINISHED"}
    obj, other = bpy.data.objects["a"], bpy.data.objects["b"]
    full = read_ply(town / "buildings" / "a" / "job" / "mesh.ply")
    assert len(obj.data.vertices) == len(full.positions) and len(other.data.polygons) == 4
    places = np.array([v.co for v in obj.data.vertices])
    assert places == pytest.approx(2 * full.positions + [3.0, -1.0, 19.0], abs=1e-3)
    said = draw(MGF_PT_town).said
    assert "2 buildings, 1 in full" in said and "a: confidence 0.75" in said
    bpy.ops.mgf.show_full_building()  # again: nothing to do
    meshes = len(bpy.data.meshes)
    assert bpy.ops.mgf.show_light_building() == {"FINISHED"}
    assert len(bpy.data.objects["a"].data.polygons) == 4 and LIGHT_KEY not in bpy.data.objects["a"]
    assert len(bpy.data.meshes) == meshes - 1


def test_buildings_whose_full_mesh_is_there_are_shown_though_another_s_is_gone(addon, town, capfd):
    """The first one was shown without an undo step, and the others were not."""
    bpy.ops.mgf.import_town(directory=str(town))
    (town / "buildings" / "a" / "job" / "mesh.ply").unlink()
    choose("a", "b")
    assert bpy.ops.mgf.show_full_building() == {"FINISHED"}
    assert LIGHT_KEY in bpy.data.objects["b"] and LIGHT_KEY not in bpy.data.objects["a"]
    assert "Warning" in capfd.readouterr().out
    choose("a")
    with pytest.raises(RuntimeError, match=r"mesh\.ply"):
        bpy.ops.mgf.show_full_building()


def test_importing_again_replaces_the_town_and_keeps_what_is_not_ours(addon, town, tmp_path):
    bpy.ops.mgf.import_town(directory=str(town))
    choose("a")
    bpy.ops.mgf.show_full_building()
    imported = bpy.data.objects.new("oak", None)
    bpy.data.collections["b"].objects.link(imported)
    bpy.ops.mgf.import_town(directory=str(town))
    towns = [c for c in bpy.context.scene.collection.children_recursive if "mgf_town" in c]
    assert len({o.name for o in bpy.data.objects if "mgf_building" in o}) == 3 and imported.name in bpy.data.objects
    assert [len(o.data.polygons) for o in bpy.data.objects if "mgf_building_job" in o] == [4, 4]
    assert len(towns) == 1 and imported.users_collection[0].name == "b"
    path = str(tmp_path / "town.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert len(find_town(bpy.context.scene).children) == 3


def test_what_is_no_town_is_refused(addon, town, tmp_path):
    with pytest.raises(RuntimeError, match="holds no town"):
        bpy.ops.mgf.import_town(directory=str(tmp_path))
    for name in ("a", "b"):
        (town / "buildings" / name / "light.ply").unlink()
    with pytest.raises(RuntimeError, match=r"No building of .* is done"):
        bpy.ops.mgf.import_town(directory=str(town))
    (town / "georef.json").unlink()
    with pytest.raises(RuntimeError, match="does not say where its buildings lie"):
        bpy.ops.mgf.import_town(directory=str(town))
    assert find_town(bpy.context.scene) is None


def test_a_damaged_town_changes_nothing(addon, town):
    bpy.ops.mgf.import_town(directory=str(town))
    there = {store: sorted(b.name for b in getattr(bpy.data, store)) for store in ("objects", "collections", "meshes")}
    for damaged in (town / "buildings" / "b" / "light.ply", town / "terrain" / "terrain.ply"):
        whole = damaged.read_bytes()
        damaged.write_text("ply")
        with pytest.raises(RuntimeError, match="is not a PLY file"):
            bpy.ops.mgf.import_town(directory=str(town))
        assert {store: sorted(b.name for b in getattr(bpy.data, store)) for store in there} == there
        damaged.write_bytes(whole)


def test_a_linked_town_is_left_alone(addon, town, tmp_path):
    """To show the full mesh of a linked building ended Blender at the next undo."""
    bpy.ops.mgf.import_town(directory=str(town))
    path = str(tmp_path / "town.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.scenes = there.scenes[:1]
        here.collections = [there.collections[there.collections.index("Ostviertel")]]
    bpy.context.scene.collection.children.link(here.collections[0])
    bpy.context.view_layer.update()
    choose("a")
    assert [o.name for o in bpy.context.view_layer.objects.selected] == ["a"]
    with pytest.raises(RuntimeError, match="Select buildings of a town first"):
        bpy.ops.mgf.show_full_building()
    bpy.ops.mgf.import_town(directory=str(town))
    top = find_town(bpy.context.scene)
    assert top.library is None and here.collections[0].library is not None
    bpy.context.window.scene = here.scenes[0]
    with pytest.raises(RuntimeError, match="The scene is linked from another file"):
        bpy.ops.mgf.import_town(directory=str(town))
