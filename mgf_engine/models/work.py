# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments of ``mgf models``, and data that the parts of a run share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mgf_engine.drawings.model import Survey
from mgf_engine.jobs.output_folder import Deliverables
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models.kinds import KINDS


@dataclass(frozen=True)
class ModelOptions:
    """What ``mgf models`` was asked for.

    Attributes:
        kinds: what to make, of :data:`KINDS`.
        errors: distances of the coarser levels of detail from the mesh in the local unit; empty takes shares of faces.
        detail: of the solid in the local unit: what is smaller is left out; None takes it from photos and size.
        spacing: of points in the local unit; None takes the size of a working pixel on the building.
        draco: whether levels of detail are compressed.
        algorithms: options of the algorithms, ``section.name`` -> value; those that the job was made with otherwise.
    """

    kinds: Sequence[str] = KINDS
    errors: Sequence[float] = ()
    detail: float | None = None
    spacing: float | None = None
    draco: bool = False
    algorithms: Mapping[str, Any] = field(default_factory=dict)


@dataclass(kw_only=True)
class Work(Deliverables):
    """What the parts of a run share.

    Attributes:
        levels: levels of detail and their textures, the full mesh first.
    """

    job: Path
    survey: Survey
    texture: Texture | None
    wanted: ModelOptions
    levels: list[tuple[Mesh, Texture | None]] = field(default_factory=list)
