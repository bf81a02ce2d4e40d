# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights that sheets mark beside an upright drawing."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mgf_engine.drawings.ground import TERRAIN, GroundLevel
from mgf_engine.drawings.model import DrawingFrame
from mgf_engine.drawings.work import DrawingOptions, Work
from mgf_engine.jobs.output_folder import Cost
from mgf_engine.messages import Reporter
from mgf_engine.options.config import make_config


def test_heights_have_one_sign() -> None:
    """Eaves of a roof that reaches below the ground beside it lie below zero."""
    survey: Any = SimpleNamespace(mesh=SimpleNamespace(vertices=np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 6.0]])))
    rows = [("building", "eaves of the largest roof plane over the ground", "-0.250", "m")]
    work = Work(
        config=make_config(), folder=Path(), reporter=Reporter(), cost=Cost(), survey=survey, facades=[],
        wanted=DrawingOptions(), ground=GroundLevel(2.0, TERRAIN), title="", building=rows,
    )  # fmt: skip
    east, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    frame = DrawingFrame("A", np.zeros(3), east, up, np.zeros(2), np.ones(2))
    assert work.levels(frame) == [(2.0, "\u00b10.00"), (1.75, "-0.25"), (6.0, "+4.00")]
