# SPDX-License-Identifier: GPL-3.0-or-later
"""Find the Python that runs the engine, and make command lines for it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import bpy

from ..common.addon import preferences, user_folder
from ..common.errors import UserError
from ..common.text import tr
from .current_task import installing
from .swap import recover, unfinished

#: Overrides the preferences; for scripts and continuous integration.
VARIABLE = "MGF_ENGINE_PYTHON"


def python_of(environment: Path) -> Path:
    """Return the interpreter of a virtual environment; a path to an interpreter is returned as it is."""
    if environment.is_file():
        return environment
    return environment / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


def managed_environment() -> Path:
    """Return the virtual environment that *Install Engine* makes.

    On Windows not below Blender's own folder: with that one's length, paths of torch pass what Windows allows.
    """
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA")
        return (Path(base) if base else Path.home() / "AppData" / "Local") / "mgf" / "engine"
    return user_folder() / "engine"


def engine_python() -> Path:
    """Return the Python that has the engine.

    Raises:
        UserError: none is installed or chosen, or it is gone.
    """
    if os.environ.get(VARIABLE):
        return _existing(Path(os.environ[VARIABLE]), tr("the variable {name}", name=VARIABLE))
    prefs = preferences()
    if prefs is not None and prefs.engine_source == "EXISTING":
        if not prefs.engine_path:
            raise UserError("No environment is chosen; set its folder in the preferences of the add-on.")
        return _existing(Path(bpy.path.abspath(prefs.engine_path)), tr("the preferences"))
    python = python_of(managed_environment())
    if not python.is_file():
        recover(managed_environment())
    if not python.is_file():
        if installing():
            raise UserError("The engine is being installed; wait until that has ended.")
        if unfinished(managed_environment()).exists():
            raise UserError(
                "The engine's installation was interrupted; press Install Engine in the preferences to repeat it."
            )
        raise UserError("The engine is not installed; press Install Engine in the preferences of the add-on.")
    return python


def engine_command(*arguments: str) -> list[str]:
    """Return the command line that runs the engine with these arguments."""
    return [str(engine_python()), "-m", "mgf_engine", *arguments]


def _existing(path: Path, where: str) -> Path:
    python = python_of(path)
    if not python.is_file():
        raise UserError(
            "There is no Python in '{path}'; correct the environment given by {where}.", path=path, where=where
        )
    return python
