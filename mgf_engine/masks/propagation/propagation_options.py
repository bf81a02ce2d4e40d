# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of drawing and checking the masks."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class PropagationOptions:
    """Options of drawing and checking the masks."""

    retry_below: float = parameter(0.9, "Agreement of mask and points below which a mask is drawn again", high=1)
    retry_gain: float = parameter(0.02, "Gain in that agreement from which the second drawing is taken", high=1)
    disagree_above: float = parameter(
        0.05, "Share of a photo's points that other photos contradict, above which its mask is drawn again", high=1
    )
    leafy: float = parameter(0.3, "Vegetation probability from which no surface is sought", high=1)
    stray_cover: float = parameter(0.3, "Share of a piece without points that the building's extent must cover", high=1)
    click_loss: float = parameter(
        0.2, "Share of the mask that one more click on the building may take away in the preview: corrections", high=1
    )
    click_slip: int = parameter(10, "Distance from the mask up to which a click on the building lies inside", "px")
    steep: float = parameter(
        25.0, "Angle between up in a photo and up by all cameras from which the preview takes the latter", "degrees"
    )
    level_rms: float = parameter(
        10.0,
        "Maximum RMS angle between the cameras' horizontal axes and the horizon for up by all cameras in the preview",
        "degrees",
        high=90,
    )
    finish: bool = parameter(
        True, "Correct the drawn masks by sky, ground, plants, plain regions, thin structures and far background"
    )
