# SPDX-License-Identifier: GPL-3.0-or-later
"""A new engine takes the place of the one before, which stays where that fails or is cancelled."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import pytest
from installation import folders, prefix_of, shortened

from mgf_blender.common.errors import UserError
from mgf_blender.engine import current_task, environment, swap
from mgf_blender.engine.task import CANCELLED, DONE, FAILED

pytestmark = pytest.mark.usefixtures("free_space")


def test_a_new_engine_takes_the_old_ones_place_only_after_its_check(tmp_path):
    assert shortened(tmp_path, "0").run() == DONE
    assert folders(tmp_path) == ["environment"] and prefix_of(tmp_path) == str(tmp_path / "environment")
    mark = tmp_path / "environment" / "first"
    mark.touch()
    assert shortened(tmp_path, "raise SystemExit('no kernels')").run() == FAILED
    assert mark.is_file() and folders(tmp_path) == ["environment"]
    assert shortened(tmp_path, "0").run() == DONE
    assert not mark.exists() and folders(tmp_path) == ["environment"]


def test_a_cancelled_installation_leaves_no_half_and_says_so(tmp_path):
    for words, left in (("nothing was installed", []), ("the engine from before is kept", ["environment"])):
        task = shortened(tmp_path, "import time; time.sleep(60)")
        while task.title != "Checking the engine":
            assert task.drain()
        assert folders(tmp_path) == [*left, "environment-new"]
        task.cancel()
        assert task.run() == CANCELLED and words in task.text
        assert folders(tmp_path) == left
        assert shortened(tmp_path, "0").run() == DONE


def test_blender_ended_in_the_middle_of_an_installation(tmp_path, monkeypatch):
    target = tmp_path / "environment"
    monkeypatch.delenv(environment.VARIABLE, raising=False)
    monkeypatch.setattr(environment, "managed_environment", lambda: target)
    with pytest.raises(UserError, match="is not installed"):
        environment.engine_python()
    task = shortened(tmp_path, "import time; time.sleep(60)")
    while task.title != "Checking the engine":
        task.drain()
    with pytest.raises(UserError, match="installation was interrupted"):
        environment.engine_python()
    task.cancel()
    task.run()
    swap.wait_for_removal()
    assert shortened(tmp_path, "0").run() == DONE
    swap.wait_for_removal()
    target.rename(tmp_path / "environment-old")  # the new one was about to come here
    assert environment.engine_python() == environment.python_of(target)


def test_an_engine_in_use_is_kept(tmp_path, monkeypatch):
    """Windows does not rename a folder whose programs run."""
    assert shortened(tmp_path, "0").run() == DONE

    def refuse(path: Path, to: Path) -> None:
        raise PermissionError(13, "Access is denied", str(path))

    monkeypatch.setattr(Path, "rename", refuse)
    task = shortened(tmp_path, "0")
    assert task.run() == FAILED and "in use" in task.text and "Access is denied" in task.text
    with pytest.raises(UserError, match="close other Blender windows"):
        swap.remove(tmp_path / "environment")
    assert folders(tmp_path) == ["environment"] and prefix_of(tmp_path)


def test_an_old_engine_is_removed_where_no_process_can_start(tmp_path, monkeypatch):
    """A machine without memory for one more process, or without room for its output."""
    target = tmp_path / "environment"

    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    for broken in (subprocess, "Popen"), (tempfile, "mkstemp"):
        assert shortened(tmp_path, "0").run() == DONE
        task = shortened(tmp_path, "0")
        while task.title != "Checking the engine":
            assert task.drain()
        with monkeypatch.context() as context:
            context.setattr(*broken, refuse)
            assert task.run() == DONE
            assert folders(tmp_path) == ["environment"]
            swap.remove(target)
            assert folders(tmp_path) == []


def test_an_engine_that_cannot_be_put_back_is_a_sentence(tmp_path, monkeypatch):
    """The panels ask for the engine while they are drawn."""
    target = tmp_path / "environment"
    target.with_name("environment-old").mkdir()
    monkeypatch.delenv(environment.VARIABLE, raising=False)
    monkeypatch.setattr(environment, "managed_environment", lambda: target)

    def refuse(path: Path, to: Path) -> None:
        raise PermissionError(13, "Access is denied", str(path))

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(UserError, match="is in use"):
        environment.engine_python()
    assert shortened(tmp_path, "0").run() == FAILED


def test_asking_for_the_engine_removes_nothing(tmp_path, monkeypatch):
    """Thousands of files were deleted while a panel was drawn, and the only engine that was left with them."""
    target = tmp_path / "environment"
    for folder in (target, target.with_name("environment-old")):
        folder.mkdir()
    monkeypatch.delenv(environment.VARIABLE, raising=False)
    monkeypatch.setattr(environment, "managed_environment", lambda: target)
    with pytest.raises(UserError, match="is not installed"):
        environment.engine_python()
    assert folders(tmp_path) == ["environment", "environment-old"]


def test_a_fault_in_the_middle_of_a_task_ends_it(tmp_path, monkeypatch):
    """It stayed at work for ever, and nothing else could be installed or checked."""
    task = shortened(tmp_path, "0")
    current_task.begin("install", task)
    monkeypatch.setattr(task, "drain", lambda: 1 / 0)
    assert current_task._tick() is None and not current_task.is_running()
    assert task.status == FAILED and "made a mistake" in task.text
    current_task.begin("install", task)
    current_task.end()  # as where the add-on is disabled
    assert current_task.current() == ("", None)
