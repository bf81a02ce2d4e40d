# SPDX-License-Identifier: GPL-3.0-or-later
"""Full disks, no network, and saving with the point tool in hand. (Crashes, cancels, quits and deletions are tested
where the jobs are: common/test_job.py and reconstruct/test_reconstruct.py.)"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import bpy
import pytest

from mgf_blender import headless
from mgf_blender.common import runner
from mgf_blender.common.errors import UserError
from mgf_blender.engine import install
from mgf_blender.engine.task import DONE, FAILED, Step, Task
from mgf_blender.prompts import files, preview
from mgf_blender.prompts.tool import TOOL_ID
from mgf_blender.reconstruct import estimate
from mgf_blender.scene_import.imported_scene import ImportedScene

FULL = Path("/dev/full")  # every write to it fails as on a full disk
needs_full = pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")


@pytest.fixture
def state(addon, engine, house):
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    files.add_click(addon.photos[0], 9, 9, False, "building")
    return addon


@needs_full
def test_full_disk_when_points_are_exported(state, tmp_path):
    path = tmp_path / "prompts.json"
    path.write_text("earlier")
    (tmp_path / "prompts.json.writing").symlink_to(FULL)
    with pytest.raises(RuntimeError, match=r"The disk is full, .* was not written; free some space"):
        bpy.ops.mgf.export_prompts(filepath=str(path))
    assert path.read_text() == "earlier" and [p.name for p in tmp_path.glob("*.writing")] == []


@needs_full
def test_full_disk_when_a_job_starts(state):
    folder = Path(state.job_folder)
    (folder.parent / (folder.name + ".prompts.json.writing")).symlink_to(FULL)
    with pytest.raises(RuntimeError, match="The disk is full"):
        bpy.ops.mgf.reconstruct()
    assert runner.jobs() == [] and not folder.exists()


@needs_full
def test_full_disk_when_the_file_is_saved(state, tmp_path):
    out = tmp_path / "out.blend"
    out.write_bytes(b"earlier")
    (tmp_path / ".out.writing.blend@").symlink_to(FULL)
    with pytest.raises(UserError, match=r"The disk is full|Cannot write '.*out\.blend'"):
        headless.save(out)
    assert out.read_bytes() == b"earlier" and [p.name for p in tmp_path.iterdir() if "writing" in p.name] == []


@needs_full
def test_full_disk_for_what_only_helps(state, monkeypatch, tmp_path, house):
    """Logs and learned speeds are no reason to stop or to speak up."""
    assert Task([Step("x", [sys.executable, "-c", "print(5)"])], FULL, install.explain).run() == DONE
    monkeypatch.setattr(estimate, "_path", lambda: FULL)
    estimate.remember(2.0)
    monkeypatch.setattr(estimate, "_path", lambda: tmp_path / "none.json")  # the full disk gives zeros without end
    assert estimate.speed() == 1.0


@needs_full
def test_full_disk_when_a_preview_starts(state, monkeypatch):
    folder = Path(bpy.app.tempdir) / "mgf_preview"
    folder.mkdir(exist_ok=True)
    link = folder / f"{preview._count + 1}.json.writing"
    link.symlink_to(FULL)
    with pytest.raises(RuntimeError, match="The disk is full"):
        bpy.ops.mgf.preview_mask()
    assert not link.is_symlink()


def test_full_disk_in_the_engine_is_passed_on(state, engine):
    engine("full")
    with pytest.raises(RuntimeError, match=r"The disk of '.*new job' is full; free some space"):
        bpy.ops.mgf.reconstruct()


def test_no_network_is_one_sentence(tmp_path):
    """pip itself, asked for a package from an address where nobody listens."""
    command = [sys.executable, "-m", "pip", "--isolated", "download", "--no-cache-dir", "--retries", "1", "-d",
               str(tmp_path), "--index-url", "http://127.0.0.1:9/simple", "mgf-package-that-is-nowhere"]  # fmt: skip
    task = Task([Step("Installing torch", command)], tmp_path / "log.txt", install.explain)
    assert task.run() == FAILED
    assert task.text.startswith("The package index cannot be reached; check the network")


def test_undo_of_a_scene_import(addon, house):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.mgf.import_colmap("EXEC_DEFAULT", True, filepath=str(house.folder))
    assert len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12
    bpy.ops.ed.undo()
    state = bpy.context.scene.mgf
    assert ImportedScene.find(bpy.context.scene) is None and not state.source and not len(state.photos)
    assert not [o for o in bpy.data.objects if "mgf_kind" in o]
    bpy.ops.ed.redo()
    assert len(ImportedScene.find(bpy.context.scene).objects("Cameras")) == 12 and bpy.context.scene.mgf.source


def test_undo_while_a_job_runs(state, engine, house):
    """Undo takes points and objects back, never the job; its result comes in all the same."""
    engine("slow", FAKE_RESULT=house.job)
    from mgf_blender.reconstruct.start import make_job

    job = make_job(bpy.context.scene)
    bpy.ops.ed.undo_push(message="before")
    runner.submit(job)
    runner.pump()
    files.add_click(bpy.context.scene.mgf.photos[0], 50, 50, False, "building")
    bpy.ops.ed.undo_push(message="a point")
    bpy.ops.ed.undo()
    assert len(bpy.context.scene.mgf.photos[0].clicks) == 1 and job.live
    while runner.pump():
        time.sleep(0.01)
    assert job.status == DONE and len(ImportedScene.find(bpy.context.scene).objects("Mesh")) == 1


def image_editor() -> tuple[bpy.types.Window, bpy.types.Area]:
    window = bpy.context.window_manager.windows[0]
    area = next((a for a in window.screen.areas if a.type == "IMAGE_EDITOR"), None)
    if area is None:
        area = max(window.screen.areas, key=lambda a: a.width * a.height)
        area.type = "IMAGE_EDITOR"
    return window, area


def test_saving_and_loading_with_the_point_tool_active(addon, engine, house, tmp_path):
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=False)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    window, area = image_editor()
    with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
        bpy.ops.mgf.use_point_tool()
        bpy.ops.mgf.next_photo()
    photo = bpy.context.scene.mgf.photos[1]
    with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
        assert bpy.ops.mgf.click(photo=1, uv=(20.0, 30.0)) == {"FINISHED"}
    assert active_tool() == TOOL_ID
    path = str(tmp_path / "with the tool.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    assert not len(bpy.context.scene.mgf.photos)
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=True)
    assert active_tool() == TOOL_ID
    photo = bpy.context.scene.mgf.photos[1]
    assert [tuple(c.uv) for c in photo.clicks] == [(20.0, 30.0)] and bpy.context.scene.mgf.photo_index == 1
    window, area = image_editor()
    with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
        assert bpy.ops.mgf.click(photo=1, uv=(40.0, 50.0), negative=True) == {"FINISHED"}
        assert bpy.ops.mgf.remove_click(photo=1, uv=(21.0, 30.0)) == {"FINISHED"}
    assert [tuple(c.uv) for c in bpy.context.scene.mgf.photos[1].clicks] == [(40.0, 50.0)]


def active_tool() -> str:
    window, _ = image_editor()
    tool = window.workspace.tools.from_space_image_mode("VIEW")
    return tool.idname if tool is not None else ""
