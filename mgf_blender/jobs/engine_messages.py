# SPDX-License-Identifier: GPL-3.0-or-later
"""Show messages of the engine in the panel: they name options of its command line, which the panel has as buttons."""

from __future__ import annotations

import functools
import re

from ..common import options
from ..common.text import tr
from .engine_sentences import FAILURES, PASSING, REASONS, WARNINGS

#: In messages of the engine that refer to the picture of all masks.
CONTACT_SHEET = "contact sheet"


def translate_message(text: str) -> str:
    """Return a message of the engine in the user's language, the values in it as they are.

    Args:
        text: from :func:`in_panel_terms`; one that no dictionary knows is returned as it is.
    """
    known = tr(text)
    if known != text:
        return known
    for sentence, pattern in _patterns():
        found = pattern.fullmatch(text)
        if found:
            return tr(sentence, **{name: translate_message(value) for name, value in found.groupdict().items()})
    return text


def is_passing(text: str) -> bool:
    """Tell whether a warning only matters until the job is done."""
    return dict(_patterns())[PASSING].fullmatch(text) is not None


@functools.cache
def _patterns() -> list[tuple[str, re.Pattern[str]]]:
    """Return the sentences with values, each with what recognises it."""
    return [
        (text, re.compile(re.sub(r"\\{(\w+)\\}", r"(?P<\1>.*?)", re.escape(text)), re.DOTALL))
        for text in (*FAILURES, *WARNINGS, *REASONS)
        if "{" in text
    ]


def in_panel_terms(text: str) -> str:
    """Replace options and commands in a message of the engine by the buttons and properties of the panel."""
    button = "Reconstruct Building" if "--resolution" in text else "Resume"  # which takes no new options
    text = re.sub(r"(?:run again with|add) --resume", f"press {button}", text)
    text = re.sub(r"run 'mgf georef'(?: again)?", "press Georeference Job", text)
    text = text.replace("give 'mgf georef'", "give Georeference")
    text = text.replace("run 'mgf doctor --gpu'", "press Check GPU in the preferences")
    text = re.sub(r"'(--[a-z-]+ \w+)'", r"\1", text)
    text = re.sub(
        r"(?:install with: |get it by )pip install 'mgf-engine\[survey\]'(?:, in (?:the engine's|its) environment)?",
        "tick Drawings and Map Coordinates in the preferences and press Install Engine, or in an environment of your "
        "own: pip install 'mgf-engine[survey]'",
        text,
    )
    text = re.sub(
        r"install with: pip install 'mgf-engine\[models\]', in the engine's environment, or leave (?:them )?out"
        r"(?: with)? --(only|draco)",
        lambda found: (
            "tick Models in the preferences and press Install Engine, or "
            + ("leave them out" if found[1] == "only" else "switch Compress off")
            + "; in an environment of your own: pip install 'mgf-engine[models]'"
        ),
        text,
    )
    text = re.sub(r"--prompts(?: FILE)?", "points", re.sub(r"--masks(?: FOLDER)?", "Own Masks", text))
    return re.sub(r"--([a-z][a-z-]*)", lambda found: options.title(found[1].replace("-", "_")), text)
