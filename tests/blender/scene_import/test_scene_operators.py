# SPDX-License-Identifier: GPL-3.0-or-later
"""Putting an imported scene right: camera, render size, scale, up axis."""

from __future__ import annotations

import os
import re
from pathlib import Path

import blf
import bpy
import numpy as np
import pytest
import synthetic
from mathutils import Matrix, Vector

from mgf_blender import translations
from mgf_blender.common import runner
from mgf_blender.common.job import DONE, Job
from mgf_blender.common.views import side_of_cameras
from mgf_blender.scene_import import placement
from mgf_blender.scene_import.cameras import PHOTO_KEY
from mgf_blender.scene_import.crop import crop_text, find_crop_box
from mgf_blender.scene_import.framing import frame_imported
from mgf_blender.scene_import.imported_scene import ImportedScene
from mgf_blender.scene_keys import scene_key


@pytest.fixture
def imported(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    return ImportedScene.find(bpy.context.scene)


def render_size() -> tuple:
    render = bpy.context.scene.render
    return render.resolution_x, render.resolution_y, render.pixel_aspect_x, render.pixel_aspect_y


def test_every_way_to_name_the_model(addon, house):
    for path in (house.folder, house.model, house.model / "images.bin", house.model / "points3D.bin"):
        bpy.ops.mgf.import_colmap(filepath=str(path))
        assert len([c for c in bpy.data.collections if c.get("mgf_role") == "tree"]) == 1
        assert Path(addon.source).is_dir()
    bpy.ops.mgf.import_colmap(directory=str(house.folder) + "/", filepath=str(house.folder / "untitled"))
    for wrong in ("/nowhere/at/all", str(house.folder / "typing mistake")):  # not the model of a folder around it
        with pytest.raises(RuntimeError, match="does not exist"):
            bpy.ops.mgf.import_colmap(filepath=wrong)


def test_the_model_is_read_once(addon, house, monkeypatch):
    """That of a large scene takes seconds, in which Blender stands still."""
    read, whole = [], Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.append(path.name) or whole(path))
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert sorted(read) == ["cameras.bin", "images.bin", "points3D.bin"] and len(addon.photos) >= 3


@pytest.mark.parametrize("override", [False, True])
def test_what_is_linked_from_another_file_is_neither_replaced_nor_added_to(addon, house, tmp_path, override):
    """Blender lets nobody link objects into such collections, and what was removed from them would come back."""
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.import_result(directory=str(house.job))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "häuser.blend"))
    name = ImportedScene.find(bpy.context.scene).collection.name
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "häuser.blend"), link=True) as (_, wanted):
        wanted.collections = [name]
    linked = bpy.data.collections[name]
    bpy.context.scene.collection.children.link(linked)
    if override:
        linked = linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
    bpy.context.scene.camera = next(o for o in linked.all_objects if o.type == "CAMERA")
    before = {o.name_full for o in linked.all_objects}
    assert ImportedScene.find(bpy.context.scene) is None and not bpy.ops.mgf.add_crop_box.poll()
    bpy.ops.mgf.import_result(directory=str(house.job))
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.import_result(directory=str(house.job))
    bpy.ops.mgf.add_crop_box()
    all_imported = ImportedScene.find_all(bpy.context.scene)
    assert len(all_imported) == 1 and all(o.library is None for o in all_imported[0].collection.all_objects)
    assert {o.name_full for o in linked.all_objects} == before


def test_a_scene_that_is_linked_is_refused_in_a_sentence(addon, house, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "other.blend"), link=True) as (there, wanted):
        wanted.scenes = there.scenes
    bpy.context.window.scene = next(s for s in bpy.data.scenes if s.library)
    with pytest.raises(RuntimeError, match="is linked from another file"):
        bpy.ops.mgf.import_colmap(filepath=str(house.folder))


