# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences in narrow panels."""

from __future__ import annotations

import textwrap


def wrapped(text: str, width: int = 46) -> list[str]:
    """The lines of a sentence for a sidebar; long paths are broken."""
    return textwrap.wrap(text, width, break_long_words=True) or [""]
