# SPDX-License-Identifier: GPL-3.0-or-later
"""What placed the surface of a mesh, in three sentences for the report's first page."""

from __future__ import annotations

from mgf_engine.config import Config

_STARTS = {
    "surface": "edges, planes and stereo between neighbouring photos give a first surface",
    "dense": "stereo between neighbouring photos gives dense points on the building",
    "sparse": "the sparse points on the building, from structure from motion, are all that is known of it",
}


def placing(config: Config, iterations: int) -> list[str]:
    """Three sentences: where it started, what the field decides, and what places it in the end.

    Args:
        iterations: of training.
    """
    start = config.start if config.use_masks or config.start != "surface" else "dense"
    trained = f"the Gaussian field, trained for {iterations:,} iterations" if iterations else "the field, not trained"
    if config.surface == "opacity":
        decides = f"{trained}, decides: solid is what no photo sees through to, at an opacity of the level (eq. 23-26)"
    else:
        decides = f"{trained}, gives each photo its depths and sees through between bars; their mean is the surface"
    if config.match_photos:
        again = f", and {_times(config.refine_rounds)} on the finished mesh" if config.refine_rounds else ""
        place = (
            "it lies where patches of neighbouring photos look most alike, searched within two pixels of the field's "
            f"surface{again}; where photos say nothing, the field's own surface stays"
        )
    else:
        place = "no photo is compared once training has ended: the field's own surface stays"
    return [f"{text[:1].upper()}{text[1:]}." for text in (f"at the start, {_STARTS[start]}", decides, place)]


def _times(rounds: int) -> str:
    return "once more" if rounds == 1 else f"{rounds} times more"
