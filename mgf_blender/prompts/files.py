# SPDX-License-Identifier: GPL-3.0-or-later
"""``prompts.json``: the clicks as the engine reads them, and back."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path, PurePosixPath
from typing import Any

import bpy

from ..common.errors import UserError, reason
from ..common.files import replace_file
from .properties import BUILDING


def to_data(scene: bpy.types.Scene, only: str | None = None) -> dict[str, Any]:
    """Return the scene's clicks, or one photo's, in the shape of ``prompts.json``; photos without clicks and
    proposed clicks are left out."""
    data: dict[str, Any] = {}
    for photo in scene.mgf.photos:
        if only is not None and photo.name != only:
            continue
        entry: dict[str, Any] = {}
        for click in photo.clicks:
            if click.proposed:
                continue
            pair = [round(float(v), 2) for v in click.uv]
            if click.negative:
                entry.setdefault("negative", []).append(pair)
            elif click.part == BUILDING:
                entry.setdefault("positive", []).append(pair)
            else:
                entry.setdefault("parts", {}).setdefault(click.part, []).append(pair)
        if entry:
            data[photo.name] = entry
    return data


def write(scene: bpy.types.Scene, path: Path, only: str | None = None) -> None:
    """Write the clicks (of the photo ``only``), whole or not at all.

    Raises:
        UserError: the file cannot be written.
    """
    text = json.dumps(to_data(scene, only), indent=1, ensure_ascii=False) + "\n"
    replace_file(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def read(path: Path) -> dict[str, list[tuple[float, float, bool, str]]]:
    """Return photo name -> clicks (u, v, negative, part) of a prompts file.

    Raises:
        UserError: the file cannot be read or is no prompts file.
    """
    try:
        data = json.loads(path.read_bytes())  # UTF-8, or UTF-16 as PowerShell writes
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(
            "Cannot read '{path}' ({error}); choose a prompts.json file.", path=path, error=reason(error)
        ) from error
    try:
        return {str(name): list(_clicks(entry)) for name, entry in data.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise UserError(
            "'{path}' is not a prompts file; it should map photos to lists of positive and negative points.", path=path
        ) from error


def replace_clicks(scene: bpy.types.Scene, found: dict[str, list[tuple[float, float, bool, str]]]) -> list[str]:
    """Put the clicks of a file into the scene's photos; returns names that no photo has, or more than one."""
    by_name = {p.name: p for p in scene.mgf.photos}
    stems = Counter(_stem(p.name) for p in scene.mgf.photos)
    by_stem = {_stem(p.name): p for p in scene.mgf.photos if stems[_stem(p.name)] == 1}
    unknown = []
    for name, clicks in found.items():
        photo = by_name.get(name) or by_stem.get(_stem(name))
        if photo is None:
            unknown.append(name)
            continue
        photo.clicks.clear()
        for u, v, negative, part in clicks:
            add_click(photo, u, v, negative, part)
    return unknown


def _stem(name: str) -> str:
    """Return a photo's name without folders and extension, in comparable form."""
    return PurePosixPath(name).stem.casefold()


def add_click(
    photo: bpy.types.PropertyGroup, u: float, v: float, negative: bool, part: str, proposed: bool = False
) -> None:
    """Append a click to a photo of the list.

    Args:
        photo: of the scene's list.
        u: column, pixels of the photo.
        v: row, pixels of the photo.
        negative: the click is on the background.
        part: name of the part that is meant; empty for the building.
        proposed: it was not made by hand and waits to be accepted.
    """
    click = photo.clicks.add()
    click.uv, click.negative, click.part, click.proposed = (u, v), negative, part, proposed


def _clicks(entry: dict[str, Any]):
    for u, v in entry.get("positive", []):
        yield float(u), float(v), False, BUILDING
    for u, v in entry.get("negative", []):
        yield float(u), float(v), True, BUILDING
    for part, pairs in entry.get("parts", {}).items():
        for u, v in pairs:
            yield float(u), float(v), False, str(part)
