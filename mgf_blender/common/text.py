# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences in narrow panels."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import bpy

#: In which our texts are translated, apart from those that Blender has itself.
CONTEXT = "MGF"
_kept: dict[str, frozenset[str]] = {}
_LETTERS = 46  # of a line where there is no window to measure
_ICON = 20.0  # width of an icon, pixels at interface scale 1
_MARGINS = {"UI": 98.0, "WINDOW": 290.0}  # of a sidebar, of the preferences; pixels at interface scale 1


def tr(text: str, **values: object) -> str:
    """Return a text of the interface in the user's language, with values put in: ``tr("{count} cameras", count=3)``.

    Texts without values that are handed to a layout need no call: Blender looks them up itself.
    """
    known = look_up(text)
    return known.format(**values) if values else known


def look_up(text: str) -> str:
    """Return what our dictionary has for a text, else Blender's, or the text itself."""
    ours: str = bpy.app.translations.pgettext_iface(text, CONTEXT)
    if ours != text or text in _kept.get(bpy.app.translations.locale, ()):
        return ours
    return bpy.app.translations.pgettext_iface(text)


def keep(locale: str, texts: Iterable[str]) -> None:
    """Note which texts our dictionary of a language leaves as they are, such as *Mesh* in German: Blender's own word
    for them does not count."""
    _kept[locale] = frozenset(texts)


def in_our_words(*classes: type) -> None:
    """Have the properties of classes, which Blender is yet to register, translated in our context; their modules may
    not postpone annotations."""
    for cls in classes:
        for value in cls.__annotations__.values():
            if hasattr(value, "keywords"):  # of bpy.props
                value.keywords.setdefault("translation_context", CONTEXT)


def N_(text: str) -> str:
    """Mark a text that is translated where it is shown."""
    return text


def format_duration(seconds: float | None) -> str:
    """Return seconds as people say them: ``40 s``, ``12 min``, ``2 h 5 min``; empty for None."""
    if seconds is None:
        return ""
    if seconds < 90:
        return f"{max(0, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def wrapped(text: str, fits: Callable[[str], bool]) -> list[str]:
    """Return the lines of a sentence, each as long as ``fits`` allows; words too long for one, such as paths, are
    broken."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".lstrip()
        if fits(longer):
            lines[-1] = longer
            continue
        while not fits(word) and len(word) > 1:
            most = next(n for n in range(len(word) - 1, 0, -1) if n == 1 or fits(word[:n]))
            folder = max(word.rfind("/", 0, most), word.rfind("\\", 0, most)) + 1  # a path is broken between folders
            most = folder if folder > most // 2 else most
            lines.append(word[:most])
            word = word[most:]
        lines.append(word)
    return lines if lines[0] or len(lines) == 1 else lines[1:]


def draw_sentence(layout: bpy.types.UILayout, text: str, icon: str) -> None:
    """Draw a sentence on as many lines as it needs, the icon before the first."""
    column = layout.column(align=True)
    for i, line in enumerate(wrapped(text, _fits_here(icon=icon != "NONE"))):
        column.label(text=line, icon="BLANK1" if i and icon != "NONE" else icon, translate=False)


def draw_value(layout: bpy.types.UILayout, name: str, value: str, name_share: float = 0.3) -> None:
    """Draw a name and its value beside it, on as many lines as it needs.

    Args:
        layout: to draw into.
        name: translated already.
        value: as text.
        name_share: share of the width that the name gets.
    """
    for i, line in enumerate(wrapped(value, _fits_here(1 - name_share))):
        split = layout.split(factor=name_share)
        split.label(text="" if i else name, translate=False)
        split.label(text=line, translate=False)


def widest(texts: Iterable[str]) -> str:
    """Return the first of texts, the longest before the others, that has room on one line of the panel that is being
    drawn; the last where none has."""
    fits = _fits_here()
    *longer, last = texts
    return next((text for text in longer if fits(text)), last)


def _fits_here(share: float = 1.0, icon: bool = True) -> Callable[[str], bool]:
    """Return whether a text fits in a box of the panel that is being drawn, or in a share of it, beside an icon or
    without."""
    context = bpy.context
    if context.region is None:  # no window
        return lambda text: len(text) <= share * _LETTERS
    import blf  # of the bpy package, which must come first

    scale, styles = context.preferences.system.ui_scale, context.preferences.ui_styles
    width = context.region.width - scale * _MARGINS.get(context.region.type, _MARGINS["UI"])
    width = share * (width + (0.0 if icon else scale * _ICON))
    blf.size(0, (styles[0].widget.points if styles else 11.0) * scale)
    return lambda text: blf.dimensions(0, text)[0] <= width
