# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of a job arrive in the scene, in place and complete."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
import synthetic

from mgf_blender.common.errors import UserError
from mgf_blender.common.ply import read_ply
from mgf_blender.results.load import import_result
from mgf_blender.results.picture import render_picture
from mgf_blender.scene_import.imported_scene import KIND_KEY, ROLE_KEY, ImportedScene
from mgf_blender.scene_import.load import import_scene


def vertices(obj: bpy.types.Object) -> np.ndarray:
    flat = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def test_mesh_lies_in_the_scene(scene, house):
    imported = import_scene(scene, house.folder).imported
    result = import_result(scene, house.job, imported)
    truth, faces, rgb = synthetic.house_mesh()
    np.testing.assert_allclose(vertices(result.mesh), truth @ synthetic._turn(0.7, -0.4).T, atol=1e-5)
    assert len(result.mesh.data.polygons) == len(faces)
    color = np.empty(4 * len(truth), np.float32)
    result.mesh.data.attributes["Color"].data.foreach_get("color_srgb", color)
    assert np.abs(color.reshape(-1, 4)[:, :3] * 255 - rgb).max() < 0.51
    assert result.mesh.parent == imported.root and result.mesh.name in imported.child("Mesh").objects
    assert result.mesh.data.materials[0].name == "MGF Vertex Colors"


def test_cameras_do_not_stand_before_the_mesh(scene, house):
    imported = import_scene(scene, house.folder).imported
    alone = {c.name: c.data.display_size for c in imported.objects("Cameras")}
    for _ in range(2):  # once, not again with each result
        import_result(scene, house.job, imported)
        for camera in imported.objects("Cameras"):
            assert camera.data.display_size == pytest.approx(alone[camera.name] / 3)


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 1), (8, 3)])
def test_a_job_of_portrait_photos_alone_stands_upright(addon, scene, house, orientation, turns):
    """Cameras that were held turned: the manifest says so, and the photos themselves may be gone."""
    turn = np.linalg.matrix_power(np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), turns)
    content = json.loads((house.job / "deliver.json").read_text())
    for view in content["views"]:
        to_world = np.array(view["camera_to_world"])
        to_world[:3, :3] = to_world[:3, :3] @ turn.T
        view.update(camera_to_world=to_world.tolist(), held=orientation)
    _edit(house.job, views=content["views"])
    root = import_result(scene, house.job).imported.root
    for _ in range(2):
        bpy.context.view_layer.update()
        assert (np.array(root.matrix_world)[:3, :3] @ synthetic._turn(0.7, -0.4) @ (0, 0, 1))[2] > 0.999
        bpy.ops.mgf.set_up_axis(axis="X")
        bpy.ops.mgf.set_up_axis(axis="CAMERAS")


def test_values_per_vertex_become_attributes(scene, house):
    xyz, faces, rgb = synthetic.house_mesh()
    confidence = np.linspace(0, 1, len(xyz))
    synthetic.write_mesh(house.job / "mesh.ply", xyz, faces, rgb, confidence=confidence)
    mesh = import_result(scene, house.job).mesh.data
    values = np.empty(len(xyz), np.float32)
    mesh.attributes["confidence"].data.foreach_get("value", values)
    np.testing.assert_allclose(values, confidence, atol=1e-6)
    assert {a.name for a in mesh.attributes if not a.is_internal} >= {"confidence", "Color", "position"}
    assert "red" not in mesh.attributes and "x" not in mesh.attributes


def test_named_parts_become_material_slots(scene, house):
    _, faces, _ = synthetic.house_mesh()
    face = np.zeros(len(faces), np.uint8)
    face[3:7], face[9] = 2, 3
    np.savez(house.job / "mesh_parts.npz", names=np.array(["building", "gate", "roof", "door"]), face=face)
    _edit(house.job, parts="mesh_parts.npz")
    mesh = import_result(scene, house.job).mesh.data
    assert [m.name for m in mesh.materials] == ["MGF Vertex Colors", "MGF Roof", "MGF Door"]
    index = np.empty(len(faces), np.int32)
    mesh.polygons.foreach_get("material_index", index)
    np.testing.assert_array_equal(index, np.array([0, 9, 1, 2])[face])


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda path: path.write_bytes(b"PK"), "Cannot read"),
        (lambda path: np.savez(path, names=np.array(["a"]), face=np.zeros(3, np.uint8)), "belongs to another mesh"),
        (lambda path: np.savez(path, names=np.array(["a"]), face=np.full(16, 7, np.uint8)), "belongs to another mesh"),
    ],
)
def test_damaged_parts_change_nothing(scene, house, damage, words):
    damage(house.job / "mesh_parts.npz")
    _edit(house.job, parts="mesh_parts.npz")
    with pytest.raises(UserError, match=words):
        import_result(scene, house.job)
    assert not bpy.data.objects


