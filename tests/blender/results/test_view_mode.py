# SPDX-License-Identifier: GPL-3.0-or-later
"""What a camera shows, the error map, and the field as points."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
import synthetic
from layouts import draw

from mgf_blender.common.ply import read_ply
from mgf_blender.common.views import follow_paint
from mgf_blender.results import view_mode
from mgf_blender.results.panel import MGF_PT_results
from mgf_blender.scene_import.imported_scene import ImportedScene


@pytest.fixture
def imported(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.job)
    bpy.ops.mgf.import_result()
    imported = ImportedScene.find(bpy.context.scene)
    bpy.context.scene.camera = imported.objects("Renders")[0].parent
    return imported


def shown() -> list[str]:
    slots = bpy.context.scene.camera.data.background_images
    return [s.image["mgf_image"] for s in slots if s.show_background_image]


def test_switch_shows_one_at_a_time(imported):
    region = next(a.spaces.active for a in bpy.context.window.screen.areas if a.type == "VIEW_3D").region_3d
    for kind in ("RENDER", "PHOTO", "ERROR"):
        region.view_perspective = "PERSP"
        bpy.ops.mgf.show_in_camera(kind=kind)
        assert shown() == [kind.lower()] and depths() == {"FRONT"}
        assert imported.objects("Mesh")[0].hide_get() and region.view_perspective == "CAMERA"
    region.view_perspective = "PERSP"
    bpy.ops.mgf.show_in_camera(kind="MESH")
    assert shown() == ["photo"] and depths() == {"BACK"} and not imported.objects("Mesh")[0].hide_get()
    assert region.view_perspective == "PERSP"


def depths() -> set[str]:
    return {s.display_depth for s in bpy.context.scene.camera.data.background_images if s.show_background_image}


def standing(imported) -> set[str]:
    """Names of the cameras in whose frustum a render can be seen."""
    return {o.parent.name for o in imported.objects("Renders") if not o.hide_get()}


def test_the_render_in_the_frustum_does_not_cover_what_its_own_camera_shows(imported):
    first, second = imported.objects("Renders")[0].parent, imported.objects("Renders")[1].parent
    for kind in ("MESH", "PHOTO", "ERROR"):
        bpy.ops.mgf.show_in_camera(kind=kind)
        assert first.name not in standing(imported) and second.name in standing(imported)
    bpy.context.scene.camera = second
    bpy.context.view_layer.update()  # as after choosing a camera by hand
    assert second.name not in standing(imported) and first.name in standing(imported)
    bpy.ops.mgf.import_result()
    assert second.name not in standing(imported) and len(standing(imported)) == 3


def test_next_cameras_go_on_with_what_was_chosen(imported):
    bpy.ops.mgf.show_in_camera(kind="ERROR")
    seen = []
    for _ in range(12):
        bpy.ops.mgf.look_through(step=1)
        seen.append(shown()[0])
        assert imported.objects("Mesh")[0].hide_get()
    assert seen.count("error") == 4 and seen.count("photo") == 8


def test_a_view_that_left_the_camera_says_where_the_mesh_is(imported):
    def said(perspective: str) -> str:
        space = SimpleNamespace(region_3d=SimpleNamespace(view_perspective=perspective))
        context = SimpleNamespace(scene=bpy.context.scene, space_data=space, region_data=None)  # as in a sidebar
        return " ".join(draw(MGF_PT_results, context).said.split())

    bpy.ops.mgf.show_in_camera(kind="PHOTO")
    assert "mesh is hidden; press Mesh" in said("PERSP") and "hidden" not in said("CAMERA")
    bpy.ops.mgf.show_in_camera(kind="MESH")
    assert "hidden" not in said("PERSP")


def test_objects_outside_the_view_layer_do_not_stop_the_switch(imported):
    layer = bpy.context.view_layer.layer_collection.children[imported.collection.name]
    layer.children[imported.child("Mesh").name].exclude = True
    bpy.ops.mgf.show_in_camera(kind="RENDER")
    assert shown() == ["render"]


def test_a_camera_without_render_says_so(imported):
    bare = next(o for o in imported.objects("Cameras") if len(o.data.background_images) == 1)
    bpy.context.scene.camera = bare
    for kind in ("RENDER", "ERROR"):
        with pytest.raises(RuntimeError, match="has no render"):
            bpy.ops.mgf.show_in_camera(kind=kind)
    assert "the option Render All makes one" in draw(MGF_PT_results).said.replace("\n", " ")
    for render in imported.objects("Renders"):  # as after the preset Quick, which Render All does not help
        bpy.data.objects.remove(render)
    said = draw(MGF_PT_results).said.replace("\n", " ")
    assert "Render All" not in said and "Without training, as with the preset Quick, there are no renders" in said


def test_error_map_measures_the_difference(imported):
    camera = bpy.context.scene.camera
    image = view_mode.make_error_map(camera)
    width, height = image.size
    pixels = np.array(image.pixels[:]).reshape(height, width, 4)
    # The render is the photo upside down: equal in the middle row, far apart at top and bottom.
    assert pixels[height // 2, :, :3].mean() < 0.1 < 0.5 < pixels[2, :, :3].mean()
    assert image.packed_file is not None
    again = view_mode.make_error_map(camera)
    assert again == image and sum(s.image == image for s in camera.data.background_images) == 1


def brightness(image: bpy.types.Image) -> float:
    return float(np.array(image.pixels[:]).reshape(-1, 4)[:, :3].mean())


def test_error_map_is_made_again_when_the_render_changed(imported, house):
    """After another run the renders have the same names; what the run before differed by is no measure of this one."""
    camera = bpy.context.scene.camera
    bpy.ops.mgf.show_in_camera(kind="ERROR")
    old = brightness(bpy.data.images["Error IMG 00"])
    made = bpy.data.images["Error IMG 00"]["mgf_made_of"]
    bpy.ops.mgf.show_in_camera(kind="PHOTO")
    bpy.ops.mgf.show_in_camera(kind="ERROR")
    assert bpy.data.images["Error IMG 00"]["mgf_made_of"] == made
    slots = {s.image["mgf_image"]: s.image for s in camera.data.background_images}
    render = Path(bpy.path.abspath(slots["render"].filepath))
    width, height = slots["render"].size
    synthetic.write_png(render, synthetic._gradient(width, height))  # as the photo is
    for again in (False, True):  # with and without an import in between
        if again:
            bpy.ops.mgf.import_result()
        bpy.ops.mgf.show_in_camera(kind="ERROR")
        assert brightness(bpy.data.images["Error IMG 00"]) < 0.2 * old and shown() == ["error"]
    render.unlink()
    bpy.ops.mgf.show_in_camera(kind="ERROR")  # the picture is in the file
    assert shown() == ["error"]


def test_a_new_result_leaves_no_picture_of_the_old_one(imported, house):
    content = json.loads((house.job / "deliver.json").read_text())
    for view in content["views"]:
        view["render"] = None
    (house.job / "deliver.json").write_text(json.dumps(content))
    bpy.ops.mgf.show_in_camera(kind="ERROR")
    bpy.ops.mgf.import_result()
    assert view_mode.available(bpy.context.scene.camera) == {"MESH", "PHOTO"} and shown() == ["photo"]
    assert not imported.objects("Mesh")[0].hide_get() and "mgf_shown" not in bpy.context.scene.camera


def test_box_filter_keeps_the_mean():
    pixels = np.random.default_rng(1).random((40, 60, 3)).astype(np.float32)
    small = view_mode._resized(pixels, 30, 20)
    assert small.shape == (20, 30, 3)
    np.testing.assert_allclose(small[0, 0], pixels[:2, :2].mean(axis=(0, 1)), atol=1e-6)
    np.testing.assert_allclose(small.mean(), pixels.mean(), atol=1e-6)


def test_field_comes_as_colored_points(imported, house):
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    rows = np.random.default_rng(2).normal(size=(50, len(names))).astype("<f4")
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 50\n" + "".join(f"property float {n}\n" for n in names)
    (house.job / "field.ply").write_bytes(head.encode() + b"end_header\n" + rows.tobytes())
    content = json.loads((house.job / "deliver.json").read_text())
    (house.job / "deliver.json").write_text(json.dumps({**content, "field": "field.ply"}))
    for _ in range(2):
        bpy.ops.mgf.import_field()
    found = [o for o in imported.objects("Points") if o.get("mgf_field")]
    assert len(found) == 1 and len(imported.objects("Points")) == 2
    opacity = np.empty(50, np.float32)
    found[0].data.attributes["opacity"].data.foreach_get("value", opacity)
    np.testing.assert_allclose(opacity, 1 / (1 + np.exp(-rows[:, 6])), atol=1e-5)
    (house.job / "field.ply").write_bytes((house.job / "mesh.ply").read_bytes())
    with pytest.raises(RuntimeError, match="not a Gaussian field"):
        bpy.ops.mgf.import_field()


def test_the_field_is_shown_in_its_colours_in_place_of_the_mesh(imported, house):
    """It lay in the mesh as grey specks."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 5\n" + "".join(f"property float {n}\n" for n in names)
    (house.job / "field.ply").write_bytes(head.encode() + b"end_header\n" + np.zeros((5, 10), "<f4").tobytes())
    content = json.loads((house.job / "deliver.json").read_text())
    (house.job / "deliver.json").write_text(json.dumps({**content, "field": "field.ply"}))

    def shown() -> tuple[bool, bool, str, str]:
        (shading,) = [a.spaces.active.shading for a in bpy.context.screen.areas if a.type == "VIEW_3D"]
        again = ImportedScene.find(bpy.context.scene)
        (mesh,), fields = again.objects("Mesh"), [o for o in again.objects("Points") if o.get("mgf_field")]
        return not mesh.hide_get(), any(not o.hide_get() for o in fields), shading.color_type, shading.light

    follow_paint(bpy.context.scene, texture=True, lit=True)
    bpy.ops.ed.undo_push(message="mesh")
    as_mesh, as_field = (True, False, "VERTEX", "STUDIO"), (False, True, "VERTEX", "FLAT")
    bpy.ops.mgf.import_field()
    assert shown() == as_field and not bpy.context.view_layer.objects.selected
    bpy.ops.ed.undo_push(message="field")
    bpy.ops.ed.undo()
    assert shown() == as_mesh
    bpy.ops.ed.redo()
    assert shown() == as_field
    for back in (
        lambda: bpy.ops.mgf.paint_mesh(kind="COLOR"),
        lambda: bpy.ops.mgf.show_in_camera(kind="MESH"),
        lambda: bpy.ops.mgf.import_result(directory=str(house.job)),
    ):
        bpy.ops.mgf.import_field()
        assert shown() == as_field
        back()
        assert shown() == as_mesh


