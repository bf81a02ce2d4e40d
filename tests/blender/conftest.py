# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests that run inside Blender's Python module: ``.venv-bpy/bin/python -m pytest tests/blender``."""

from __future__ import annotations

import os
import shutil
import sys
from collections import namedtuple
from pathlib import Path

import pytest

REPO = Path(__file__).resolve().parents[2]
try:
    import bpy
except ImportError:
    bpy = None
else:
    for entry in (str(REPO), str(Path(__file__).parent)):
        if entry not in sys.path:
            sys.path.insert(0, entry)


def pytest_ignore_collect(collection_path):
    # Without bpy only test_environment.py is collected; it skips and says why.
    if bpy is None and collection_path.name.startswith("test_") and collection_path.name != "test_environment.py":
        return True
    return None


def pytest_sessionfinish(session, exitstatus):
    session.config._mgf_status = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    # Some versions of the bpy module crash or hang while the interpreter ends; leave at once with the right status.
    status = getattr(config, "_mgf_status", None)
    if status is not None and "bpy" in sys.modules:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


@pytest.fixture
def scene():
    """The scene of an empty file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.use_global_undo = True
    return bpy.context.scene


@pytest.fixture
def house(tmp_path):
    """A small synthetic scene on disk, see :mod:`synthetic`."""
    import synthetic

    return synthetic.write_house(tmp_path / "Häuser am Fluß")


@pytest.fixture
def addon(scene, monkeypatch):
    """The add-on, registered for one test; yields the scene's state."""
    import mgf_blender

    mgf_blender.register()
    try:
        yield bpy.context.scene.mgf
    finally:
        mgf_blender.unregister()


@pytest.fixture
def engine(tmp_path, monkeypatch):
    """A Python whose ``-m mgf_engine`` is the test double; call it with a mode to change how it behaves."""
    from jobs import write_engine  # which needs bpy

    python = write_engine(tmp_path / "engine home")
    monkeypatch.setenv("MGF_ENGINE_PYTHON", str(python))

    def behave(mode: str, **variables: object) -> None:
        monkeypatch.setenv("FAKE_ENGINE", mode)
        for name, value in variables.items():
            monkeypatch.setenv(name, str(value))

    behave("ok")
    return behave


@pytest.fixture
def ready(addon, engine, house):
    """An imported house with one click, and an engine whose result is the finished job."""
    engine("ok", FAKE_RESULT=house.job)
    bpy.ops.mgf.import_colmap(filepath=str(house.folder))
    addon.job_folder = str(house.folder.parent / "new job")
    click = addon.photos[0].clicks.add()
    click.uv = (100.5, 80.25)
    return addon


@pytest.fixture
def free_space(monkeypatch):
    """Disks with 64 GB free, whatever this machine has left; call it with another number of bytes."""
    usage = namedtuple("usage", "total used free")

    def set_free(free: int) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(1 << 40, (1 << 40) - free, free))

    set_free(64 << 30)
    return set_free
