# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences in narrow panels."""

from __future__ import annotations

import textwrap

import bpy


def tr(text: str, **values: object) -> str:
    """A text of the interface in the user's language, with values put in: ``tr("{count} cameras", count=3)``.

    Texts without values that are handed to a layout need no call: Blender looks them up itself.
    """
    known = look_up(text)
    return known.format(**values) if values else known


def look_up(text: str) -> str:
    """What Blender's dictionaries have for a text, or the text itself."""
    return bpy.app.translations.pgettext_iface(text)


def N_(text: str) -> str:
    """Marks a text that is translated where it is shown."""
    return text


def wrapped(text: str, width: int = 46) -> list[str]:
    """The lines of a sentence for a sidebar; long paths are broken."""
    return textwrap.wrap(text, width, break_long_words=True) or [""]


def draw_sentence(layout: bpy.types.UILayout, text: str, icon: str, width: int = 46) -> None:
    """A sentence on as many lines as it needs, the icon before the first."""
    column = layout.column(align=True)
    for i, line in enumerate(wrapped(text, width)):
        column.label(text=line, icon=icon if i == 0 else "BLANK1", translate=False)
