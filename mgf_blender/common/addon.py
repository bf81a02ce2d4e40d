# SPDX-License-Identifier: GPL-3.0-or-later
"""Name and preferences of the add-on, and the folder that it may write to."""

from __future__ import annotations

from pathlib import Path

import bpy

#: The add-on's module, for example ``bl_ext.user_default.mgf``.
NAME = __package__.rpartition(".")[0]


def preferences() -> bpy.types.AddonPreferences | None:
    """Return the add-on's preferences; None when it runs without being enabled (batch runs from a checkout)."""
    addon = bpy.context.preferences.addons.get(NAME)
    return addon.preferences if addon is not None else None


def user_folder() -> Path:
    """Return the folder for what the add-on keeps between versions: the engine's environment and its logs."""
    try:
        return Path(bpy.utils.extension_path_user(NAME, path="", create=True))
    except ValueError:  # not installed as an extension
        return Path(bpy.utils.user_resource("DATAFILES", path="mgf", create=True))


def carried_folder() -> Path:
    """Return the folder with the engine's wheel and constraints that the extension carries."""
    return Path(__file__).resolve().parents[1] / "wheelhouse"
