# SPDX-License-Identifier: GPL-3.0-or-later
"""Drive a real Blender window under a virtual screen with real mouse and key events."""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path

WIDTH, HEIGHT = 1400, 900


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
        helper = Path(__file__).with_name("helper.py")
        with (out / "blender.log").open("w") as log:
            command = [blender, "-p", "0", "0", str(WIDTH), str(HEIGHT), "--python", str(helper)]
            self.blender = subprocess.Popen(command, env=self.environment, stdout=log, stderr=subprocess.STDOUT)

    def state(self) -> dict:
        """What the helper last said."""
        try:
            return json.loads((self.out / "state.json").read_text())
        except (OSError, ValueError):
            return {}

    def wait(self, what: str, test, seconds: float = 120) -> dict:
        """Wait until ``test(state)`` holds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.blender.poll() is not None:
                raise RuntimeError(
                    f"Blender ended while waiting for {what}: {(self.out / 'blender.log').read_text()[-2000:]}"
                )
            state = self.state()
            try:
                if state and test(state):
                    return state
            except (KeyError, IndexError, TypeError):
                pass
            time.sleep(0.2)
        self.shot("timeout")
        raise RuntimeError(f"waited in vain for {what}: {json.dumps(self.state())[:3000]}")

    def tell(self, text: str) -> None:
        """Send the helper a command and wait until it was obeyed."""
        (self.out / "cmd.tmp").write_text(text)
        (self.out / "cmd.tmp").replace(self.out / "cmd")
        end = time.monotonic() + 60
        while (self.out / "cmd").exists() and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(1.2)

    def _x(self, *arguments: object) -> None:
        subprocess.run(["xdotool", *map(str, arguments)], env=self.environment, check=True)

    def move(self, x: float, y: float) -> None:
        """Pointer to a place counted from the top left; Blender needs to see it arrive before a click."""
        self._x("mousemove", round(x) - 3, round(y))
        time.sleep(0.3)
        self._x("mousemove", round(x), round(y))
        time.sleep(0.5)

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
            self._x("keyup", hold)
        time.sleep(0.6)

    def drag(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Press, move in steps, release."""
        self.move(x0, y0)
        self._x("mousedown", 1)
        time.sleep(0.3)
        for i in range(1, 6):
            self._x("mousemove", round(x0 + (x1 - x0) * i / 5), round(y0 + (y1 - y0) * i / 5))
            time.sleep(0.15)
        self._x("mouseup", 1)
        time.sleep(0.6)

    def type(self, text: str) -> None:
        """Type into the field that has the cursor, in place of what it holds."""
        self.key("ctrl+a")
        self._x("type", "--delay", 25, text)
        self.key("Return")

    def choose_file(self, path: str) -> None:
        """Type a path into the file browser and confirm; a folder ends in a slash."""
        time.sleep(2.0)
        for _ in range(2):
            self.click(0.47 * WIDTH, 49)
        self.type(path)
        time.sleep(1.0)
        self.shot_if("file-browser")
        self.click(WIDTH - 72, HEIGHT - 44)

    def key(self, *names: str) -> None:
        """Press keys, for example ``ctrl+z``."""
        self._x("key", *names)
        time.sleep(0.8)

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
        return x0 + u * (x1 - x0), HEIGHT - (y0 + v * (y1 - y0))

    def close(self) -> None:
        """End Blender and the screen."""
        for process in (self.blender, self.xvfb):
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
