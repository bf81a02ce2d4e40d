# SPDX-License-Identifier: GPL-3.0-or-later
"""Advise how the next mesh of this building would get better, by the figures of this one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from mgf_engine.mesh.confidence import ConfidenceShares

_WORTH_SAYING = 0.1  # share of the area
_FINER = 1.3  # how much larger than the working photos the originals are before it is worth saying
_LISTED = 5


@dataclass(frozen=True)
class JobFacts:
    """What advice depends on.

    Attributes:
        confidence: shares of the area of the mesh by it, or None.
        photo_side: longest side of the photos as taken, pixels.
        working_side: the same of the working photos.
        weak_masks: names of photos whose masks were not used.
        trained: whether the field was trained.
    """

    confidence: ConfidenceShares | None
    photo_side: int
    working_side: int
    weak_masks: tuple[str, ...]
    trained: bool


def advice(facts: JobFacts) -> list[str]:
    """Return one sentence or two per step that is worth taking, the most useful first; empty where nothing is."""
    return [*_photos(facts), *_masks(facts), *_options(facts)]


def _photos(facts: JobFacts) -> Iterator[str]:
    """Say which photos are missing."""
    if facts.confidence is None:
        return
    thin = facts.confidence.few + facts.confidence.unseen
    if thin > _WORTH_SAYING:
        yield (
            f"{thin:.0%} of the surface is shown by fewer than three photos (violet and blue above): photograph "
            "these places, each from three positions or more, a few steps apart."
        )
    if facts.confidence.plain > _WORTH_SAYING:
        yield (
            f"On {facts.confidence.plain:.0%} of the surface (green above) the photos hardly correlate, as on plain, "
            "mirroring or dark parts: closer and sharper photos in even light show more of its grain."
        )


def _masks(facts: JobFacts) -> Iterator[str]:
    """Say where clicks are missing."""
    if facts.weak_masks:
        more = f" and {len(facts.weak_masks) - _LISTED} more" if len(facts.weak_masks) > _LISTED else ""
        yield f"Click the building in photos whose masks were not used: {', '.join(facts.weak_masks[:_LISTED])}{more}."


def _options(facts: JobFacts) -> Iterator[str]:
    """Say which options would show more."""
    if facts.photo_side > _FINER * facts.working_side:
        side = min(facts.photo_side, 2 * facts.working_side)
        yield (
            f"The photos have {facts.photo_side:,} pixels on their longest side, and {facts.working_side:,} were used: "
            f"--resolution {side} shows finer detail, for more time and memory."
        )
    if not facts.trained:
        yield (
            "Nothing was trained: --preset standard also sees past bars and railings, and measures itself on photos "
            "that it keeps out."
        )
