# SPDX-License-Identifier: GPL-3.0-or-later
"""A large mesh comes in by short steps, as one undo step, whatever happens in between."""

from __future__ import annotations

import itertools
import shutil
import time

import bpy
import numpy as np
import pytest
import synthetic
from jobs import pump_until

from mgf_blender.common.meshes import make_mesh, prepare_mesh
from mgf_blender.jobs import import_status
from mgf_blender.reconstruct.start import make_job
from mgf_blender.results import async_import
from mgf_blender.scene_import.imported_scene import ImportedScene


@pytest.fixture
def ready(addon, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.job)
    return addon


def pump(until=lambda: not async_import._imports) -> None:
    pump_until(until, async_import.pump, pause=0.002)


def meshes() -> list[bpy.types.Object]:
    return ImportedScene.find(bpy.context.scene).objects("Mesh")


def pending() -> list[str]:
    return [m.name for m in bpy.data.meshes if "mgf_importing" in m]


def test_arrives_like_an_import_in_one_go(ready, house):
    async_import.begin(bpy.context.scene, house.job)
    assert import_status.under_way(bpy.context.scene) and not meshes()
    pump()
    (obj,) = meshes()
    truth, faces, _ = synthetic.house_mesh()
    assert (len(obj.data.vertices), len(obj.data.polygons)) == (len(truth), len(faces))
    assert obj.name == obj.data.name == "job" and not pending() and not import_status.problem(bpy.context.scene)
    assert len(ImportedScene.find(bpy.context.scene).objects("Renders")) == 4


def test_again_replaces_and_leaves_no_blocks(ready, house):
    for _ in range(2):
        async_import.begin(bpy.context.scene, house.job)
        pump()
    assert [m.name for m in bpy.data.meshes] == ["job", "Sparse Points"]


def test_comes_selected_and_framed_the_first_time(ready, house):
    bpy.context.view_layer.objects.active = ImportedScene.find(bpy.context.scene).root
    space = next(a.spaces.active for a in bpy.context.window.screen.areas if a.type == "VIEW_3D")
    for first in (True, False):
        space.region_3d.view_location = (99, 99, 99)
        bpy.ops.mgf.import_result()
        (obj,) = meshes()
        assert bpy.context.object == obj and bpy.context.selected_objects == [obj]
        bpy.context.view_layer.update()
        corners = np.array(obj.bound_box) @ np.array(obj.matrix_world)[:3, :3].T + np.array(obj.matrix_world)[:3, 3]
        middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
        assert np.allclose(space.region_3d.view_location, middle if first else 99, atol=1e-4)
        obj.select_set(False)


@pytest.mark.parametrize(
    ("folder", "name"),
    [("house_jobs/west wing", "west wing"), ("tower/mgf_job", "tower"), ("tower/mgf_job_2", "tower"),
     ("house_jobs/house", "house")],
)  # fmt: skip
def test_the_mesh_is_called_as_its_job_is(ready, house, tmp_path, folder, name):
    shutil.copytree(house.job, tmp_path / folder)
    bpy.ops.mgf.import_result(directory=str(tmp_path / folder))
    assert meshes()[0].name == meshes()[0].data.name == name


def test_whole_import_is_one_undo_step(ready, house):
    bpy.ops.ed.undo_push(message="before")
    async_import.begin(bpy.context.scene, house.job)
    pump()
    bpy.ops.ed.undo()
    assert not meshes() and len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12


def test_objects_deleted_or_undone_while_it_arrives(ready, house):
    async_import.begin(bpy.context.scene, house.job)
    pump(lambda: pending())
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    for name in pending():
        bpy.data.meshes.remove(bpy.data.meshes[name])
    pump()
    assert len(meshes()) == 1 and len(meshes()[0].data.polygons) == 16


def test_an_undo_to_a_half_made_mesh_begins_it_anew(ready, house):
    """An undo step in between holds the mesh as it was then; going on where the steps are would write beyond it."""
    async_import.begin(bpy.context.scene, house.job)
    pump(lambda: pending())
    bpy.ops.ed.undo_push(message="half made")
    for _ in range(4):
        async_import.pump()
    bpy.ops.ed.undo_push(message="further")
    bpy.ops.ed.undo()
    assert not pending()
    pump()
    (obj,) = meshes()
    assert len(obj.data.polygons) == 16 and not obj.data.validate() and not pending()


