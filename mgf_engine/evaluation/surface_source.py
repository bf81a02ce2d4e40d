# SPDX-License-Identifier: GPL-3.0-or-later
"""Explain in a few sentences what determined the surface of a mesh, for the report's first page."""

from __future__ import annotations

from mgf_engine.options.config import Config

_STARTS = {
    "surface": "Dense matching between neighbouring photos, line segments and planes through them give a closed "
    "surface inside the masks, before any training.",
    "dense": "Dense matching between neighbouring photos gives points on the building, before any training.",
    "sparse": "The sparse points of structure from motion are all that is known of the building before the training.",
}


def explain_surface(config: Config, iterations: int) -> list[str]:
    """Tell where it started, what the field decides, and what places it in the end; each a sentence or two.

    Args:
        iterations: of training.
    """
    start = config.start if config.use_masks or config.start != "surface" else "dense"
    return [_STARTS[start], _field(config, iterations), _photos(config, start)]


def _field(config: Config, iterations: int) -> str:
    field = f"The Gaussian field, trained for {iterations:,} iterations," if iterations else "The field, not trained,"
    if config.surface == "opacity":
        return f"{field} is the surface: solid is what no photo sees through, down to a level of opacity (eq. 23-26)."
    if not iterations:
        return "The field is not trained: its Gaussians, placed there, give each photo a depth map, fused into one."
    return f"{field} gives each photo a depth map, sees past bars and railings, and all depth maps are fused into one."


def _photos(config: Config, start: str) -> str:
    planes = " In the end nearly flat parts are projected onto their planes." if config.flatten else ""
    if not config.match_photos:
        return f"No photo is compared with another after the training: the surface is as accurate as the field.{planes}"
    again = f", and {_times(config.refine_rounds)} on the finished mesh" if config.refine_rounds else ""
    choose = "choose at each pixel between the field and that surface, and " if start == "surface" else ""
    kept = "the starting surface stays" if start == "surface" else "the field's depth stays"
    moved = "each depth" if config.surface == "fused" else "the surface"
    return (
        f"Patches of neighbouring photos then {choose}move {moved} by at most two pixels of parallax to where they "
        f"correlate best{again}. This decides the last fraction of a pixel; where nothing correlates, {kept}.{planes}"
    )


def _times(rounds: int) -> str:
    return "once more" if rounds == 1 else f"{rounds} times more"
