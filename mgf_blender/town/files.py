# SPDX-License-Identifier: GPL-3.0-or-later
"""Read the folder that ``mgf town`` made: its buildings and where they lie."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from ..common.errors import UserError, reason
from ..georef.files import Placement, read_placement

PLAN, BUILDINGS, LIGHT, TERRAIN = "buildings.json", "buildings", "light.ply", "terrain"
#: In the job of a building and in the folder of the terrain.
MESH, TERRAIN_MESH, PICTURE, COORDINATES = "mesh.ply", "terrain.ply", "texture.jpg", "mesh_texture.npz"


@dataclass(frozen=True)
class Building:
    """A building that is done.

    Attributes:
        job: its job folder; light: the mesh with few faces, in the local frame of the town.
        confidence: of its mesh, 0..1; None where nobody knows.
    """

    name: str
    job: Path
    light: Path
    confidence: float | None


@dataclass(frozen=True)
class Town:
    """What a town's folder holds.

    Attributes:
        placement: scene frame -> local frame, and where that lies in the world.
        missing: number of buildings of the plan without a mesh.
    """

    folder: Path
    placement: Placement
    buildings: tuple[Building, ...]
    missing: int


def read_town(folder: Path) -> Town:
    """Read what is there of a town.

    Raises:
        UserError: the folder holds none, or no building of it is done.
    """
    try:
        names = [str(row["id"]) for row in json.loads((folder / PLAN).read_text(encoding="utf-8"))["buildings"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(
            "'{folder}' holds no town ({error}); choose the folder that mgf town made.",
            folder=folder,
            error=reason(error),
        ) from error
    placement = read_placement(folder)
    if placement is None:
        raise UserError("'{folder}' does not say where its buildings lie; run mgf town again.", folder=folder)
    found = []
    for name in names:
        place = folder / BUILDINGS / name
        if (place / LIGHT).is_file() and (place / "done.json").is_file():
            found.append(Building(name, place / "job", place / LIGHT, _confidence(place / "done.json")))
    if not found:
        raise UserError("No building of '{folder}' is done; run mgf town to its end.", folder=folder)
    return Town(folder, placement, tuple(found), len(names) - len(found))


def _confidence(path: Path) -> float | None:
    try:
        return float(json.loads(path.read_text(encoding="utf-8"))["confidence"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
