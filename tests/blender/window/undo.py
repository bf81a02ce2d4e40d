# SPDX-License-Identifier: GPL-3.0-or-later
"""Ctrl+Z three times after every step of the workflow, in a real window with our tab open; needs no engine.

    PYTHONPATH=tests:tests/blender python tests/blender/window/undo.py --blender BLENDER --out shots

Needs what ``run.py`` needs. The scene is the small synthetic house and its finished job. Exits with 0 only when Blender
is still there and, after as many redos, has the same objects as before.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
import synthetic
from driver import Window, open_with_addon


def main() -> int:
    """Every step; returns the exit code."""
    parser = argparse.ArgumentParser(description="Press Ctrl+Z after every step in a real Blender.")
    parser.add_argument("--blender", required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    out = args.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    house = synthetic.write_house(out / "house")
    window = open_with_addon(args.blender, out)
    try:
        window.begin()
        for name, command, test in steps(house):
            before = window.state()["meshes"]
            window.tell(command)
            window.wait(name, lambda s, test=test, before=before: test(s, before), 60)
            time.sleep(1)
            undo_thrice(window, name)
        window.shot("end")
    finally:
        window.close()
    return 0


def steps(house: synthetic.House) -> list[tuple]:
    """What is done, how, and what shows that it was: a test of the state and of the meshes that were there before."""
    has = lambda kind, count: lambda s, _: s["objects"][kind] == count and not s["browser"]  # noqa: E731
    arrived = lambda s, before: has("Mesh", 1)(s, before) and s["meshes"] != before and not s["importing"]  # noqa: E731
    result = f'py bpy.ops.mgf.import_result("INVOKE_DEFAULT", True, directory={str(house.job)!r})'
    plain = "py bpy.ops.mgf.{}('EXEC_DEFAULT', True{})"
    return [
        ("import of the scene", plain.format("import_colmap", f", filepath={str(house.folder)!r}"), has("Cameras", 12)),
        ("the result", result, arrived),
        ("the result once more", result, arrived),
        ("import again", plain.format("reload_scene", ""), has("Cameras", 12)),
        ("the result after it", result, arrived),
        ("a crop box", plain.format("add_crop_box", ""), lambda s, _: s["crop"] == 1),
        ("a camera", plain.format("look_through", ", step=3"), has("Mesh", 1)),
        ("its render", plain.format("show_in_camera", ", kind='PHOTO'"), lambda s, _: s["camera"] == "PHOTO"),
        ("the up axis", plain.format("set_up_axis", ", axis='X'"), has("Mesh", 1)),
    ]


def undo_thrice(window: Window, name: str) -> None:
    """Ctrl+Z three times and back again; Blender lives, draws, and has the same objects."""
    before = window.state()
    for keys in ("ctrl+z", "ctrl+shift+z"):
        window.move(400, 500)
        for _ in range(3):
            window.key(keys)
            window.settle(2)
    same = lambda s: s["objects"] == before["objects"] and s["crop"] == before["crop"]  # noqa: E731
    window.wait(f"{name}, after undo and redo", same, 30)
    print(f"{name}: undone and redone three times", flush=True)


if __name__ == "__main__":
    sys.exit(main())
