# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh with a texture shows it wherever Blender draws, and the vertex colours when they are chosen."""

from __future__ import annotations

import json
import time

import bpy
import numpy as np
import pytest
import synthetic
from layouts import draw

from mgf_blender.common.errors import UserError
from mgf_blender.common.textures import show_texture, texture_of
from mgf_blender.jobs import import_status
from mgf_blender.results import async_import
from mgf_blender.results.load import import_result
from mgf_blender.results.panel import MGF_PT_results
from mgf_blender.results.picture import render_picture
from mgf_blender.results.surface import available, shown
from mgf_blender.results.texture import read_uv
from mgf_blender.scene_import.imported_scene import ImportedScene, hide

FACES = len(synthetic.house_mesh()[1])
GREEN, BLUE = (20, 200, 40), (20, 40, 220)


def edit(job, **changes):
    content = json.loads((job / "deliver.json").read_text())
    (job / "deliver.json").write_text(json.dumps({**content, **changes}))


def write_picture(path, top=GREEN, bottom=BLUE, side=16):
    """A JPEG of two colours, one above the other."""
    pixels = np.ones((side, side, 4), np.float32)
    pixels[: side // 2, :, :3], pixels[side // 2 :, :, :3] = np.array(bottom) / 255, np.array(top) / 255
    image = bpy.data.images.new("made", side, side)
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(path), "JPEG"
    image.save()
    bpy.data.images.remove(image)


def height_uv() -> np.ndarray:
    """Coordinates that put the picture upright on every face: v is the height in the house."""
    xyz, faces, _ = synthetic.house_mesh()
    corners = xyz[faces]
    return np.stack([(corners[..., 0] + 3) / 6, corners[..., 2] / 4.2], axis=-1).astype(np.float32)


def write_texture(job, uv=None):
    write_picture(job / "texture.jpg")
    np.savez(job / "mesh_texture.npz", uv=height_uv() if uv is None else uv)
    edit(job, texture="texture.jpg", texture_uv="mesh_texture.npz")


def write_parts(job):
    face = np.zeros(FACES, np.uint8)
    face[3:7], face[9] = 1, 2
    np.savez(job / "mesh_parts.npz", names=np.array(["building", "roof", "door"]), face=face)
    edit(job, parts="mesh_parts.npz")


@pytest.fixture
def textured(scene, house):
    xyz, faces, rgb = synthetic.house_mesh()
    values = np.linspace(0, 1, len(xyz))
    synthetic.write_mesh(house.job / "mesh.ply", xyz, faces, rgb, confidence=values, views=10 * values)
    write_texture(house.job)
    return house


@pytest.fixture
def panel(addon, textured):
    addon.job_folder = str(textured.job)
    bpy.ops.mgf.import_result()
    return ImportedScene.find(bpy.context.scene).objects("Mesh")[0].data


def uv_of(mesh) -> np.ndarray:
    flat = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers["UVMap"].uv.foreach_get("vector", flat)
    return flat.reshape(-1, 3, 2)


def sources(mesh) -> list[str]:
    """What the base colour of each material hangs on."""
    shaders = [next(n for n in m.node_tree.nodes if n.type == "BSDF_PRINCIPLED") for m in mesh.materials]
    return [s.inputs["Base Color"].links[0].from_node.bl_idname for s in shaders]


def drawn_in() -> set[str]:
    """What the viewports of the window draw in solid mode."""
    areas = [a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"]
    return {a.spaces.active.shading.color_type for a in areas}


def textures() -> list[str]:
    return sorted(i.name for i in bpy.data.images if i.get("mgf_image") == "texture")


def test_texture_comes_with_the_mesh(scene, textured):
    mesh = import_result(scene, textured.job).mesh.data
    np.testing.assert_array_equal(uv_of(mesh), height_uv())
    assert mesh.uv_layers.active.name == "UVMap" and mesh.uv_layers["UVMap"].active_render
    (material,) = mesh.materials
    image = texture_of(material)
    assert bpy.path.abspath(image.filepath) == str(textured.job / "texture.jpg")
    assert image.colorspace_settings.name == "sRGB" and tuple(image.size) == (16, 16)
    assert material.node_tree.nodes.active.image == image  # the one that the solid mode draws
    assert sources(mesh) == ["ShaderNodeTexImage"] and shown(mesh) == "TEXTURE"
    assert available(mesh) == ["TEXTURE", "COLOR", "CONFIDENCE", "VIEWS"]
    assert drawn_in() == {"TEXTURE"}


def test_faces_left_out_take_their_coordinates_with_them(scene, textured):
    xyz, faces, rgb = synthetic.house_mesh()
    faces[[2, 9]] = [(1, 1, 2), (5, 6, 5)]
    synthetic.write_mesh(textured.job / "mesh.ply", xyz, faces, rgb)
    mesh = import_result(scene, textured.job).mesh.data
    np.testing.assert_array_equal(uv_of(mesh), np.delete(height_uv(), [2, 9], axis=0))


def test_without_texture_nothing_is_different(scene, house):
    before = drawn_in()
    mesh = import_result(scene, house.job).mesh.data
    assert [m.name for m in mesh.materials] == ["MGF Vertex Colors"] and not mesh.uv_layers
    assert available(mesh) == ["COLOR"] and shown(mesh) == "COLOR" and not textures() and drawn_in() == before


def test_an_own_uv_map_is_no_texture(scene, house):
    mesh = import_result(scene, house.job).mesh.data
    mesh.uv_layers.new(name="UVMap")
    assert available(mesh) == ["COLOR"]


def test_colors_of_a_value_are_not_made_in_edit_mode(panel):
    """There the mesh has no values to make them of; what it shows stays, and colors made before are chosen."""
    bpy.context.view_layer.objects.active = next(o for o in bpy.data.objects if o.data == panel)
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave Edit Mode first"):
        bpy.ops.mgf.paint_mesh(kind="CONFIDENCE")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert shown(panel) == "TEXTURE"
    bpy.ops.mgf.paint_mesh(kind="CONFIDENCE")
    bpy.ops.mgf.paint_mesh(kind="TEXTURE")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mgf.paint_mesh(kind="CONFIDENCE")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert shown(panel) == "CONFIDENCE"


def test_kinds_to_and_fro(panel):
    assert draw(MGF_PT_results).said.count("Texture") == 1
    for kind, source, drawn in (
        ("COLOR", "ShaderNodeVertexColor", "VERTEX"),
        ("TEXTURE", "ShaderNodeTexImage", "TEXTURE"),
        ("CONFIDENCE", "ShaderNodeVertexColor", "VERTEX"),
        ("VIEWS", "ShaderNodeVertexColor", "VERTEX"),
        ("TEXTURE", "ShaderNodeTexImage", "TEXTURE"),
    ):
        bpy.ops.mgf.paint_mesh(kind=kind)
        assert (shown(panel), set(sources(panel)), drawn_in()) == (kind, {source}, {drawn})
        assert ("Violet" in draw(MGF_PT_results).said) == (kind in {"CONFIDENCE", "VIEWS"})
        hide(ImportedScene.find(bpy.context.scene).objects("Mesh")[0])  # then its colors are not those in the viewport
        assert "Violet" not in draw(MGF_PT_results).said
    assert panel.color_attributes.active_color.name == "Views Colors"


def test_undo_keeps_panel_and_viewport_in_agreement(panel):
    bpy.ops.ed.undo_push(message="textured")
    bpy.ops.mgf.paint_mesh("EXEC_DEFAULT", True, kind="COLOR")
    assert drawn_in() == {"VERTEX"}
    for turn, kind, drawn in ((bpy.ops.ed.undo, "TEXTURE", "TEXTURE"), (bpy.ops.ed.redo, "COLOR", "VERTEX")):
        turn()
        (obj,) = ImportedScene.find(bpy.context.scene).objects("Mesh")
        assert shown(obj.data) == kind and drawn_in() == {drawn}


def test_a_viewport_in_another_color_is_left_alone(panel):
    spaces = [a.spaces.active for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"]
    spaces[0].shading.color_type = "RANDOM"
    bpy.ops.mgf.paint_mesh(kind="COLOR")
    assert drawn_in() == {"RANDOM"}


def test_viewports_turned_to_the_scene_go_on_with_the_texture(panel, textured):
    for kind, drawn in (("COLOR", "VERTEX"), ("TEXTURE", "TEXTURE")):
        bpy.ops.mgf.paint_mesh(kind=kind)
        bpy.ops.mgf.import_colmap(filepath=str(textured.folder))
        assert shown(panel) == kind and drawn_in() == {drawn}


def test_texture_asked_of_a_mesh_without_is_a_sentence(addon, house):
    addon.job_folder = str(house.job)
    bpy.ops.mgf.import_result()
    with pytest.raises(RuntimeError, match="has no texture; enable"):
        bpy.ops.mgf.paint_mesh(kind="TEXTURE")


def test_import_again_reads_the_new_picture(scene, textured):
    result = import_result(scene, textured.job)
    material = result.mesh.data.materials[0]
    material.name = "Mine"
    show_texture(material, False)
    write_picture(textured.job / "texture.jpg", top=(200, 200, 0), side=32)
    mesh = import_result(scene, textured.job, result.imported).mesh.data
    image = texture_of(mesh.materials[0])
    assert tuple(image.size) == (32, 32) and np.array(image.pixels[-4:-1])[2] < 0.1
    assert mesh.materials[0].name == "Mine" and shown(mesh) == "TEXTURE"  # what the user changed stays
    assert len(textures()) == 1 and len([m for m in bpy.data.materials if "mgf_texture" in m]) == 1


def test_another_job_in_its_place_leaves_no_orphans(scene, textured, tmp_path):
    imported = import_result(scene, textured.job).imported
    other = synthetic.write_house(tmp_path / "other")
    write_texture(other.job)
    write_parts(other.job)
    mesh = import_result(scene, other.job, imported).mesh.data
    assert len(textures()) == 1 and len(mesh.materials) == 3
    path = bpy.path.abspath(texture_of(mesh.materials[0]).filepath)
    assert path == str(other.job / "texture.jpg")
    edit(other.job, texture=None, texture_uv=None)
    import_result(scene, other.job, imported)
    assert not textures() and not [m for m in bpy.data.materials if "mgf_texture" in m]
    assert drawn_in() == {"VERTEX"}


def test_two_scenes_of_one_job_choose_for_themselves(scene, textured):
    first = import_result(scene, textured.job).mesh.data
    second = import_result(bpy.data.scenes.new("Second"), textured.job).mesh.data
    show_texture(second.materials[0], False)
    assert (shown(first), shown(second)) == ("TEXTURE", "COLOR") and len(textures()) == 1


def test_every_part_shows_the_texture(scene, textured):
    write_parts(textured.job)
    mesh = import_result(scene, textured.job).mesh.data
    names = ["MGF Building (texture)", "MGF Roof (texture)", "MGF Door (texture)"]
    assert [m.name for m in mesh.materials] == names and set(sources(mesh)) == {"ShaderNodeTexImage"}
    index = np.empty(FACES, np.int32)
    mesh.polygons.foreach_get("material_index", index)
    assert np.bincount(index).tolist() == [FACES - 5, 4, 1]


def test_a_material_the_user_made_his_own_is_left_alone(panel):
    material = bpy.data.materials.new("Glass")
    panel.materials.append(material)
    panel.materials.append(None)
    bpy.ops.mgf.paint_mesh(kind="COLOR")
    bpy.ops.mgf.paint_mesh(kind="TEXTURE")
    assert shown(panel) == "TEXTURE" and texture_of(material) is None


def test_arrives_in_short_steps_like_an_import_in_one_go(addon, textured):
    async_import.begin(bpy.context.scene, textured.job)
    end = time.monotonic() + 20
    while async_import.pump() and time.monotonic() < end:
        time.sleep(0.002)
    assert not import_status.problem(bpy.context.scene)
    (obj,) = ImportedScene.find(bpy.context.scene).objects("Mesh")
    np.testing.assert_array_equal(uv_of(obj.data), height_uv())
    assert shown(obj.data) == "TEXTURE" and drawn_in() == {"TEXTURE"}


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda job: (job / "mesh_texture.npz").write_bytes(b"PK"), "Cannot read .*mesh_texture"),
        (lambda job: np.savez(job / "mesh_texture.npz", other=height_uv()), "Cannot read .*mesh_texture"),
        (lambda job: np.savez(job / "mesh_texture.npz", uv=height_uv() * np.nan), "no texture coordinates"),
        (lambda job: np.savez(job / "mesh_texture.npz", uv=np.array(["a"])), "no texture coordinates"),
        (lambda job: np.savez(job / "mesh_texture.npz", uv=height_uv()[1:]), "belongs to another mesh"),
        (lambda job: np.savez(job / "mesh_texture.npz", uv=height_uv()[..., :1]), "belongs to another mesh"),
        (lambda job: (job / "mesh_texture.npz").unlink(), "lacks its file 'mesh_texture.npz'"),
        (lambda job: (job / "texture.jpg").unlink(), "lacks its file 'texture.jpg'"),
        (lambda job: (job / "texture.jpg").write_bytes((job / "texture.jpg").read_bytes()[:-9]), "Cannot read .*jpg"),
        (lambda job: (job / "texture.jpg").write_bytes(b"\x89PNG"), "Cannot read .*jpg"),
        (lambda job: edit(job, texture_uv=None), "lacks its file 'texture_uv'"),
        (lambda job: edit(job, texture="../../secret.jpg"), "outside the job folder"),
    ],
)
def test_damaged_or_missing_files_change_nothing(scene, textured, damage, words):
    damage(textured.job)
    with pytest.raises(UserError, match=words) as caught:
        import_result(scene, textured.job)
    assert str(caught.value).endswith("run the job again.")
    assert not bpy.data.objects and not bpy.data.materials and not textures()