def test_a_mesh_that_is_removed_each_time_is_a_sentence(ready, house):
    async_import.begin(bpy.context.scene, house.job)
    end = time.monotonic() + 20
    while async_import._imports and time.monotonic() < end:
        async_import.pump()
        for name in pending():
            bpy.data.meshes.remove(bpy.data.meshes[name])
    assert "made a mistake" in import_status.problem(bpy.context.scene) and not meshes()


def test_an_import_by_script_while_it_arrives_takes_no_half_made_mesh(ready, house):
    async_import.begin(bpy.context.scene, house.job)
    pump(lambda: pending())
    bpy.ops.mgf.import_result()
    assert len(meshes()[0].data.polygons) == 16 and not pending() and not import_status.under_way(bpy.context.scene)


def test_another_file_while_it_arrives(ready, house):
    async_import.begin(bpy.context.scene, house.job)
    pump(lambda: pending())
    bpy.ops.wm.read_homefile(use_empty=True)
    pump()
    assert not bpy.data.meshes


def test_a_damaged_mesh_is_a_sentence_in_the_panel(ready, house):
    (house.job / "mesh.ply").write_bytes(b"ply\nend_header\n")
    async_import.begin(bpy.context.scene, house.job)
    pump()
    assert "damaged" in import_status.problem(bpy.context.scene) and not meshes()


def test_add_on_disabled_while_it_arrives(ready, house):
    async_import.begin(bpy.context.scene, house.job)
    pump(lambda: pending())
    async_import.unregister()
    assert not pending() and not async_import._imports


def test_a_mesh_is_valid_and_has_its_edges(scene):
    _, faces, _ = synthetic.house_mesh()
    mesh = make_mesh("own", prepare_mesh(np.random.default_rng(3).normal(size=(10, 3)), faces))
    corners = [tuple(p.vertices) for p in mesh.polygons]
    sides = {tuple(sorted((t[i], t[(i + 1) % 3]))) for t in corners for i in range(3)}
    assert corners == [tuple(f) for f in faces.tolist()]
    assert len(mesh.edges) == len(sides) and {tuple(sorted(e.vertices)) for e in mesh.edges} == sides
    assert not mesh.validate(verbose=True)


def test_faces_without_area_in_index_space_are_left_out(scene):
    data = prepare_mesh(np.eye(4, 3), np.array([(0, 1, 2), (1, 1, 2), (0, 3, 1)]))
    assert data.kept.tolist() == [True, False, True]
    assert not make_mesh("m", data).validate()


def test_a_large_mesh_comes_array_by_array(ready, house, monkeypatch):
    """200,000 faces; each tick fills one array. docs/blender.md states the time for two million."""
    n = 317
    u, v = np.meshgrid(np.linspace(-3, 3, n), np.linspace(-2, 2, n))
    xyz = np.stack([u, v, 2 + np.sin(3 * u) * np.cos(5 * v)], axis=-1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (x.ravel() for x in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    synthetic.write_mesh(house.job / "mesh.ply", xyz, faces, np.full((n * n, 3), 99), confidence=xyz[:, 2])
    steps, filled, at_once = async_import.mesh_steps, [(0, 0, 0, 0, 0)], [0]

    def watched(name, *arguments):
        for _ in steps(name, *arguments):
            mesh = bpy.data.meshes[name]
            filled.append(tuple(map(len, (mesh.vertices, mesh.loops, mesh.polygons, mesh.edges, mesh.attributes))))
            at_once[-1] += 1
            yield

    monkeypatch.setattr(async_import, "mesh_steps", watched)
    monkeypatch.setattr(async_import, "_longest", 0.0)
    async_import.begin(bpy.context.scene, house.job)
    pump(lambda: at_once.append(0) or not import_status.under_way(bpy.context.scene))
    assert len(meshes()[0].data.polygons) == len(faces) > 190_000 and async_import.longest_step() > 0
    assert max(at_once) == 1 and sum(at_once) >= 6
    for before, after in itertools.pairwise(filled):
        assert sum(a != b for a, b in zip(before, after, strict=True)) <= 2, (before, after)


def test_the_job_starts_it_in_the_window(ready, house, monkeypatch, engine):
    from mgf_blender.reconstruct import start

    ready.photos[0].clicks.add().uv = (5, 5)
    started = []
    monkeypatch.setattr(start, "in_background", lambda: False)
    monkeypatch.setattr(async_import, "begin", lambda scene, folder: started.append(folder))
    job = make_job(bpy.context.scene)
    job.status = "DONE"
    start.ended(job)
    assert started == [house.job]
