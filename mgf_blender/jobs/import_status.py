# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of results: the scenes in which one is under way, and why the last one failed, for panels to say."""

import bpy

from ..common.text import draw_sentence, tr
from ..scene_keys import key_of

_under_way: set[str] = set()  # scene keys
_problems: dict[str, str] = {}  # scene key -> why the last import failed


def begin(key: str) -> None:
    """Note that an import into the scene with this key has begun."""
    _problems.pop(key, None)
    _under_way.add(key)


def end(key: str, problem: str = "") -> None:
    """Note that it is over, and why it failed, if it did."""
    _under_way.discard(key)
    if problem:
        _problems[key] = problem


def under_way(scene: bpy.types.Scene) -> bool:
    """Tell whether results are being imported into a scene."""
    return key_of(scene) in _under_way


def problem(scene: bpy.types.Scene) -> str:
    """Return why the last import into a scene failed, or an empty text."""
    return _problems.get(key_of(scene), "")


def clear() -> None:
    """Forget all imports."""
    _under_way.clear()
    _problems.clear()


def draw_waiting(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw the state of an import that is not part of a job shown elsewhere."""
    if under_way(scene):
        draw_sentence(layout, tr("Importing the results"), "SORTTIME")
    elif problem(scene):
        draw_sentence(layout, problem(scene), "ERROR")
