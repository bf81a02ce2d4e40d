# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the preferences: install, check, cancel, remove, open the log, fetch the mask weights."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

from ..common import runner
from ..common.addon import NAME, preferences
from ..common.errors import UserError
from ..common.files import open_file
from ..common.operators import Operator
from ..common.text import N_, tr
from . import current_task, install, swap
from .current_task import begin, log_path
from .environment import engine_command, managed_environment
from .task import DONE, Step, Task


def _finish_in_background(operator: bpy.types.Operator, task: Task) -> set[str]:
    """Run to the end without a window, where there are no timers, and say how it went."""
    if not bpy.app.background:
        return {"FINISHED"}
    status = task.run()
    swap.wait_for_removal()
    if status != DONE:
        operator.report({"ERROR"}, task.text)
        return {"CANCELLED"}
    return {"FINISHED"}


class _EngineOperator(Operator):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(not current_task.is_running(), "Wait until the running task has ended")


class _ReplacesEngine(_EngineOperator):
    """Not while a job runs: the engine loads its parts as it goes, and would lose them halfway."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        idle = not any(job.live for job in runner.jobs())
        allowed = cls.needs(idle, "Wait until the running job has ended, or cancel it")
        allowed = allowed and cls.needs(not swap.discarding(), "Wait until the old engine has been removed")
        return allowed and super().poll(context)


class MGF_OT_install_engine(_ReplacesEngine):
    """Create a virtual environment and install the engine with its pinned packages"""

    bl_idname = "mgf.install_engine"
    bl_label = "Install Engine"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            _plan()
        except UserError as error:  # what cannot be installed is said, not asked
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return context.window_manager.invoke_confirm(
            self, event, title="Install the engine?", message=_install_question(), confirm_text="Install"
        )

    def run(self, context: bpy.types.Context) -> set[str]:
        task = install.make_task(_plan(), log_path())
        preferences().engine_source = "MANAGED"
        begin("install", task)
        return _finish_in_background(self, task)


class MGF_OT_check_engine(_EngineOperator):
    """Show versions, device and kernel variant of the engine"""

    bl_idname = "mgf.check_engine"
    bl_label = "Check Engine"

    def run(self, context: bpy.types.Context) -> set[str]:
        steps = [Step(N_("Checking the engine"), engine_command("doctor", *_weights("--weights")))]
        task = Task(steps, log_path(), _explain_check)
        begin("check", task)
        return _finish_in_background(self, task)


class MGF_OT_check_gpu(_EngineOperator):
    """Compare this machine's NVIDIA GPU with the CPU, in a minute; a GPU that passes is used from then on"""

    bl_idname = "mgf.check_gpu"
    bl_label = "Check GPU"

    def run(self, context: bpy.types.Context) -> set[str]:
        task = Task([Step(N_("Checking the GPU"), engine_command("doctor", "--gpu"))], log_path(), _explain_check)
        begin("gpu", task)
        return _finish_in_background(self, task)


class MGF_OT_download_weights(_EngineOperator):
    """Download the weights of the mask model and check them"""

    bl_idname = "mgf.download_weights"
    bl_label = "Download Weights"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        allowed = cls.needs(bpy.app.online_access, "Allow online access in the System preferences first")
        return allowed and super().poll(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        steps = [Step(N_("Downloading the weights"), engine_command("weights", *_weights("--folder")))]
        task = Task(steps, log_path(), install.explain)
        begin("weights", task)
        return _finish_in_background(self, task)


class MGF_OT_cancel_engine_task(Operator):
    """Stop the running installation or check"""

    bl_idname = "mgf.cancel_engine_task"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return current_task.is_running()

    def run(self, context: bpy.types.Context) -> None:
        current_task.cancel()


class MGF_OT_remove_engine(_ReplacesEngine):
    """Delete the environment of the installed engine"""

    bl_idname = "mgf.remove_engine"
    bl_label = "Remove Engine"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def run(self, context: bpy.types.Context) -> None:
        swap.remove(managed_environment())
        current_task.forget()
        if bpy.app.background:
            swap.wait_for_removal()


class MGF_OT_show_preferences(Operator):
    """Open the preferences of this add-on"""

    bl_idname = "mgf.show_preferences"
    bl_label = "Set Up Engine"

    def run(self, context: bpy.types.Context) -> None:
        bpy.ops.preferences.addon_show(module=NAME)


class MGF_OT_open_engine_log(Operator):
    """Open the log of the last installation or check"""

    bl_idname = "mgf.open_engine_log"
    bl_label = "Open Log"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls.needs(log_path().is_file(), "Nothing was installed or checked yet")

    def run(self, context: bpy.types.Context) -> None:
        open_file(log_path())


def _weights(flag: str) -> list[str]:
    """Return the folder of the mask weights for a command of the engine; nothing for the engine's own."""
    prefs = preferences()
    folder = prefs.weights_folder if prefs is not None else ""
    return [flag, bpy.path.abspath(folder)] if folder else []


def _install_question() -> str:
    prefs = preferences()
    if prefs.wheel_folder:
        return tr("The packages come from the wheel folder")
    size = install.size(_torch_build(), prefs.default_index)
    return tr("Packages are downloaded from the internet ({size} on disk)", size=tr(size))


def _torch_build() -> str:
    """Return the build of torch that the preferences ask for, "cpu" or "cuda"."""
    build: str = preferences().torch_build.lower()
    if build == "auto":
        return "cuda" if install.has_nvidia() else "cpu"
    return build


def _plan() -> install.InstallPlan:
    """Return the plan the preferences ask for.

    Raises:
        UserError: no network allowed and no wheel folder, or nothing to install.
    """
    prefs = preferences()
    folder = Path(bpy.path.abspath(prefs.wheel_folder)) if prefs.wheel_folder else None
    if folder is None and not bpy.app.online_access:
        raise UserError("Online access is off; allow it in the System preferences, or choose a folder of wheels.")
    if folder is not None and not folder.is_dir():
        raise UserError("The wheel folder '{folder}' does not exist; choose another one.", folder=folder)
    wheel = install.carried_wheel()
    return install.InstallPlan(
        managed_environment(), Path(sys.executable), wheel, wheel.parent / "constraints.txt", folder, _torch_build(),
        prefs.default_index, prefs.install_weights,
        Path(bpy.path.abspath(prefs.weights_folder)) if prefs.weights_folder else None, prefs.install_survey,
        prefs.install_models,
    )  # fmt: skip


def _explain_check(step: Step, lines: list[str]) -> str:
    text = "\n".join(lines)
    if "No module named mgf_engine" in text or "No module named 'mgf_engine'" in text:
        return tr("The chosen environment has no MGF engine; install it or choose another environment.")
    for mark in ("Problem: ", "Error: "):
        found = next((line for line in lines if line.startswith(mark)), None)
        if found is not None:
            return found.removeprefix(mark)
    last = next((line for line in reversed(lines) if line.strip()), "no output")
    return tr("The engine cannot run ({reason}); open the log for the details.", reason=install.short(last))


CLASSES = (
    MGF_OT_install_engine, MGF_OT_check_engine, MGF_OT_check_gpu, MGF_OT_download_weights, MGF_OT_cancel_engine_task,
    MGF_OT_remove_engine, MGF_OT_show_preferences, MGF_OT_open_engine_log,
)  # fmt: skip


def register() -> None:
    """Register the operators."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Stop a running task, and take the operators away."""
    current_task.end()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
