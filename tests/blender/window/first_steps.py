# SPDX-License-Identifier: GPL-3.0-or-later
"""The first steps by mouse: install the extension from disk, and give it an engine."""

from __future__ import annotations

import time
from pathlib import Path

from driver import Window

# Places in the preferences at interface scale 1, pixels from the top left of a window of 1400 x 900.
#: Get Extensions and Add-ons, which 5.x has lower, by the major version.
_SECTIONS = {4: ((57, 217), (41, 252)), 5: ((57, 249), (41, 283))}
_MENU, _FROM_DISK = (1137, 72), (1207, 195)
_SEARCH, _UNFOLD = (400, 72), (188, 108)
_HERE, _EXISTING = (700, 327), (1000, 327)
_PATH, _CHECK_EXISTING = (820, 356), (650, 386)
_WHEELS, _INSTALL = (820, 380), (650, 507)


def install_extension(window: Window, zip_file: Path) -> None:
    """Preferences > Get Extensions > Install from Disk; the add-on is enabled on install."""
    window.tell("editor PREFERENCES")
    time.sleep(1.5)
    extensions, addons = _SECTIONS[window.state()["version"][0]]
    window.click(*extensions)
    window.click(*_MENU)
    window.settle(4)
    window.shot("01-install-from-disk")
    window.press(_FROM_DISK, "the file browser", lambda s: s["browser"])
    window.choose_file(str(zip_file))
    window.wait("the add-on", lambda s: any(m.endswith(".mgf") for m in s["addons"]), 30)
    window.click(*addons)
    window.click(*_SEARCH)
    window.type("MGF")
    window.click(*_UNFOLD)
    time.sleep(1.0)


def install_engine(window: Window, wheels: Path) -> None:
    """Install Engine from a folder of wheels, without network."""
    for _ in range(2):
        window.click(*_WHEELS)
    window.type(str(wheels))
    window.shot("02-preferences")
    window.click(*_INSTALL)
    window.shot("03-confirm")
    window.key("Return")
    window.wait("the installation", lambda s: s["task"][0] == "RUNNING", 20)
    time.sleep(6)
    window.shot("04-installing")
    state = window.wait("the engine", lambda s: s["task"][0] in ("DONE", "FAILED"), 900)
    _settled(window, state, "05-engine")


def use_environment(window: Window, python: Path) -> None:
    """Existing Environment, its path, Check Engine."""
    window.click(*_EXISTING)
    for _ in range(2):
        window.click(*_PATH)
    window.type(str(python))
    window.press(_CHECK_EXISTING, "a check", lambda s: s["task"])
    state = window.wait("the check", lambda s: s["task"] and s["task"][0] in ("DONE", "FAILED"), 60)
    _settled(window, state, "05-engine")


def _settled(window: Window, state: dict, name: str) -> None:
    window.move(300, 800)
    for _ in range(12):
        window._x("click", 5)  # the wheel, to the end of what Check Engine says
    time.sleep(1.0)
    window.shot(name)
    assert state["task"][0] == "DONE", state["task"]
