# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages about the segmenter: which one draws the masks, and how to install EfficientSAM."""

from __future__ import annotations

import json
from pathlib import Path

from mgf_engine.weights import WEIGHTS, find_weights

TITLES = {"efficientsam": "EfficientSAM", "random_walker": "random walker, which needs no weights"}


def describe_download() -> str:
    """Say how to get EfficientSAM, as half a sentence."""
    size = sum(f.size for f in WEIGHTS["vitt"]) / 1e6
    return f"'mgf weights' fetches those of EfficientSAM, the paper's segmenter ({size:.0f} MB, Apache-2.0)"


def describe_segmenter(segmenter: str) -> str:
    """Return one sentence for the start of the masks stage; ``segmenter`` is its ``name``."""
    if segmenter == "efficientsam":
        return "Masks: drawn by EfficientSAM; '--segmenter random_walker' draws them without weights."
    return f"Masks: drawn by the random walker, which needs no weights; {describe_download()}."


def describe_automatic_choice(folder: Path) -> str:
    """Say which segmenter ``auto`` takes with the weights in a folder, for ``mgf doctor``.

    Raises:
        BadInput: weights are there, but damaged.
    """
    found = find_weights(folder)
    return f"{TITLES['efficientsam']} ({found[0]})" if found else f"{TITLES['random_walker']}; {describe_download()}"


def describe_used_segmenter(masks_folder: Path) -> str:
    """Say which segmenter made the masks of a job, for its report."""
    try:
        name = json.loads((masks_folder / "scores.json").read_text(encoding="utf-8")).get("segmenter")
    except (OSError, ValueError, AttributeError):
        return "unknown"
    return TITLES.get(name, "none; masks were given or switched off" if name == "none" else "unknown")
