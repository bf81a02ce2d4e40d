# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of a run of ``mgf drawings``, and the data that its parts share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mgf_engine.drawings.ground import TERRAIN, GroundLevel
from mgf_engine.drawings.kinds import KINDS
from mgf_engine.drawings.model import DrawingFrame, Facade, Survey
from mgf_engine.drawings.quantities import Row
from mgf_engine.jobs.output_folder import Deliverables


@dataclass(frozen=True)
class DrawingOptions:
    """What ``mgf drawings`` was asked for.

    Attributes:
        facades: three points of the scene frame for each facade; empty finds them.
        resolution: of rasters in the local unit per pixel; None takes the photos' own.
        sections: planes to cut at, as :func:`mgf_engine.drawings.section_planes.section_frames` reads them; empty takes
            three through the middle.
        paper: of the sheets, A3 or A1.
        scale: of the sheets, the N of 1:N; None takes the largest round one that fits.
        kinds: what to draw, of :data:`KINDS`.
        algorithms: options of the algorithms, ``section.name`` -> value; those that the job was made with otherwise.
    """

    facades: Sequence[Sequence[Sequence[float]]] = ()
    resolution: float | None = None
    sections: Sequence[str] = ()
    paper: str = "A3"
    scale: float | None = None
    kinds: frozenset[str] = frozenset(KINDS)
    algorithms: Mapping[str, Any] = field(default_factory=dict)


@dataclass(kw_only=True)
class Work(Deliverables):
    """What the parts of a run share.

    Attributes:
        ground: height that others are counted from.
        title: of the sheets.
        building: quantities of the whole building.
        rows: all quantities.
    """

    survey: Survey
    facades: list[Facade]
    wanted: DrawingOptions
    ground: GroundLevel
    title: str
    building: list[Row] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)

    def wants(self, *kinds: str) -> bool:
        """Tell whether one of these was asked for."""
        return not self.wanted.kinds.isdisjoint(kinds)

    def levels(self, frame: DrawingFrame) -> list[tuple[float, str]]:
        """Return heights of an upright drawing (its y) that a sheet marks, and what stands there: over the ground where
        terrain tells it."""
        if abs(frame.normal[2]) > 1e-6:
            return []
        known = self.ground.source == TERRAIN
        z = self.survey.mesh.vertices[:, 2]
        bottom = self.ground.height if known else float(z.min())
        names = {"eaves of the largest roof plane over the ground", "ridge over the ground"}
        heights = [self.ground.height + float(v) for _, quantity, v, _ in self.building if quantity in names]
        heights = [*heights, float(z.max())]
        return [(bottom, "\u00b10.00"), *((height, f"{height - bottom:+.2f}") for height in heights)]
