# SPDX-License-Identifier: GPL-3.0-or-later
"""Show messages of the engine in the panel: they name options of its command line, which the panel has as buttons."""

from __future__ import annotations

import re

from ..common import options
from ..common.text import N_, look_up, tr

#: In messages of the engine that refer to the picture of all masks.
CONTACT_SHEET = "contact sheet"
#: The most frequent failure, as :func:`in_panel_terms` returns it: listed here for the translations.
_FAILURES = (N_("Out of memory; lower Resolution or Max Gaussians and press Reconstruct Building."),)
#: Remarks of most drawings and models, likewise.
_REMARKS = (
    N_(
        "The job has no true coordinates, so one unit of its scene is drawn as one metre; give Georeference control "
        "points or scale bars for true lengths."
    ),
    N_(
        "The job has no true coordinates, so one unit of its scene counts as one metre in its models; give "
        "Georeference control points or scale bars for true lengths."
    ),
)


def translate_failure(text: str) -> str:
    """Return in the user's language why a job ended early; ``text`` from :func:`in_panel_terms`."""
    full = re.fullmatch(r"The disk of '(.*)' is full; free some space and press Resume\.", text)
    if full:
        return tr("The disk of '{folder}' is full; free some space and press Resume.", folder=full[1])
    return look_up(text)


def in_panel_terms(text: str) -> str:
    """Replace options and commands in a message of the engine by the buttons and properties of the panel."""
    button = "Reconstruct Building" if "--resolution" in text else "Resume"  # which takes no new options
    text = re.sub(r"(?:run again with|add) --resume", f"press {button}", text)
    text = re.sub(r"run 'mgf georef'(?: again)?", "press Georeference Job", text)
    text = text.replace("give 'mgf georef'", "give Georeference")
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
