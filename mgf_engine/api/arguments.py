# SPDX-License-Identifier: GPL-3.0-or-later
"""Types and conversions of the arguments that all functions of the interface share."""

from __future__ import annotations

import os
from pathlib import Path

from mgf_engine.messages import Reporter, Sink

PathLike = str | os.PathLike[str]


def make_reporter(on_message: Sink | None) -> Reporter:
    """Make a reporter that calls a function with each message; None reports to nobody."""
    return Reporter() if on_message is None else Reporter(on_message)


def optional_path(path: PathLike | None) -> Path | None:
    """Convert a path that may be a string; None stays None."""
    return None if path is None else Path(path)
