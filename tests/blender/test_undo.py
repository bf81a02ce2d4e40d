# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo after every step of the workflow; in a process of its own, because what goes wrong here ends Blender."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

REPO = Path(__file__).resolve().parents[2]
_CHILD = """
import os, sys
from pathlib import Path
sys.path[:0] = sys.argv[1:3]
import bpy, synthetic
import mgf_blender
from mgf_blender.scene_import.crop import find_crop_box
from mgf_blender.scene_import.tree import KINDS, Tree
house = synthetic.write_house(Path(sys.argv[3]) / "house")
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.preferences.edit.use_global_undo = True
mgf_blender.register()
bpy.ops.ed.undo_push(message="start")

def drawn():
    tree = Tree.find(bpy.context.scene)
    find_crop_box(tree)
    return None if tree is None else [len(tree.objects(kind)) for kind in KINDS]

steps = {
    "scene": lambda: bpy.ops.mgf.import_colmap("EXEC_DEFAULT", True, filepath=str(house.folder)),
    "again": lambda: bpy.ops.mgf.reload_scene("EXEC_DEFAULT", True),
    "result": lambda: bpy.ops.mgf.import_result("EXEC_DEFAULT", True, directory=str(house.job)),
    "crop": lambda: bpy.ops.mgf.add_crop_box("EXEC_DEFAULT", True),
}
states = [drawn()]
for name in sys.argv[4:]:
    steps[name]()
    states.append(drawn())
for _ in range(3):
    for state in reversed(states[:-1]):
        bpy.ops.ed.undo()
        assert drawn() == state, (drawn(), state)
    for state in states[1:]:
        bpy.ops.ed.redo()
        assert drawn() == state, (drawn(), state)
print("survived", flush=True)
os._exit(0)
"""


@pytest.mark.parametrize("steps", ["scene result", "scene result result", "scene again result", "scene crop result"])
def test_undo_of_every_step(steps, tmp_path):
    command = [sys.executable, "-c", _CHILD, str(REPO), str(REPO / "tests" / "blender"), str(tmp_path), *steps.split()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "survived" in done.stdout, done.stdout + done.stderr


def test_a_list_that_is_stale_after_undo_is_never_read():
    """``Collection.all_objects`` holds freed objects after an undo, in Blender 4.2 to 5.2."""
    readers = [p for p in (REPO / "mgf_blender").rglob("*.py") if re.search(r"\ball_objects\b", p.read_text("utf-8"))]
    assert not readers
