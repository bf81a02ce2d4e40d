# SPDX-License-Identifier: GPL-3.0-or-later
"""Flag masks that are not used in training: without building, or contradicted by points or by other photos' masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.geometry.hull_agreement import hull_agreement
from mgf_engine.masks.geometry.visual_hull import MaskHullOptions
from mgf_engine.masks.points import track_votes
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter

#: Why a photo is left out that was taken beside the building.
NO_BUILDING = "hardly any building in this photo"


@dataclass(frozen=True)
class FlagOptions:
    """Options of masks that are left out."""

    flag_below: float = parameter(0.75, "Agreement of mask and points below which a mask is left out", high=1)
    hull_below: float = parameter(
        0.3, "Agreement with the visual hull of the other photos below which a mask without points is left out", high=1
    )
    least_building: float = parameter(0.005, "Minimum share of a photo that the building covers", high=1)
    hull: MaskHullOptions = MaskHullOptions()


def measure_consistency(scene: Scene, masks: MaskSet, dilation: int) -> float:
    """Return the share of the sparse points with three or more observations in used photos on which these agree.

    They agree if at most one in ten votes differs, so that one noisy keypoint in a long track does not count.
    """
    voters = np.flatnonzero(masks.used).tolist()
    votes = track_votes(scene, masks.labels, voters, dilation)
    total = votes.inside + votes.outside
    many = total >= 3
    if not many.any():
        return 1.0
    return float((np.minimum(votes.inside, votes.outside) <= 0.1 * total)[many].mean())


def flag_reason(labels: NDArray[np.uint8], score: float, disagreement: float, options: FlagOptions) -> str:
    """Return why a mask is left out, empty where it is not.

    Args:
        labels: label map, uint8 [H, W].
        score: agreement of mask and points, 0..1.
        disagreement: share of its points that other photos contradict, 0..1.
        options: limits.
    """
    share = float(building(labels).mean())
    if share < options.least_building:
        return NO_BUILDING
    if score < options.flag_below:
        return f"mask and points agree only to {score:.0%}"
    if disagreement > 1 - options.flag_below:
        return f"other photos contradict {disagreement:.0%} of its points"
    return ""


def flag_by_masks(
    scene: Scene,
    masks: MaskSet,
    reasons: list[str],
    tested: NDArray[np.bool_],
    options: FlagOptions = FlagOptions(),
) -> list[str]:
    """Return why each mask without enough points to test it is left out: the visual hull of the others contradicts it.

    Args:
        scene: normalised frame.
        masks: those used are the others.
        reasons: per view, why it is flagged already (empty where it is fine).
        tested: bool [V], views whose reason stands, since enough points lie in their masks.
        options: when the other photos' masks contradict one.
    """
    result = list(reasons)
    used = np.flatnonzero(masks.used).tolist()
    untested = [
        i for i in np.flatnonzero(~tested).tolist() if float(building(masks.labels[i]).mean()) >= options.least_building
    ]
    for index, share in zip(untested, hull_agreement(scene, masks, used, untested, options.hull), strict=True):
        low = share is not None and share < options.hull_below
        result[index] = f"the other photos' masks agree with it only to {share:.0%}" if low else ""
    return result


def describe_flags(names: Sequence[str], reasons: Sequence[str]) -> list[str]:
    """Return a sentence for each kind of photo that is left out: those beside the building, and those with weak masks.

    Args:
        names: of all photos.
        reasons: why each is left out, empty where it is not.
    """
    beside = [name for name, reason in zip(names, reasons, strict=True) if reason == NO_BUILDING]
    weak = [name for name, reason in zip(names, reasons, strict=True) if reason and reason != NO_BUILDING]
    result = []
    if beside:
        count, photos = _counted(beside, len(names))
        result.append(
            f"{count} photos show hardly any of the building and are left out ({photos}); click on it where the "
            "contact sheet shows more of it."
        )
    if weak:
        count, photos = _counted(weak, len(names))
        result.append(f"{count} masks are weak and left out ({photos}); look at the contact sheet.")
    return result


def _counted(some: Sequence[str], total: int) -> tuple[str, str]:
    """Return how many of all these are, and the names of the first of them."""
    return f"{len(some)} of {total}", ", ".join(some[:5]) + (", ..." if len(some) > 5 else "")