def test_doubles_are_read_and_whole_numbers_refused(tmp_path):
    np.savez(tmp_path / "a.npz", uv=height_uv().astype(np.float64))
    assert read_uv(tmp_path / "a.npz", FACES).dtype == np.float32
    np.savez(tmp_path / "b.npz", uv=np.zeros((FACES, 3, 2), np.int32))
    with pytest.raises(UserError, match="no texture coordinates"):
        read_uv(tmp_path / "b.npz", FACES)


@pytest.mark.parametrize("parts", [False, True])
def test_the_rendered_picture_shows_it_upright(scene, house, tmp_path, parts):
    """Green above, blue below, as in the picture; the vertex colours are red."""
    write_texture(house.job)
    if parts:
        write_parts(house.job)
    imported = import_result(scene, house.job).imported
    kinds = ("objects", "meshes", "materials", "scenes")
    before = [sorted(b.name for b in getattr(bpy.data, k)) for k in kinds]
    render_picture(scene, imported, tmp_path / "p.png", (80, 50), samples=1)
    assert before == [sorted(b.name for b in getattr(bpy.data, k)) for k in kinds] and len(textures()) == 1
    image = bpy.data.images.load(str(tmp_path / "p.png"))
    pixels = np.array(image.pixels[:]).reshape(50, 80, 4)[:, 30:50, :3]
    green = (pixels[..., 1] > pixels[..., 2] + 0.1) & (pixels[..., 1] > pixels[..., 0] + 0.1)
    blue = (pixels[..., 2] > pixels[..., 1] + 0.1) & (pixels[..., 2] > pixels[..., 0] + 0.2)
    assert min(green.sum(), blue.sum()) > 50
    assert np.nonzero(green)[0].mean() > np.nonzero(blue)[0].mean() + 5  # first row at the bottom
