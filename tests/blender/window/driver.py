# SPDX-License-Identifier: GPL-3.0-or-later
"""Drive a real Blender window under a virtual screen with real mouse and key events."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import time
from pathlib import Path

REPO = Path(__file__).resolve().parents[3]
WIDTH, HEIGHT = 1400, 900
TICK = 0.25  # seconds between two looks of helper.py


def engine_python(given: str) -> Path:
    """Return the Python that has the engine; a type of argparse.

    The add-on starts it without ``PYTHONPATH`` and outside of this folder, so that what is installed in it is what is
    tested: an editable installation of another checkout is refused.
    """
    python = Path(given).absolute()
    command = [python, "-I", "-c", "import mgf_engine; print(mgf_engine.__file__)"]
    found = subprocess.run(command, capture_output=True, text=True)
    if found.returncode:
        raise argparse.ArgumentTypeError(f"{python} has no engine")
    checkout = Path(found.stdout.strip()).parents[1]
    if checkout != REPO and (checkout / "pyproject.toml").is_file():
        raise argparse.ArgumentTypeError(f"{python} has the engine of {checkout}, these are the tests of {REPO}")
    return python


def holds(test, state: dict) -> bool:
    """Whether ``test(state)`` is true; a state that lacks what it asks for is not."""
    try:
        return bool(state and test(state))
    except (KeyError, IndexError, TypeError):
        return False


def open_with_addon(blender: str, out: Path, **environment: str) -> Window:
    """Open a Blender whose user has the add-on of this checkout installed and enabled; arguments of :class:`Window`."""
    addon = out / "user" / "extensions" / "user_default" / "mgf"
    shutil.rmtree(out / "user", ignore_errors=True)
    shutil.copytree(REPO / "mgf_blender", addon)
    shutil.copyfile(REPO / "blender_manifest.toml", addon / "blender_manifest.toml")
    window = Window(blender, out, **environment)
    window.tell('py bpy.ops.preferences.addon_enable(module="bl_ext.user_default.mgf")')
    return window


class Window:
    """A Blender as it comes, with settings of its own.

    Args:
        blender: the program.
        out: folder for screenshots, logs and the user's settings.
    """

    def __init__(self, blender: str, out: Path, **environment: str) -> None:
        self.out = out
        (out / "user").mkdir(parents=True, exist_ok=True)
        self.environment = {
            **os.environ, "BLENDER_USER_RESOURCES": str(out / "user"), "MGF_WINDOW_OUT": str(out),
            "LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe", **environment,
        }  # fmt: skip
        read, write = os.pipe()
        command = ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{WIDTH}x{HEIGHT}x24", "+extension", "GLX",
                   "-nolisten", "tcp", "-noreset"]  # fmt: skip
        with (out / "xvfb.log").open("w") as log:
            self.xvfb = subprocess.Popen(command, pass_fds=[write], stderr=log)
        os.close(write)
        with os.fdopen(read) as stream:
            self.environment["DISPLAY"] = ":" + stream.readline().strip()
        self.program = blender
        self.start()

    def start(self, blend: Path | None = None) -> None:
        """Start Blender, with a file when one is given, and wait for its window."""
        (self.out / "state.json").unlink(missing_ok=True)
        helper = Path(__file__).with_name("helper.py")
        command = [self.program, "-p", "0", "0", str(WIDTH), str(HEIGHT)]
        command += [str(blend)] if blend is not None else []
        with (self.out / "blender.log").open("a") as log:
            self.blender = subprocess.Popen(
                [*command, "--python", str(helper)], env=self.environment, stdout=log, stderr=subprocess.STDOUT
            )
        self.wait("the window", lambda s: s["size"][0] > 100, 300)

    def quit(self) -> None:
        """Ctrl Q over the main editor, as users leave; waits for the end."""
        self.move(400, 500)
        self._x("key", "ctrl+q")
        try:
            self.blender.wait(60)
        except subprocess.TimeoutExpired as error:
            self.shot("timeout")
            raise RuntimeError("Blender did not quit.") from error

    def begin(self) -> None:
        """Empty the scene and show our tab in the sidebar."""
        self.tell('py bpy.context.preferences.view.filebrowser_display_type = "SCREEN"')
        self.tell("py [bpy.data.objects.remove(o) for o in list(bpy.data.objects)]")
        self.tell('py bpy.ops.ed.undo_push(message="empty")')
        self.tell("editor VIEW_3D")
        self.wait("the sidebar", lambda s: s["regions"]["UI"][2] > 100)
        time.sleep(2)
        self.tell("tab")
        time.sleep(1)

    def state(self) -> dict:
        """What the helper last said."""
        try:
            return json.loads((self.out / "state.json").read_text())
        except (OSError, ValueError):
            return {}

    def wait(self, what: str, test, seconds: float = 120) -> dict:
        """Wait until ``test(state)`` holds; where a busy Blender comes round less often, up to five times as
        long."""
        begun, ticks = time.monotonic(), self.state().get("tick", 0)
        while (past := time.monotonic() - begun) < seconds or (
            past < 5 * seconds and self.state().get("tick", 0) - ticks < seconds / TICK / 2
        ):
            if self.blender.poll() is not None:
                raise RuntimeError(
                    f"Blender ended while waiting for {what}: {(self.out / 'blender.log').read_text()[-2000:]}"
                )
            state = self.state()
            if holds(test, state):
                return state
            time.sleep(0.2)
        self.shot("timeout")
        raise RuntimeError(f"waited in vain for {what}: {json.dumps(self.state())[:3000]}")

    def tell(self, text: str) -> None:
        """Send the helper a command and wait until it was obeyed."""
        (self.out / "cmd.tmp").write_text(text)
        (self.out / "cmd.tmp").replace(self.out / "cmd")
        end = time.monotonic() + 300
        while (self.out / "cmd").exists():
            if time.monotonic() > end:
                raise RuntimeError(f"Blender did not obey: {text}")
            time.sleep(0.1)
        self.settle(3)

    def settle(self, ticks: int = 2) -> None:
        """Wait until Blender has gone through its event loop a few times, however busy the machine is."""
        begun, end = self.state().get("tick", 0), time.monotonic() + 60
        while self.state().get("tick", 0) < begun + ticks and time.monotonic() < end and self.blender.poll() is None:
            time.sleep(0.05)

    def press(self, place: tuple[float, float], what: str, test, seconds: float = 15) -> dict:
        """Click until ``test(state)`` holds, three times at most, as a user does whose click was not taken."""
        for _ in range(2):
            self.click(*place)
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                state = self.state()
                if holds(test, state):
                    return state
                time.sleep(0.2)
        self.click(*place)
        return self.wait(what, test, 2 * seconds)

    def _x(self, *arguments: object) -> None:
        subprocess.run(["xdotool", *map(str, arguments)], env=self.environment, check=True)

    def move(self, x: float, y: float) -> None:
        """Pointer to a place counted from the top left; Blender needs to see it arrive before a click."""
        self._x("mousemove", round(x) - 3, round(y))
        time.sleep(0.3)
        self._x("mousemove", round(x), round(y))
        time.sleep(0.2)
        self.settle(1)

    def click(self, x: float, y: float, button: int = 1, hold: str = "") -> None:
        """A real click, with a modifier key held when ``hold`` names one."""
        self.move(x, y)
        if hold:
            self._x("keydown", hold)
            time.sleep(0.2)
        self._x("mousedown", button)
        time.sleep(0.15)
        self._x("mouseup", button)
        time.sleep(0.2)
        if hold:
            self.settle()  # Blender asks for the keys that are down when it comes to the click
            self._x("keyup", hold)
        self.settle()

    def drag(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Press, move in steps, release."""
        self.move(x0, y0)
        self._x("mousedown", 1)
        self.settle()  # or a busy Blender sees the press where the pointer is by then
        for i in range(1, 6):
            self._x("mousemove", round(x0 + (x1 - x0) * i / 5), round(y0 + (y1 - y0) * i / 5))
            time.sleep(0.15)
        self.settle()
        self._x("mouseup", 1)
        self.settle()

    def drag_file(self, x0: float, y0: float, x1: float, y1: float, shot: str) -> None:
        """Drag a file out of a File Browser by small steps, or Blender does not pick it up; shows what it says."""
        self.move(x0, y0)
        self._x("mousedown", 1)
        time.sleep(0.4)
        for i in range(1, 31):
            self._x("mousemove", round(x0 - 4 * i), round(y0))
            time.sleep(0.05)
        for i in range(1, 21):
            self._x("mousemove", round(x0 - 120 + (x1 - x0 + 120) * i / 20), round(y0 + (y1 - y0) * i / 20))
            time.sleep(0.05)
        time.sleep(0.5)
        self.shot(shot)
        self._x("mouseup", 1)
        time.sleep(0.5)

    def type(self, text: str) -> None:
        """Type into the field that has the cursor, in place of what it holds."""
        self.key("ctrl+a")
        self._x("type", "--delay", 25, text)
        self.key("Return")

    def choose_file(self, path: str) -> None:
        """Type a path into the file browser and confirm; a folder ends in a slash."""
        self.wait("the file browser", lambda s: s["browser"], 30)
        self.settle(4)
        for _ in range(2):
            self.click(0.47 * WIDTH, 49)
        self.type(path)
        time.sleep(1.0)
        self.shot_if("file-browser")
        self.press((WIDTH - 72, HEIGHT - 44), "the file browser to close", lambda s: not s["browser"])

    def key(self, *names: str) -> None:
        """Press keys, for example ``ctrl+z``."""
        self._x("key", *names)
        self.settle()

    def shot_if(self, name: str) -> None:
        """A screenshot that is taken once."""
        if not (self.out / f"{name}.png").exists():
            self.shot(name)

    def shot(self, name: str) -> None:
        """Screenshot of the whole screen."""
        subprocess.run(["import", "-window", "root", str(self.out / f"{name}.png")], env=self.environment, check=False)

    def region(self, kind: str) -> tuple[int, int, int, int]:
        """A region of the main editor as x, y (from the top), width, height."""
        x, y, w, h = self.state()["regions"][kind]
        return x, HEIGHT - y - h, w, h

    def button(self, down: float, across: float = 0.5) -> tuple[float, float]:
        """A place in the sidebar, ``down`` pixels below its top."""
        x, y, w, _ = self.region("UI")
        return x + (w - 20) * across, y + down

    def image_point(self, u: float, v: float) -> tuple[float, float]:
        """Where the share (u, v) of the shown image is on the screen."""
        x0, y0, x1, y1 = self.state()["image_px"]
        return x0 + u * (x1 - x0), HEIGHT - 1 - (y0 + v * (y1 - y0))

    def close(self) -> None:
        """End Blender and the screen."""
        for process in (self.blender, self.xvfb):
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