def test_far_mesh_keeps_its_precision(scene, tmp_path):
    house = synthetic.write_house(tmp_path / "utm", shift=(389_123.25, 5_712_345.75, 120.0), tilt=False)
    result = import_result(scene, house.job, import_scene(scene, house.folder).imported)
    truth, _, _ = synthetic.house_mesh()
    sides = np.ptp(vertices(result.mesh), axis=0)
    np.testing.assert_allclose(sides, np.ptp(truth, axis=0), atol=1e-4)


def test_edges_turn_sharp_and_faces_smooth(scene, house):
    mesh = import_result(scene, house.job).mesh.data
    sharp = [e.use_edge_sharp for e in mesh.edges]
    assert all(p.use_smooth for p in mesh.polygons)
    assert 0 < sum(sharp) < len(sharp)  # the diagonals of flat walls stay smooth


def test_import_again_shows_the_new_renders(scene, house):
    result = import_result(scene, house.job)
    image = result.imported.objects("Renders")[0].data
    old = np.array(image.pixels[:3])  # Blender reads the file now
    width, height = image.size
    path = bpy.path.abspath(image.filepath)
    synthetic.write_png(Path(path), np.full((height, width, 3), (10, 200, 30), np.uint8))
    again = import_result(scene, house.job, result.imported).imported.objects("Renders")
    shown = next(o.data for o in again if bpy.path.abspath(o.data.filepath) == path)
    assert np.abs(np.array(shown.pixels[:3]) * 255 - (10, 200, 30)).max() < 2 < np.abs(old * 255 - (10, 200, 30)).max()


def test_renders_fill_their_frustums(scene, house):
    imported = import_scene(scene, house.folder).imported
    result = import_result(scene, house.job, imported)
    assert result.renders == 4
    bpy.context.view_layer.update()
    for obj in imported.objects("Renders"):
        camera = obj.parent
        kinds = [s.image["mgf_image"] for s in camera.data.background_images]
        assert kinds == ["photo", "render"]
        width, height = camera["mgf_size"]
        number, *_ = house.poses[obj["mgf_photo"]]
        model, _, _, params = synthetic.CAMERAS[number]
        fx, fy, cx, cy = (params[0], *params[:3]) if "SIMPLE" in model else params[:4]
        size, (sx, sy, _) = obj.empty_display_size, obj.scale
        half = np.array([width, height]) / max(width, height) * size * (sx, sy) / 2
        for u, v, x, y in ((0, 0, -1, 1), (width, height, 1, -1)):
            corner = np.array(obj.location[:2]) + half * (x, y)
            pixel = (corner[0] / -obj.location.z * fx + cx, -corner[1] / -obj.location.z * fy + cy)
            np.testing.assert_allclose(pixel, (u, v), atol=0.02 * max(width, height) / 100 + 0.5)


def test_job_alone_makes_its_own_cameras(scene, house):
    result = import_result(scene, house.job)
    assert len(result.imported.objects("Cameras")) == 12
    assert result.mesh is not None and scene.camera is not None


def test_a_job_of_other_photos_gets_a_tree_of_its_own(scene, house, tmp_path):
    imported = import_scene(scene, house.folder).imported
    other = synthetic.write_house(tmp_path / "other")
    content = json.loads((other.job / "deliver.json").read_text())
    for view in content["views"]:
        view["name"] = "other/" + view["name"]
    (other.job / "deliver.json").write_text(json.dumps(content))
    result = import_result(scene, other.job, imported)
    assert result.imported.collection != imported.collection
    assert len(imported.objects("Cameras")) == len(result.imported.objects("Cameras")) == 12
    assert not imported.objects("Mesh") and len(result.imported.objects("Mesh")) == 1


def test_import_again_leaves_no_copies(scene, house):
    imported = import_scene(scene, house.folder).imported
    import_result(scene, house.job, imported)
    kinds = ("objects", "meshes", "images", "cameras", "materials", "node_groups", "collections")
    before = [len(getattr(bpy.data, k)) for k in kinds]
    import_result(scene, house.job, imported)
    assert before == [len(getattr(bpy.data, k)) for k in kinds]


