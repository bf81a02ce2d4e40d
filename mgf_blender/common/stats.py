# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of a job, while it runs and of its result, as rows of name and value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy

from .options import title
from .text import N_, tr

#: Figures whose own name says too little.
_NAMES = {"held_out": N_("Held-Out Photos")}


def draw_figures(layout: bpy.types.UILayout, figures: Mapping[str, Any]) -> None:
    """Draw a row per number or text; anything else is left out."""
    for name, value in figures.items():
        if isinstance(value, int | float | str):
            row = layout.row()
            row.label(text=tr(_NAMES.get(name) or title(str(name))), translate=False)
            row.label(text=figure_text(value), translate=False)


def figure_text(value: float | str) -> str:
    """Return whole numbers in groups of three, others with four digits."""
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
