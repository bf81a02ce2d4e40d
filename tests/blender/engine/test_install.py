# SPDX-License-Identifier: GPL-3.0-or-later
"""Installing and checking the engine: the plan, the steps, and every way it can fail."""

from __future__ import annotations

import shutil
import sys
from collections import namedtuple
from pathlib import Path

import bpy
import pytest

from mgf_blender.common.errors import UserError
from mgf_blender.engine import environment, install, operators
from mgf_blender.engine.task import CANCELLED, DONE, FAILED, Step, Task


def plan(tmp_path: Path, **more: object) -> install.Plan:
    values = {
        "target": tmp_path / "environment", "python": Path(sys.executable), "wheel": tmp_path / "mgf_engine-1.whl",
        "constraints": tmp_path / "constraints.txt", "wheel_folder": None, "torch": "cpu",
    }  # fmt: skip
    return install.Plan(**{**values, **more})


@pytest.fixture(autouse=True)
def room(monkeypatch):
    """A disk with room for the engine, whatever this machine has left."""
    _set_free(monkeypatch, 64 << 30)


def _set_free(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(1 << 40, (1 << 40) - free, free))


def test_steps_of_a_download(tmp_path):
    steps = install.make_task(plan(tmp_path), tmp_path / "log.txt").steps
    commands = [" ".join(s.command) for s in steps]
    assert "-m venv" in commands[0] and "torch" in commands[1] and "whl/cpu" in commands[1]
    assert "mgf_engine-1.whl" in commands[2] and "doctor" in commands[3]
    assert "whl/cu" in " ".join(install.make_task(plan(tmp_path, torch="cuda"), tmp_path / "log.txt").steps[1].command)


def test_wheel_folder_means_no_network(tmp_path):
    folder = tmp_path / "wheels"
    folder.mkdir()
    with pytest.raises(UserError, match="no wheel of torch"):
        install.make_task(plan(tmp_path, wheel_folder=folder), tmp_path / "log.txt")
    (folder / "torch-2.whl").touch()
    steps = install.make_task(plan(tmp_path, wheel_folder=folder), tmp_path / "log.txt").steps
    assert all("--no-index" in s.command for s in steps[1:3]) and "http" not in str([s.command for s in steps])


def test_full_disk_is_said_before_anything_is_written(tmp_path, monkeypatch):
    _set_free(monkeypatch, 1 << 20)
    with pytest.raises(UserError, match="the engine needs 3 GB"):
        install.make_task(plan(tmp_path), tmp_path / "log.txt")
    assert not (tmp_path / "environment").exists() and not (tmp_path / "log.txt").exists()


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("Retrying (Retry(total=4)) after connection broken by 'NewConnectionError'", "cannot be reached"),
        ("OSError: [Errno 28] No space left on device", "disk is full"),
        ("No module named ensurepip", "cannot make environments"),
        ("ERROR: No matching distribution found for torch==2.13.0", "No build of torch==2.13.0 fits"),
        ("ERROR: ResolutionImpossible: for help visit", "do not fit together"),
        (
            "ERROR: Could not install packages due to an OSError: [Errno 2] No such file or directory: 'C:\\x'\n"
            "HINT: This error might have occurred since this system does not have Windows Long Path support enabled.",
            "path is too long",
        ),
        ("OSError: [WinError 206] The filename or extension is too long: 'C:\\x'", "path is too long"),
        ("something odd", "something odd"),
    ],
)
def test_pip_failures_are_one_sentence(output, words):
    text = install.explain(Step("Installing torch", []), ["Collecting torch", output, ""])
    assert words in text and text.endswith(".") and "\n" not in text


