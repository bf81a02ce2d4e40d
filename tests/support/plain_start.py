# SPDX-License-Identifier: GPL-3.0-or-later
"""The starting surface of the plain house, with what it is cut from."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from benchmarks.synthetic.plain_house import PlainHouse
from mgf_engine.messages import Reporter
from mgf_engine.start import block_cuts, surface
from mgf_engine.start.evidence import Evidence
from mgf_engine.start.surface import StartSurface, start_surface
from mgf_engine.start.views import StartViews


@dataclass(frozen=True)
class PlainStart:
    """The surface in one cut, and the views and the evidence that it is cut from."""

    surface: StartSurface
    views: StartViews
    evidence: Evidence


def make_plain_start(house: PlainHouse) -> PlainStart:
    given: list[tuple[StartViews, Evidence]] = []

    def cut(views, evidence, *more):
        given.append((views, evidence))
        return cut_in_blocks(views, evidence, *more)

    cut_in_blocks = surface.cut_in_blocks
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surface, "cut_in_blocks", cut)
        patch.setattr(block_cuts, "make_grid", None)  # one block makes none
        made = start_surface(house.scene, house.masks, range(16), Reporter(), 2)
    return PlainStart(made, *given[0])
