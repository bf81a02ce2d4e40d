# SPDX-License-Identifier: GPL-3.0-or-later
"""What a command leaves on a terminal where it has shown a bar."""

from __future__ import annotations

import pytest

HIDE, SHOW = "\x1b[?25l", "\x1b[?25h"


def live_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have rich draw its bars as on a terminal, whatever standard error is."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")


def bar_ended(written: str) -> bool:
    """Whether a bar was shown, and the cursor that it hides is back."""
    return HIDE in written and written.rfind(SHOW) > written.rfind(HIDE)