def test_another_scene_in_place_of_an_earlier_one_has_its_own_name_and_pose(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    imported = ImportedScene.find(bpy.context.scene)
    pose = imported.root.matrix_world.copy()
    imported.collection.name = "My house"  # the user's own name and pose stay when the same scene is imported again
    imported.root.location.x += 5
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert imported.collection.name == "My house" and imported.root.matrix_world != pose
    for camera in imported.objects("Cameras"):
        camera[PHOTO_KEY] = f"of another scene {camera[PHOTO_KEY]}"
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert imported.collection.name == house.folder.name and imported.root.name == f"{house.folder.name} Origin"
    assert np.allclose(imported.root.matrix_world, pose, atol=1e-6)


def test_another_scene_takes_the_place_of_the_first_with_its_mesh_and_job(addon, house, tmp_path):
    """The first building's mesh stood beside the new cameras, and the next job ran in the first one's folder."""
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.import_result(directory=str(house.job))
    bpy.ops.mgf.add_crop_box()
    bpy.ops.mgf.add_section()
    mine = bpy.data.objects.new("Mine", None)
    ImportedScene.find(bpy.context.scene).collection.objects.link(mine)
    addon.photo_folder = str(house.folder / "images")
    runner.submit(ended := Job(["engine"], house.job, "house", scene_key=scene_key(bpy.context.scene)))
    ended.status = DONE
    other = synthetic.write_house(tmp_path / "other", prefix="DSC")
    bpy.ops.mgf.import_colmap(filepath=str(other.folder))
    imported = ImportedScene.find(bpy.context.scene)
    kinds = {o.get("mgf_kind") or o.get("mgf_role") or o.name for o in bpy.data.objects}
    assert kinds == {"root", "Cameras", "Points", "Mine"} and len(imported.objects("Cameras")) == 12
    assert not addon.job_folder and not addon.figures and not runner.jobs()
    assert all(Path(photo.file).is_relative_to(other.folder) for photo in addon.photos)  # not "not found"
    assert [m.name for m in bpy.data.meshes] == ["Sparse Points"]


@pytest.mark.parametrize("button", ["add_crop_box", "select_crop_box", "add_section", "select_section"])
def test_what_a_button_selects_is_selected_from_edit_mode_as_well(imported, house, button):
    """The mesh stayed in Edit Mode behind the crop box; the section's button did nothing."""
    bpy.ops.mgf.import_result(directory=str(house.job))
    bpy.ops.mgf.add_crop_box()
    bpy.ops.mgf.add_section()
    mesh = bpy.context.view_layer.objects.active = imported.objects("Mesh")[0]
    bpy.ops.object.mode_set(mode="EDIT")
    getattr(bpy.ops.mgf, button)(**({"name": "Section"} if button == "select_section" else {}))
    active = bpy.context.view_layer.objects.active
    assert bpy.context.mode == "OBJECT" and mesh.mode == "OBJECT"
    assert active.name.startswith("Crop Box" if "crop" in button else "Section") and active.select_get()


def test_the_same_scene_again_keeps_its_job(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.import_result(directory=str(house.job))
    bpy.ops.mgf.import_colmap(filepath=str(house.model / "images.bin"))
    assert addon.job_folder == str(house.job) and addon.figures
    assert ImportedScene.find(bpy.context.scene).objects("Mesh")


@pytest.mark.parametrize("locked", ["", "sparse", "sparse/0"])
@pytest.mark.parametrize("operator", ["import_colmap", "import_photos"])
def test_a_folder_that_may_not_be_read_is_named_and_nothing_is_imported(addon, house, monkeypatch, locked, operator):
    """A model that was not seen counted as missing, and its cameras were computed anew."""
    folder, access = house.folder / locked, os.access
    monkeypatch.setattr(os, "access", lambda path, how: Path(path) != folder and access(path, how))
    with pytest.raises(RuntimeError, match=f"No permission for '{re.escape(str(folder))}'; change its permissions"):
        getattr(bpy.ops.mgf, operator)(directory=str(house.folder))
    assert not bpy.data.objects and not addon.source and not addon.job_folder and not runner.jobs()


def test_no_path_is_no_model(addon):
    with pytest.raises(RuntimeError, match="No model was chosen"):
        bpy.ops.mgf.import_colmap()


def test_source_stays_true_when_the_program_is_started_elsewhere(addon, house, monkeypatch):
    monkeypatch.chdir(house.folder.parent)
    bpy.ops.mgf.import_colmap(filepath=house.folder.name)
    assert addon.source == str(house.folder) and Path(addon.photos[0].file).is_absolute()


def test_bad_model_leaves_the_scene_alone(addon, house):
    (house.model / "points3D.bin").write_bytes(b"\1")
    with pytest.raises(RuntimeError, match="damaged or ends too early"):
        bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert not bpy.data.objects and not addon.source and len(bpy.context.scene.collection.children) == 0


def test_missing_photos_are_counted(addon, house, capfd):
    for path in list((house.folder / "images").rglob("*.png"))[:5]:
        path.unlink()
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert "5 of 12 photos were not found" in "".join(capfd.readouterr())
    assert len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12


def test_render_takes_the_size_of_each_camera(imported, house):
    seen = set()
    for _ in range(12):
        bpy.ops.mgf.look_through(step=1)
        name = bpy.context.scene.camera[PHOTO_KEY]
        _, width, height, _ = synthetic.CAMERAS[house.poses[name][0]]
        assert render_size()[:2] == (width, height)
        seen.add(name)
    assert seen == set(house.poses)


def test_render_follows_when_the_camera_changes_by_other_means(imported):
    other = next(o for o in imported.objects("Cameras") if tuple(o["mgf_size"]) == (400, 900))
    bpy.context.scene.camera = other
    bpy.context.view_layer.update()
    assert render_size()[:2] == (400, 900)
    bpy.context.scene.mgf.fit_render = False
    bpy.context.scene.camera = next(o for o in imported.objects("Cameras") if tuple(o["mgf_size"]) == (640, 480))
    bpy.context.view_layer.update()
    assert render_size()[:2] == (400, 900)


def test_scale_by_two_points(imported):
    cameras = imported.objects("Cameras")[:2]
    bpy.context.view_layer.update()
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in cameras)
    before = [o.data.clip_end for o in cameras]
    measured = (cameras[0].matrix_world.translation - cameras[1].matrix_world.translation).length
    bpy.ops.mgf.set_scale(distance=3 * measured)
    bpy.context.view_layer.update()
    now = (cameras[0].matrix_world.translation - cameras[1].matrix_world.translation).length
    assert now == pytest.approx(3 * measured, rel=1e-5)
    assert cameras[0].data.clip_end == pytest.approx(3 * before[0], rel=1e-4)
    cameras[0].select_set(False)
    with pytest.raises(RuntimeError, match="exactly two"):
        bpy.ops.mgf.set_scale(distance=1.0)


def test_scale_in_edit_mode_is_one_undo_step(imported, capfd):
    mesh = bpy.data.meshes.new("rod")
    mesh.from_pydata([(0, 0, 0), (0, 0, 2.5), (9, 9, 9)], [(0, 1)], [])
    rod = bpy.data.objects.new("rod", mesh)
    bpy.context.scene.collection.objects.link(rod)
    bpy.context.view_layer.objects.active = rod
    bpy.ops.ed.undo_push(message="rod")
    bpy.ops.object.mode_set("EXEC_DEFAULT", True, mode="EDIT")
    bpy.ops.mesh.select_all("EXEC_DEFAULT", True, action="DESELECT")
    with pytest.raises(RuntimeError, match="exactly two"):
        bpy.ops.mgf.set_scale(distance=5.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    for vertex, chosen in zip(mesh.vertices, (True, True, False), strict=True):
        vertex.select = chosen
    bpy.ops.object.mode_set("EXEC_DEFAULT", True, mode="EDIT")
    bpy.ops.ed.undo_push(message="two vertices")
    before = ImportedScene.find(bpy.context.scene).root.matrix_basis.median_scale
    bpy.ops.mgf.set_scale("EXEC_DEFAULT", True, distance=5.0)
    assert "2.5 measured, scaled by 2" in capfd.readouterr().out and bpy.context.mode == "OBJECT"
    assert ImportedScene.find(bpy.context.scene).root.matrix_basis.median_scale == pytest.approx(2 * before)
    bpy.ops.ed.undo()
    assert ImportedScene.find(bpy.context.scene).root.matrix_basis.median_scale == pytest.approx(before)
    bpy.ops.ed.redo()
    assert ImportedScene.find(bpy.context.scene).root.matrix_basis.median_scale == pytest.approx(2 * before)


def test_up_axis_by_hand_and_back(imported):
    root = imported.root
    upright = np.array(root.matrix_basis)[:3, :3]
    bpy.ops.mgf.set_up_axis(axis="NEG_Y")
    assert (root.matrix_basis.to_3x3() @ Vector((0, -1, 0)) - Vector((0, 0, 1))).length < 1e-5
    bpy.ops.mgf.set_up_axis(axis="CAMERAS")
    np.testing.assert_allclose(np.array(root.matrix_basis)[:3, :3], upright, atol=1e-4)


def crop_matrix(text: str) -> np.ndarray:
    return np.array([float(v) for v in text.split()]).reshape(4, 4)


def test_crop_box_stands_around_the_points_in_scene_coordinates(imported, house):
    assert crop_text(imported) == ""
    bpy.ops.mgf.add_crop_box()
    bpy.context.view_layer.update()
    box = find_crop_box(imported)
    assert box.parent == imported.root and bpy.context.view_layer.objects.active == box
    to_cube = np.linalg.inv(crop_matrix(crop_text(imported)))
    local = house.xyz @ to_cube[:3, :3].T + to_cube[:3, 3]
    assert 0.85 < (np.abs(local) <= 1).all(axis=1).mean() <= 1
    # Level with the world: its matrix there is diagonal.
    world = np.array(box.matrix_world)[:3, :3]
    np.testing.assert_allclose(world, np.diag(np.diag(world)), atol=1e-5)
    # What is done to it in the viewport arrives, whatever scale and place the whole scene was given.
    before = crop_matrix(crop_text(imported))
    imported.root.matrix_basis = Matrix.Translation((5, 6, 7)) @ Matrix.Scale(3, 4) @ imported.root.matrix_basis
    bpy.context.view_layer.update()
    np.testing.assert_allclose(crop_matrix(crop_text(imported)), before, atol=1e-4)
    box.scale.x *= 0.5
    bpy.context.view_layer.update()
    half = crop_matrix(crop_text(imported))
    assert np.linalg.norm(half[:3, 0]) == pytest.approx(np.linalg.norm(before[:3, 0]) / 2, rel=1e-4)
    bpy.ops.mgf.add_crop_box()  # fits it anew instead of making another
    assert sum(o.get("mgf_role") == "crop" for o in bpy.data.objects) == 1
    bpy.ops.mgf.reload_scene()
    assert find_crop_box(ImportedScene.find(bpy.context.scene)) is not None
    bpy.ops.mgf.remove_crop_box()
    assert crop_text(imported) == ""
    with pytest.raises(RuntimeError, match="There is no crop box"):
        bpy.ops.mgf.select_crop_box()


def test_a_scene_that_was_scaled_to_nothing_gets_no_box(imported):
    imported.root.scale = 0, 0, 0
    for operator in (bpy.ops.mgf.add_crop_box, bpy.ops.mgf.add_section):
        with pytest.raises(RuntimeError, match="is scaled to zero"):
            operator()
    assert find_crop_box(imported) is None and "Section" not in bpy.data.objects


def test_crop_box_of_a_far_scene(addon, tmp_path):
    shift = (389_123.25, 5_712_345.75, 120.0)
    house = synthetic.write_house(tmp_path / "utm", shift=shift)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    bpy.ops.mgf.add_crop_box()
    bpy.context.view_layer.update()
    matrix = crop_matrix(crop_text(ImportedScene.find(bpy.context.scene)))
    assert np.linalg.norm(matrix[:3, 3] - house.xyz.mean(axis=0)) < 1.0


def test_import_frames_the_viewports(imported):
    spaces = [a.spaces.active for a in bpy.context.screen.areas if a.type == "VIEW_3D"]
    if not spaces:
        pytest.skip("this file has no viewport")
    for space in spaces:
        assert space.region_3d.view_distance == pytest.approx(2.6 * imported.radius, rel=1e-4)
        assert not space.overlay.show_relationship_lines and space.shading.color_type == "VERTEX"


def test_a_facade_is_seen_from_where_it_was_photographed():
    fan = np.array([[x, -9.0, 1.0] for x in (-5.0, -2.0, 0.0, 2.0, 5.0)])
    side = side_of_cameras(np.array([0.0, 1.0, 2.0]), fan)
    assert side[1] < -0.9 and 0.2 < side[2] < 0.5 and abs(side[0]) < 1e-6 and np.linalg.norm(side) == pytest.approx(1)
    ring = np.array([[np.cos(t), np.sin(t), 0.3] for t in np.linspace(0, 2 * np.pi, 12, endpoint=False)])
    assert side_of_cameras(np.zeros(3), ring) is None and side_of_cameras(np.zeros(3), np.zeros((0, 3))) is None


def test_the_viewports_look_from_the_cameras_side(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    imported = ImportedScene.find(bpy.context.scene)
    for camera in imported.objects("Cameras"):  # all of them on one side
        camera.matrix_basis.translation = imported.root.matrix_basis.inverted() @ Vector((0.0, -9.0, 1.0))
    frame_imported(bpy.context, imported)
    space = next(a.spaces.active for a in bpy.context.screen.areas if a.type == "VIEW_3D")
    seen_from = space.region_3d.view_rotation @ Vector((0, 0, 1))
    assert seen_from.y < -0.8 and seen_from.z > 0.2
    up = space.region_3d.view_rotation @ Vector((0, 1, 0))
    assert up.z > 0.8


def test_the_viewports_look_at_the_points_where_they_lie(imported):
    (cloud,) = imported.objects("Points")
    space = next(a.spaces.active for a in bpy.context.screen.areas if a.type == "VIEW_3D")
    before = space.region_3d.view_location.copy()
    cloud.matrix_basis = Matrix.Translation((3.0, 0.0, 0.0))
    frame_imported(bpy.context, imported)
    moved = imported.root.matrix_basis.to_3x3() @ Vector((3.0, 0.0, 0.0))
    assert (space.region_3d.view_location - before - moved).length < 1e-3


@pytest.mark.parametrize(("light", "with_points"), [("STUDIO", "FLAT"), ("MATCAP", "MATCAP")])
def test_points_show_the_photos_colours_and_the_mesh_its_shape(imported, house, light, with_points):
    (shading,) = [a.spaces.active.shading for a in bpy.context.screen.areas if a.type == "VIEW_3D"]
    shading.light = light
    frame_imported(bpy.context, imported)
    assert shading.light == with_points
    bpy.ops.ed.undo_push(message="points")
    bpy.ops.mgf.import_result(directory=str(house.job))
    assert shading.light == light
    bpy.ops.ed.undo_push(message="mesh")
    for step, expected in ((bpy.ops.ed.undo, with_points), (bpy.ops.ed.redo, light)):  # dark specks came back
        step()
        (shading,) = [a.spaces.active.shading for a in bpy.context.screen.areas if a.type == "VIEW_3D"]
        assert shading.light == expected
    shading.light = "FLAT"  # the user's choice for the mesh
    bpy.ops.mgf.paint_mesh(kind="COLOR")
    bpy.ops.ed.undo_push(message="paint")
    bpy.ops.ed.undo()
    assert shading.light == "FLAT"


def test_scaling_keeps_the_picture(imported):
    space = next(a.spaces.active for a in bpy.context.screen.areas if a.type == "VIEW_3D")
    before, place = space.region_3d.view_distance, space.region_3d.view_location.copy()
    test_scale_by_two_points(imported)
    assert space.region_3d.view_distance == pytest.approx(3 * before, rel=1e-4)
    assert (space.region_3d.view_location - 3 * place).length < 1e-4


def test_deleted_scene_leaves_no_empty_collections(imported, house):
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    assert len(bpy.data.collections) == 5 and len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12


def test_drop_handler_knows_the_files():
    from mgf_blender.scene_import.operators import MGF_FH_colmap

    assert MGF_FH_colmap.bl_file_extensions == ".bin;.txt"
    assert MGF_FH_colmap.bl_import_operator == "mgf.import_colmap"


def test_the_sentence_in_the_dialog_of_set_scale_has_room():
    texts = [placement.LENGTHS, *(d["*", placement.LENGTHS] for d in translations.dictionary().values())]
    blf.size(0, 11.0)  # Blender's own size of text at interface scale 1
    longest = max(blf.dimensions(0, text)[0] for text in texts)
    assert 250 < longest < placement.DIALOG_WIDTH - 60  # icon and margins