def test_a_field_in_map_coordinates_keeps_its_precision(addon, tmp_path):
    house = synthetic.write_house(tmp_path / "utm", shift=(389_123.25, 5_712_345.75, 120.0), tilt=False)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.job)
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    rows = np.random.default_rng(2).normal(size=(50, len(names))).astype("<f4")
    head = "ply\nformat binary_little_endian 1.0\ncomment offset 389123.0 5712346.0 120.0\nelement vertex 50\n"
    head += "".join(f"property float {n}\n" for n in names) + "end_header\n"
    (house.job / "field.ply").write_bytes(head.encode() + rows.tobytes())
    content = json.loads((house.job / "deliver.json").read_text())
    (house.job / "deliver.json").write_text(json.dumps({**content, "field": "field.ply"}))
    bpy.ops.mgf.import_field()
    imported = ImportedScene.find(bpy.context.scene)
    (found,) = [o for o in imported.objects("Points") if o.get("mgf_field")]
    points = np.empty(150, np.float32)
    found.data.vertices.foreach_get("co", points)
    expected = rows[:, :3] + np.array([389_123.0, 5_712_346, 120]) - imported.offset
    np.testing.assert_allclose(points.reshape(-1, 3), expected, atol=1e-5)
    bpy.ops.mgf.export_field(filepath=str(tmp_path / "saved.ply"))
    saved = read_ply(tmp_path / "saved.ply")
    np.testing.assert_allclose(saved.positions - imported.offset, expected, atol=1e-6)


def test_undistorted_view_replaces_the_distorted_camera(addon, tmp_path, monkeypatch):
    monkeypatch.setitem(synthetic.CAMERAS, 4, ("SIMPLE_RADIAL", 800, 600, (700.0, 410.0, 290.0, 0.1)))
    house = synthetic.write_house(tmp_path / "house")
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    imported = ImportedScene.find(bpy.context.scene)
    assert sum(bool(o["mgf_distorted"]) for o in imported.objects("Cameras")) == 2
    bpy.ops.mgf.import_result(directory=str(house.job))
    assert len(imported.objects("Cameras")) == 12 and not any(o["mgf_distorted"] for o in imported.objects("Cameras"))
    assert Path(addon.job_folder) == house.job
