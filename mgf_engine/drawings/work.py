# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``mgf drawings`` was asked for, and what the parts of a run share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mgf_engine.drawings.kinds import KINDS
from mgf_engine.drawings.model import Facade, Survey
from mgf_engine.drawings.quantities import Row
from mgf_engine.output_folder import Deliverables


@dataclass(frozen=True)
class DrawingOptions:
    """What ``mgf drawings`` was asked for.

    Attributes:
        facades: three points of the scene frame for each facade; empty finds them.
        resolution: of rasters in the local unit per pixel; None takes the photos' own.
        sections: planes to cut at, as :func:`mgf_engine.drawings.section.section_frames` reads them; empty takes three
            through the middle.
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
        rows: quantities.
    """

    survey: Survey
    facades: list[Facade]
    wanted: DrawingOptions
    rows: list[Row] = field(default_factory=list)

    def wants(self, *kinds: str) -> bool:
        """Tell whether one of these was asked for."""
        return not self.wanted.kinds.isdisjoint(kinds)
