# SPDX-License-Identifier: GPL-3.0-or-later
"""Import Photos by mouse, in a real window: from a folder of photos alone to the mesh of the building.

    PYTHONPATH=tests:tests/blender python tests/blender/window/photos.py --blender BLENDER --engine PYTHON \
        --scene FOLDER --out shots

Needs what ``run.py`` needs. The photos lie in a folder with blanks in its name. The engine has to find
their cameras, the import has to show them and their photos, and undo and redo have to keep both; then a job with the
preset *Quick* brings the mesh. Screenshots are left in --out.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from driver import Window, engine_python, open_with_addon

PREFERENCES = "bpy.context.preferences.addons['bl_ext.user_default.mgf'].preferences"
PHOTOS = 50  # Import Photos, pixels below the top of the sidebar


def main() -> int:
    """Every step; returns the exit code."""
    parser = argparse.ArgumentParser(description="Import photos without a model in a real Blender.")
    parser.add_argument("--blender", required=True)
    parser.add_argument("--engine", type=engine_python, required=True, help="Python that has the engine")
    parser.add_argument("--scene", type=Path, required=True, help="scene folder with images and prompts.json")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    out = args.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    photos = out / "house by the lake"  # xdotool types no letters beyond ASCII into Blender
    shutil.copytree(args.scene / "images", photos)
    count = sum(1 for _ in photos.iterdir())
    window = open_with_addon(args.blender, out)
    try:
        window.tell(f"py p = {PREFERENCES}; p.engine_source, p.engine_path = 'EXISTING', {str(args.engine)!r}")
        window.begin()
        import_photos(window, photos, count)
        reconstruct(window, args.scene / "prompts.json")
    finally:
        window.close()
    return 0


def import_photos(window: Window, photos: Path, count: int) -> None:
    """The button, the folder in the File Browser, the engine's job; cameras and photos arrive."""
    window.press(window.button(PHOTOS), "the file browser", lambda s: s["browser"])
    window.choose_file(f"{photos}/")
    window.wait("the job", lambda s: s["jobs"], 30)
    time.sleep(4)
    window.shot("1-finding-cameras")
    state = window.wait("the end", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 1800)
    assert state["jobs"][-1][1] == "DONE", state["jobs"][-1]
    state = window.wait("the cameras", lambda s: s["objects"]["Cameras"] > 2)
    assert Path(state["source"]) == photos, state["source"]
    assert state["photos"], "no photo is proposed to be marked"
    time.sleep(2)
    window.shot("2-cameras")
    cameras = state["objects"]["Cameras"]
    for keys, left in (("ctrl+z", 0), ("ctrl+shift+z", cameras)):
        window.move(400, 500)
        window.key(keys)
        window.wait(f"{left} cameras after {keys}", lambda s, left=left: s["objects"]["Cameras"] == left, 30)
    print(f"{cameras} of {count} cameras found and imported, undone and redone", flush=True)


def reconstruct(window: Window, prompts: Path) -> None:
    """Clicks from a file, then the panel's own button; the mesh arrives beside the cameras."""
    window.tell(f"py bpy.ops.mgf.import_prompts('EXEC_DEFAULT', True, filepath={str(prompts)!r})")
    window.tell("py window.scene.mgf.options.preset = 'quick'")
    window.tell("py bpy.ops.mgf.reconstruct('INVOKE_DEFAULT')")
    window.wait("the second job", lambda s: len(s["jobs"]) == 2 or s["jobs"][-1][0] == "reconstruct", 30)
    state = window.wait("the end", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 1800)
    assert state["jobs"][-1][1] == "DONE", state["jobs"][-1]
    window.wait("the mesh", lambda s: s["objects"]["Mesh"] == 1, 120)
    time.sleep(3)
    window.shot("3-mesh")
    print("the mesh is in the scene", flush=True)


if __name__ == "__main__":
    sys.exit(main())
