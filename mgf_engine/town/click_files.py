# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of clicks of a town's buildings: automatic ones are replaced, those that somebody made or changed stay."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mgf_engine.errors import BadInput, reason
from mgf_engine.files.atomic import json_text
from mgf_engine.masks.prompts import PromptsFile, check_prompts
from mgf_engine.town.hulls import BY_HAND
from mgf_engine.town.plan import CLICKS, Building
from mgf_engine.town.submodel import write_if_changed

#: Digests of automatic clicks of a building: those that are there, and those that were about to take their place.
AUTOMATIC = "automatic.json"


def write_clicks(building: Building, folder: Path, earlier: dict[str, str]) -> None:
    """Write the clicks of a building.

    Args:
        building: its clicks.
        folder: of the building.
        earlier: as :func:`read_automatic` returns it.
    """
    if building.by_hand:
        write_if_changed(folder / CLICKS, json_text(building.clicks, indent=1))
    else:
        write_automatic(building.clicks, folder, _automatic(folder, earlier))


def write_automatic(clicks: dict[str, Any], folder: Path, known: set[str]) -> None:
    """Write automatic clicks into a folder; they are known as such even where this ends in the middle.

    Args:
        clicks: photo -> entry.
        folder: that gets them.
        known: digests of automatic clicks that were written there before.
    """
    new, there = digest(clicks), digest(read_clicks(folder / CLICKS)) if (folder / CLICKS).is_file() else ""
    if new not in known:
        write_if_changed(folder / AUTOMATIC, json_text(sorted({there} & known | {new})))
    write_if_changed(folder / CLICKS, json_text(clicks, indent=1))


def with_hand_clicks(
    building: Building, folder: Path, by_hand: Path | None, earlier: dict[str, str], photos: Mapping[str, Path]
) -> Building:
    """Return the building with clicks by hand in the place of automatic ones, where there are some.

    Args:
        building: with automatic clicks.
        folder: of the building; its clicks are by hand where they are none that were written automatically.
        by_hand: folder with ``ID.json``; these win.
        earlier: as :func:`read_automatic` returns it.
        photos: name -> file of each photo of the scene.

    Raises:
        BadInput: a file cannot be read, or names a photo that is none of the scene's; one that is given holds no clicks
            on a building, or some outside of their photos.
    """
    own, given = folder / CLICKS, None if by_hand is None else by_hand / f"{building.hull.id}.json"
    path = given if given is not None and given.is_file() else own
    clicks = read_clicks(path) if path.is_file() else {}
    if not clicks or (path == own and digest(clicks) in _automatic(folder, earlier)):
        return building
    strange = sorted(set(clicks) - set(photos))
    if strange:
        raise BadInput(f"'{path}' names the photo '{strange[0]}', which the scene does not have; correct it.")
    if path == given:  # faults of the folder's own clicks are the building's: its job says them, and the others run
        check_prompts(PromptsFile.read(path), photos, placed=True)
    return replace(building, hull=replace(building.hull, state=BY_HAND, reason=""), clicks=clicks, by_hand=True)


def read_automatic(file: Path) -> dict[str, str]:
    """Read the digest of each building's automatic clicks from ``buildings.json``; none where it cannot be used."""
    try:
        rows = json.loads(file.read_text(encoding="utf-8"))["buildings"]
        return {str(row["id"]): str(row["automatic"]) for row in rows}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def digest(clicks: dict[str, Any]) -> str:
    """Return the SHA-256 of clicks, empty for none."""
    return hashlib.sha256(json.dumps(clicks, sort_keys=True).encode()).hexdigest() if clicks else ""


def made_automatically(folder: Path) -> set[str]:
    """Return the digests of the automatic clicks that were written into a folder, or were about to be."""
    try:
        return {str(each) for each in json.loads((folder / AUTOMATIC).read_text(encoding="utf-8"))}
    except (OSError, ValueError, TypeError):
        return set()


def _automatic(folder: Path, earlier: dict[str, str]) -> set[str]:
    """Return the digests of the automatic clicks of a building, by its folder and by the plan before."""
    return made_automatically(folder) | {earlier.get(folder.name, "")}


def count_clicks(clicks: dict[str, Any]) -> dict[str, list[int]]:
    """Count the clicks on the building and beside it in each photo; 0 of what is no list, which the job reports."""

    def count(entry: Any, kind: str) -> int:
        values = entry.get(kind) if isinstance(entry, dict) else None
        return len(values) if isinstance(values, list) else 0

    return {name: [count(entry, kind) for kind in ("positive", "negative")] for name, entry in clicks.items()}


def read_clicks(path: Path) -> dict[str, Any]:
    """Read a file of clicks, unchecked but for its form: photo -> entry.

    Raises:
        BadInput: it cannot be read, or holds something else.
    """
    try:
        data = json.loads(path.read_bytes())
        if not isinstance(data, dict):
            raise ValueError("no entries of photos")
        return data
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(f"The clicks '{path}' cannot be read ({reason(error)}); correct or delete the file.") from error
