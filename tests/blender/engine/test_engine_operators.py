# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of the engine: install, check, replace, and what panels say meanwhile."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import bpy
import pytest
from installation import folders, shortened
from layouts import Recorder

from mgf_blender.common import runner
from mgf_blender.common.job import Job
from mgf_blender.engine import current_task, environment, install, operators, swap
from mgf_blender.engine.status_label import draw_engine_missing

pytestmark = pytest.mark.usefixtures("free_space")


def test_the_question_before_the_download_says_what_may_come(monkeypatch):
    monkeypatch.setattr(install.sys, "platform", "linux")
    sizes = [install.size(torch, default) for torch in ("cpu", "cuda") for default in (False, True)]
    assert sizes == ["about 2 GB", "2 to 7 GB", "about 7 GB", "about 7 GB"]
    monkeypatch.setattr(install.sys, "platform", "win32")
    assert install.size("cpu", True) == "about 2 GB"
    prefs = SimpleNamespace(torch_build="AUTO", wheel_folder="", default_index=False)
    monkeypatch.setattr(operators, "preferences", lambda: prefs)
    for there, size in ((True, "7 GB"), (False, "2 GB")):
        monkeypatch.setattr(install, "has_nvidia", lambda there=there: there)
        assert size in operators._install_question()


def test_panels_say_that_the_engine_is_being_installed(addon, tmp_path, monkeypatch):
    monkeypatch.delenv(environment.VARIABLE, raising=False)
    monkeypatch.setattr(environment, "managed_environment", lambda: tmp_path / "environment")
    task = shortened(tmp_path, "import time; time.sleep(60)")
    current_task.begin("install", task)
    while task.title != "Checking the engine":
        task.drain()
    layout = Recorder()
    assert draw_engine_missing(layout)
    said = " ".join(text for text, _ in layout.texts)
    assert "is being installed" in said and "interrupted" not in said and "Checking the engine" in said
    task.cancel()
    task.run()
    swap.wait_for_removal()
    layout = Recorder()
    assert draw_engine_missing(layout)
    assert "is not installed" in " ".join(text for text, _ in layout.texts)


def test_what_cannot_be_installed_is_not_asked(addon, monkeypatch):
    monkeypatch.setattr(operators, "preferences", lambda: SimpleNamespace(wheel_folder=""))
    asked, said = [], []
    manager = SimpleNamespace(invoke_confirm=lambda *_, **__: asked.append(1) or {"RUNNING_MODAL"})
    operator = SimpleNamespace(report=lambda kind, text: said.append(text))
    context = SimpleNamespace(window_manager=manager)
    assert not bpy.app.online_access
    assert operators.MGF_OT_install_engine.invoke(operator, context, None) == {"CANCELLED"}
    assert not asked and "Online access is off" in said[0]


def test_the_engine_is_not_replaced_under_a_running_job(addon, tmp_path, monkeypatch):
    monkeypatch.setattr(operators, "managed_environment", lambda: tmp_path / "environment")
    assert bpy.ops.mgf.install_engine.poll() and bpy.ops.mgf.remove_engine.poll()
    job = Job(["true"], tmp_path / "job", "A job")
    monkeypatch.setattr(runner, "_jobs", [job])
    assert job.live and not bpy.ops.mgf.install_engine.poll() and not bpy.ops.mgf.remove_engine.poll()
    job.status = "DONE"
    shortened(tmp_path, "0").run()
    swap.wait_for_removal()
    bpy.ops.mgf.remove_engine()
    assert folders(tmp_path) == []


def test_check_engine(addon, engine, monkeypatch, tmp_path):
    assert bpy.ops.mgf.check_engine() == {"FINISHED"}
    assert current_task.current()[1].output[-1] == "Everything a job needs is here."
    monkeypatch.setenv("MGF_ENGINE_PYTHON", sys.executable)
    with pytest.raises(RuntimeError, match="has no MGF engine"):
        bpy.ops.mgf.check_engine()
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(tmp_path / "gone"))
    with pytest.raises(RuntimeError, match="There is no Python"):
        bpy.ops.mgf.check_engine()


def test_check_gpu(addon, engine):
    assert bpy.ops.mgf.check_gpu() == {"FINISHED"}
    assert current_task.current()[1].output[-1] == "The GPU passed in 9 s."
    engine("bad")
    with pytest.raises(RuntimeError, match=r"^Error: The GPU did not pass\."):
        bpy.ops.mgf.check_gpu()
