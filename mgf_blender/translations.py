# SPDX-License-Identifier: GPL-3.0-or-later
"""Translations of the interface: one file per language in ``languages/``, English text -> translated text.

Blender has a dictionary of its own, which comes first: in German its *Control Points* are those of a curve and its
*Level* is a step. Our classes and lookups therefore ask in a context of our own, :data:`.common.text.CONTEXT`.

``tools/extract_strings.py LOCALE`` makes or refreshes such a file; what it leaves empty is shown in English.
"""

from __future__ import annotations

import json
from pathlib import Path

import bpy

from .common.text import CONTEXT, keep

FOLDER = Path(__file__).with_name("languages")
#: Descriptions are looked up without a context.
_CONTEXTS = ("*", CONTEXT)


def dictionary(folder: Path = FOLDER) -> dict[str, dict[tuple[str, str], str]]:
    """Return locale -> (context, English) -> translated, as Blender wants it; a file that cannot be read is left
    out."""
    found: dict[str, dict[tuple[str, str], str]] = {}
    for path in sorted(folder.glob("*.json")):
        try:
            texts = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        found[path.stem] = {(c, english): text for english, text in texts.items() if text for c in _CONTEXTS}
    return found


def register() -> None:
    """Hand the dictionaries to Blender."""
    found = dictionary()
    for locale, texts in found.items():
        keep(locale, {english for (_, english), text in texts.items() if text == english})
    bpy.app.translations.register(__package__, found)


def unregister() -> None:
    """Take them back."""
    bpy.app.translations.unregister(__package__)
