# SPDX-License-Identifier: GPL-3.0-or-later
r"""What goes wrong for people, in a real window: no engine, photos gone or damaged, a full disk, a killed engine.

    PYTHONPATH=tests:tests/blender python tests/blender/window/faults.py --blender BLENDER --engine PYTHON \
        --scene FOLDER --out shots

Needs what ``run.py`` needs, and root for a disk of half a megabyte. Each fault has to end in one sentence in the panel
while Blender goes on, and the job has to come to its end once the fault is mended. Screenshots are left in --out.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from driver import Window, engine_python, open_with_addon

OPTIONS = {"preset": "quick", "resolution": 160}
PREFERENCES = "bpy.context.preferences.addons['bl_ext.user_default.mgf'].preferences"
DISK = 600  # kB of the full disk: enough to begin, not to end
BAR = 473  # of the progress, pixels below the top of the sidebar


def main() -> int:
    """Every fault; returns the exit code."""
    parser = argparse.ArgumentParser(description="Show in a real Blender what is said when things go wrong.")
    parser.add_argument("--blender", required=True)
    parser.add_argument("--engine", type=engine_python, required=True, help="Python that has the engine")
    parser.add_argument("--scene", type=Path, required=True, help="scene folder with images, sparse and prompts.json")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    out = args.out.absolute()
    disk = out / "disk"
    subprocess.run(["umount", "-l", disk], stderr=subprocess.DEVNULL)  # of a run that was killed
    shutil.rmtree(out, ignore_errors=True)
    scene = out / "house"
    for name in ("images", "sparse"):
        shutil.copytree(args.scene / name, scene / name)
    disk.mkdir()
    mount("-t", "tmpfs", "-o", f"size={DISK}k", "tmpfs", disk)  # before Blender, which may run in mounts of its own
    window = open_with_addon(args.blender, out)
    try:
        begin(window, scene, args.scene / "prompts.json")
        no_engine(window)
        wrong_engine(window, out)
        window.tell(f"py p = {PREFERENCES}; p.engine_source, p.engine_path = 'EXISTING', {str(args.engine)!r}")
        photos(window, scene)
        full_disk(window, disk)
        killed(window, out / "job")
        bar_leaves_nothing(window, out / "again")
    finally:
        window.close()
        subprocess.run(["umount", "-l", disk], check=True)
    return 0


def mount(*arguments: object) -> None:
    """Call mount."""
    subprocess.run(["mount", *map(str, arguments)], check=True)


def begin(window: Window, scene: Path, prompts: Path) -> None:
    """Import the scene and its clicks, with our tab in the sidebar."""
    window.tell("py [bpy.data.objects.remove(o) for o in list(bpy.data.objects)]")
    window.tell(f"py bpy.ops.mgf.import_colmap('EXEC_DEFAULT', True, filepath={str(scene)!r})")
    window.tell(f"py bpy.ops.mgf.import_prompts('EXEC_DEFAULT', True, filepath={str(prompts)!r})")
    for name, value in OPTIONS.items():
        window.tell(f"py window.scene.mgf.options.{name} = {value!r}")
    window.tell("editor VIEW_3D")
    window.wait("the sidebar", lambda s: s["regions"]["UI"][2] > 100)
    time.sleep(2)
    window.tell("tab")
    time.sleep(1)


def no_engine(window: Window) -> None:
    """A fresh installation: the panel says that there is no engine, and its button leads to where one is made."""
    window.settle(3)
    window.shot("1-no-engine")
    window.tell("py bpy.ops.mgf.show_preferences('INVOKE_DEFAULT')")
    window.wait("the preferences", lambda s: s["windows"] == 2)
    time.sleep(3)
    window.shot("1-preferences")
    window.tell(
        "py w = bpy.context.window_manager.windows[1]; c = bpy.context.temp_override(window=w); c.__enter__();"
        "bpy.ops.wm.window_close(); c.__exit__(None, None, None)"
    )
    window.wait("one window", lambda s: s["windows"] == 1)


def wrong_engine(window: Window, out: Path) -> None:
    """A Python without the engine: the job ends at once, and the sentence says what is missing."""
    python = out / "python"
    python.symlink_to(shutil.which("python3", path="/usr/bin:/bin") or sys.executable)
    window.tell(f"py p = {PREFERENCES}; p.engine_source, p.engine_path = 'EXISTING', {str(python)!r}")
    fails(window, "2-wrong-engine", out / "job", "engine")


def photos(window: Window, scene: Path) -> None:
    """Most photos gone; most of them cut off."""
    names = sorted((scene / "images").iterdir())
    most = names[: len(names) // 2 + 1]
    (elsewhere := scene.parent / "elsewhere").mkdir()  # below the scene they would be found
    away = {path: path.rename(elsewhere / path.name) for path in most}
    fails(window, "3-photos-gone", scene.parent / "job", f"{len(most)} of {len(names)} photos")
    for path, place in away.items():
        place.rename(path)
    whole = {path: path.read_bytes() for path in most}
    for path, content in whole.items():
        path.write_bytes(content[: len(content) // 2])
    fails(window, "4-photos-cut", scene.parent / "job", f"{len(most)} of {len(names)} photos")
    for path, content in whole.items():
        path.write_bytes(content)


def full_disk(window: Window, disk: Path) -> None:
    """A disk that fills while the job works; with room again, Resume brings it to its end."""
    fails(window, "5-full-disk", disk / "job", "space")
    mount("-o", "remount,size=500m", disk)
    window.tell("py bpy.ops.mgf.resume('INVOKE_DEFAULT')")
    ends(window, "6-room-again", "DONE")


def killed(window: Window, job: Path) -> None:
    """The engine is killed in the middle, as by a system without memory; Resume goes on."""
    start(window, job)
    state = window.wait("the masks", lambda s: s["jobs"][-1][2] == "masks", 300)
    os.kill(state["pids"][-1], signal.SIGKILL)
    ends(window, "7-killed", "FAILED")
    window.tell("py bpy.ops.mgf.resume('INVOKE_DEFAULT')")
    ends(window, "8-resumed", "DONE")


def bar_leaves_nothing(window: Window, job: Path) -> None:
    """The pointer rests on the progress bar until the job has ended: then the panel looks as it does without it."""
    start(window, job)
    window.move(*window.button(BAR))
    window.shot("9-on-the-bar")
    state = window.wait("the end", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 900)
    assert state["jobs"][-1][1] == "DONE", state["jobs"][-1]
    window.wait("the mesh", lambda s: s["objects"]["Mesh"] and not s["importing"], 60)
    time.sleep(2)
    window.shot("9-end")
    window.move(300, 600)
    time.sleep(2)
    window.shot("9-away")
    x, y, w, h = window.region("UI")
    cut = ["-crop", f"{w - 22}x{h - 2}+{x}+{y}", "+repage"]
    panels = [part for name in ("9-end", "9-away") for part in ("(", window.out / f"{name}.png", *cut, ")")]
    compare = ["compare", "-metric", "AE", "-fuzz", "2%", *panels, "null:"]
    said = subprocess.run(list(map(str, compare)), capture_output=True, text=True)
    assert said.returncode == 0, f"{said.stderr} pixels of the panel differ"
    print("nothing is left of the progress bar that the pointer lay on", flush=True)


def start(window: Window, job: Path) -> None:
    """Press Reconstruct Building for a job folder."""
    count = len(window.state()["jobs"])
    window.tell(f"py window.scene.mgf.job_folder = {str(job)!r}; bpy.ops.mgf.reconstruct('INVOKE_DEFAULT', True)")
    window.wait("the job", lambda s: len(s["jobs"]) > count)


def fails(window: Window, name: str, job: Path, part: str) -> None:
    """Start a job that has to fail with a sentence that holds ``part``."""
    start(window, job)
    text = ends(window, name, "FAILED")
    assert part in text, text


def ends(window: Window, name: str, status: str) -> str:
    """Wait until the job ends like that; returns what the panel says of it."""
    time.sleep(0.5)
    state = window.wait("the end", lambda s: s["jobs"][-1][1] in ("DONE", "FAILED"), 900)
    window.move(300, 600)
    time.sleep(2)
    window.shot(name)
    job = state["jobs"][-1]
    print(f"{name}: {job[1]} {job[4]}", flush=True)
    assert job[1] == status, job
    return str(job[4])


if __name__ == "__main__":
    sys.exit(main())