def test_on_windows_the_environment_has_a_short_path(monkeypatch):
    monkeypatch.setattr(environment.sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", "/Users/maximilian.mustermann/AppData/Local")
    target = environment.managed_environment()
    assert target == Path("/Users/maximilian.mustermann/AppData/Local/mgf/engine")
    install.check_length("C:" + str(target))


def test_too_long_a_path_is_said_before_anything_is_written(tmp_path, monkeypatch):
    # The longest name in the pinned wheel of torch has 167 letters, Windows allows 259 in all.
    fits = "C:\\" + "x" * (259 - 167 - len("C:\\" + "\\Lib\\site-packages\\"))
    install.check_length(fits)
    with pytest.raises(UserError, match=r"1 letter.s. too long"):
        install.check_length(fits + "x")
    monkeypatch.setattr(install.sys, "platform", "win32")
    monkeypatch.setattr(install, "_long_paths_allowed", lambda: False)
    deep = tmp_path / ("x" * 80)
    with pytest.raises(UserError, match="switch long paths on"):
        install.make_task(plan(tmp_path, target=deep / "engine"), tmp_path / "log.txt")
    assert not deep.exists() and not (tmp_path / "log.txt").exists()
    monkeypatch.setattr(install, "_long_paths_allowed", lambda: True)
    assert install.make_task(plan(tmp_path, target=deep / "engine"), tmp_path / "log.txt").steps


def test_a_real_environment_is_made_and_a_failing_step_stops(tmp_path):
    log = tmp_path / "folder" / "log.txt"
    python = tmp_path / "environment" / "bin" / "python"
    steps = [
        Step(
            "Making the environment",
            [sys.executable, "-I", "-m", "venv", "--without-pip", str(tmp_path / "environment")],
        ),
        Step("Asking it", [str(python), "-c", "print('hello from it')"]),
        Step("Failing", [str(python), "-c", "raise SystemExit('broken on purpose')"]),
        Step("Never", [str(python), "-c", "print('never')"]),
    ]
    ends = []
    task = Task(steps, log, install.explain, on_end=ends.append)
    assert task.run() == FAILED and "broken on purpose" in task.text and ends == [task]
    text = log.read_text()
    assert "hello from it" in text and "never" not in text.replace("== Never", "") and 0 < task.fraction < 1


def test_cancel_ends_the_running_step(tmp_path):
    task = Task(
        [Step("Sleeping", [sys.executable, "-c", "import time; time.sleep(60)"])], tmp_path / "l", install.explain
    )
    task.drain()
    task.cancel()
    assert task.run() == CANCELLED


def test_unwritable_log_does_not_stop_the_work():
    assert Task([Step("x", [sys.executable, "-c", "0"])], Path("/proc/no/log"), install.explain).run() == DONE


def test_check_engine(addon, engine, monkeypatch, tmp_path):
    assert bpy.ops.mgf.check_engine() == {"FINISHED"}
    assert operators.current()[1].output[-1] == "Everything a job needs is here."
    monkeypatch.setenv("MGF_ENGINE_PYTHON", sys.executable)
    with pytest.raises(RuntimeError, match="has no MGF engine"):
        bpy.ops.mgf.check_engine()
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(tmp_path / "gone"))
    with pytest.raises(RuntimeError, match="There is no Python"):
        bpy.ops.mgf.check_engine()


@pytest.mark.parametrize(
    ("system", "machine", "fits"),
    [
        ("Linux", "x86_64", "manylinux_2_17_x86_64"), ("Linux", "aarch64", "manylinux_2_17_aarch64"),
        ("Windows", "amd64", "win_amd64"), ("Darwin", "arm64", "macosx_12_0_arm64"),
        ("Darwin", "x86_64", "macosx_12_0_x86_64"), ("Windows", "arm64", None), ("FreeBSD", "amd64", None),
    ],
)  # fmt: skip
def test_each_machine_gets_its_own_wheel(tmp_path, monkeypatch, system, machine, fits):
    tags = ("manylinux_2_17_x86_64", "manylinux_2_17_aarch64", "win_amd64", "macosx_12_0_arm64", "macosx_12_0_x86_64")
    for tag in tags:
        (tmp_path / f"mgf_engine-0.1.0-py3-none-{tag}.whl").touch()
    monkeypatch.setattr(install, "carried_folder", lambda: tmp_path)
    monkeypatch.setattr(install.platform, "system", lambda: system)
    monkeypatch.setattr(install.platform, "machine", lambda: machine)
    if fits is None:
        with pytest.raises(UserError, match="no engine for"):
            install.carried_wheel()
    else:
        assert install.carried_wheel().name.endswith(f"-{fits}.whl")
