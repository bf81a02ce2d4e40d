# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of several runs of one job: each mesh keeps its own texture, and old runs can be removed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
import synthetic
from conftest import REPO
from layouts import draw

from mgf_blender.common.textures import texture_of
from mgf_blender.results.panel import MGF_PT_results
from mgf_blender.results.runs import old_runs
from mgf_blender.scene_import.imported_scene import ImportedScene

_UNDO = """
import os, sys
from pathlib import Path
sys.path[:0] = [*sys.argv[1:3], sys.argv[2] + "/results"]
import bpy, synthetic
import mgf_blender
from mgf_blender.common.textures import texture_of
from mgf_blender.scene_import.imported_scene import ImportedScene
from test_runs import add_run
house = synthetic.write_house(Path(sys.argv[3]) / "house")
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.preferences.edit.use_global_undo = True
mgf_blender.register()
bpy.ops.ed.undo_push(message="start")

def shown():
    (obj,) = ImportedScene.find(bpy.context.scene).objects("Mesh")
    image = texture_of(obj.data.materials[0])
    return len(obj.data.polygons), tuple(image.size), round(image.pixels[0], 1)

seen = []
for number, red in ((1, 0), (2, 200)):
    add_run(house.job, number, red, 16 * number, number - 1)
    bpy.ops.mgf.import_result("EXEC_DEFAULT", True, directory=str(house.job))
    seen.append(shown())
assert seen[0][0] != seen[1][0] and seen[0][1] == (16, 16) and seen[1][1] == (32, 32) and seen[0][2] != seen[1][2], seen
for _ in range(3):
    bpy.ops.ed.undo()
    assert shown() == seen[0], (shown(), seen)
    bpy.ops.ed.redo()
    assert shown() == seen[1], (shown(), seen)
print("survived", flush=True)
os._exit(0)
"""


def add_run(job: Path, number: int, red: int = 0, side: int = 16, fewer: int = 0) -> Path:
    """A finished run in the form of the engine: files in ``runs/NUMBER``, named by ``deliver.json``."""
    import numpy as np
    from test_texture import height_uv, write_picture

    run = job / "runs" / str(number)
    run.mkdir(parents=True)
    xyz, faces, rgb = synthetic.house_mesh()
    synthetic.write_mesh(run / "mesh.ply", xyz, faces[fewer:], rgb)
    write_picture(run / "texture.jpg", (red, 0, 0), (red, 0, 0), side)
    np.savez(run / "mesh_texture.npz", uv=height_uv()[fewer:])
    shutil.copytree(job / "renders", run / "renders")
    content = json.loads((job / "deliver.json").read_text())
    place = f"runs/{number}/"
    content.update(mesh=place + "mesh.ply", texture=place + "texture.jpg", texture_uv=place + "mesh_texture.npz")
    for view in content["views"]:
        view["render"] = view["render"] and place + "renders/" + Path(view["render"]).name
    (job / "deliver.json").write_text(json.dumps(content))
    (run / "run.json").write_text("{}")
    return run


def texture() -> bpy.types.Image:
    (obj,) = ImportedScene.find(bpy.context.scene).objects("Mesh")
    return texture_of(obj.data.materials[0])


def test_undo_brings_back_a_mesh_with_its_own_texture(tmp_path):
    command = [sys.executable, "-c", _UNDO, str(REPO), str(REPO / "tests" / "blender"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "survived" in done.stdout, done.stdout + done.stderr


def test_what_the_user_changed_in_a_material_stays_with_the_next_run(addon, house):
    addon.job_folder = str(house.job)
    add_run(house.job, 1)
    bpy.ops.mgf.import_result()
    (obj,) = ImportedScene.find(bpy.context.scene).objects("Mesh")
    obj.data.materials[0].name = "Mine"
    second = add_run(house.job, 2)
    bpy.ops.mgf.import_result()
    (obj,) = ImportedScene.find(bpy.context.scene).objects("Mesh")
    assert [m.name for m in obj.data.materials] == ["Mine"]
    assert Path(bpy.path.abspath(texture().filepath)) == second / "texture.jpg"


def test_old_runs_are_removed_but_for_those_in_use(addon, house):
    addon.job_folder = str(house.job)
    runs = [add_run(house.job, number) for number in (1, 2)]
    bpy.ops.mgf.import_result()
    runs += [add_run(house.job, number) for number in (3, 10)]
    (house.job / "runs" / "11").mkdir()  # in the making
    assert old_runs(house.job) == runs[:3]
    assert "mgf.remove_old_runs" in [name for name, *_ in draw(MGF_PT_results).operators]
    bpy.ops.mgf.remove_old_runs()
    assert [run.is_dir() for run in runs] == [False, True, False, True]
    assert texture().has_data or texture().size[0] == 16
    bpy.ops.mgf.import_result()
    bpy.ops.mgf.remove_old_runs()
    assert [run.is_dir() for run in runs] == [False, False, False, True]
    assert not bpy.ops.mgf.remove_old_runs.poll()
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.mgf.remove_old_runs()


def test_pictures_of_an_earlier_run_do_not_stay_in_the_file(addon, house):
    addon.job_folder = str(house.job)
    for number in (1, 2):
        run = add_run(house.job, number)
        bpy.ops.mgf.import_result()
    pictures = [i for i in bpy.data.images if i.get("mgf_image") in {"texture", "render"}]
    assert len(pictures) == 5
    assert all(Path(bpy.path.abspath(i.filepath)).is_relative_to(run) for i in pictures)