def test_picture_leaves_the_file_as_it_was(scene, house, tmp_path):
    imported = import_scene(scene, house.folder).imported
    import_result(scene, house.job, imported)
    kinds = ("objects", "meshes", "cameras", "lights", "worlds", "materials", "scenes")
    before = [sorted(b.name for b in getattr(bpy.data, k)) for k in kinds]
    camera, size = scene.camera, scene.render.resolution_x
    render_picture(scene, imported, tmp_path / "p.png", (80, 50), samples=1)
    assert before == [sorted(b.name for b in getattr(bpy.data, k)) for k in kinds]
    assert scene.camera == camera and scene.render.resolution_x == size
    image = bpy.data.images.load(str(tmp_path / "p.png"))
    pixels = np.array(image.pixels[:]).reshape(50, 80, 4)
    # The walls are red, and the building stands in the middle.
    middle, corner = pixels[15:35, 25:55, :3].mean(axis=(0, 1)), pixels[:5, :10, :3].mean(axis=(0, 1))
    assert middle[0] > middle[2] + 0.1 and abs(corner[0] - corner[2]) < 0.12


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda job: (job / "deliver.json").unlink(), "no finished job"),
        (lambda job: job.rename(job.with_name("elsewhere")), "job folder '.*' does not exist"),
        (lambda job: (job / "deliver.json").write_text("{"), "Cannot read"),
        (lambda job: (job / "deliver.json").write_text('{"views": [{}]}'), "not what this version reads"),
        (lambda job: (job / "mesh.ply").write_bytes((job / "mesh.ply").read_bytes()[:-7]), "damaged or ends too early"),
        (lambda job: (job / "mesh.ply").write_bytes(b"solid"), "not a PLY file"),
        (lambda job: _edit(job, mesh="../../secret.ply"), "outside the job folder"),
    ],
)
def test_damaged_results_change_nothing(scene, house, damage, words):
    imported = import_scene(scene, house.folder).imported
    (house.folder / "secret.ply").write_text("ply")
    damage(house.job)
    before = sorted(o.name for o in bpy.data.objects)
    with pytest.raises(UserError, match=words):
        import_result(scene, house.job, imported)
    assert sorted(o.name for o in bpy.data.objects) == before


def test_each_job_goes_to_the_cameras_of_its_photos(addon, scene, house, tmp_path):
    """A job of other photos that is looked at while one runs: the running one's mesh still comes to its cameras."""
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    mine = scene.camera.parent
    other = synthetic.write_house(tmp_path / "other")
    content = json.loads((other.job / "deliver.json").read_text())
    _edit(other.job, views=[{**view, "name": "other/" + view["name"]} for view in content["views"]])
    for job, root in ((other.job, None), (house.job, mine), (other.job, None), (house.job, mine)):
        bpy.ops.mgf.import_result(directory=str(job))
        imported = ImportedScene.find(scene)
        assert (imported.root == mine) == (root == mine), "the panel shows another scene than the one that was imported"
        assert scene.camera in imported.objects("Cameras"), "Photo, Render and Error would show the other scene"
        assert len(imported.objects("Mesh")) == 1
    assert sum(o.get(ROLE_KEY) == "root" for o in bpy.data.objects) == 2
    assert sum(o.get(KIND_KEY) == "Mesh" for o in bpy.data.objects) == 2


def test_a_camera_of_ones_own_stays_the_active_one(addon, scene, house):
    scene.camera = bpy.data.objects.new("Mine", bpy.data.cameras.new("Mine"))
    scene.collection.objects.link(scene.camera)
    bpy.ops.mgf.import_result(directory=str(house.job))
    assert scene.camera.name == "Mine"


def _edit(job, **changes):
    content = json.loads((job / "deliver.json").read_text())
    (job / "deliver.json").write_text(json.dumps({**content, **changes}))


def test_ply_forms(tmp_path):
    xyz, faces, rgb = synthetic.house_mesh()
    synthetic.write_mesh(tmp_path / "a.ply", xyz, faces, rgb)
    binary = read_ply(tmp_path / "a.ply")
    lines = ["ply", "format ascii 1.0", "comment by hand", f"element vertex {len(xyz)}"]
    lines += [f"property float {a}" for a in "xyz"]
    lines += ["element face 2", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, p)) for p in xyz] + ["4 0 1 5 4", "3 5 6 9"]
    (tmp_path / "b.ply").write_text("\n".join(lines) + "\n")
    text = read_ply(tmp_path / "b.ply")
    np.testing.assert_allclose(binary.positions, text.positions, atol=1e-6)
    np.testing.assert_array_equal(text.triangles, [(0, 1, 5), (0, 5, 4), (5, 6, 9)])
    np.testing.assert_array_equal(binary.colors(), rgb)
    assert text.colors() is None
    (tmp_path / "c.ply").write_bytes((tmp_path / "b.ply").read_bytes().replace(b"3 5 6 9", b"3 5 6 99"))
    with pytest.raises(UserError, match="vertices it does not hold"):
        read_ply(tmp_path / "c.ply")
