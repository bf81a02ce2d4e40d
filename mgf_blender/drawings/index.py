# SPDX-License-Identifier: GPL-3.0-or-later
"""Read ``drawings.json``, the list of what ``mgf drawings`` made, again whenever it changes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from ..common.text import N_, tr

FOLDER, PAGE = "drawings", "drawings.html"
_TITLES = {"orthophoto": N_("Orthophoto {name}"), "deviation": N_("Deviation {name}")}


@dataclass(frozen=True)
class Drawing:
    """A picture of a drawing: its file, what it is, and its pixels across and down (0 where unknown)."""

    path: Path
    kind: str
    frame: str

    @property
    def title(self) -> str:
        """For a button."""
        return tr(_TITLES[self.kind], name=self.frame)


@dataclass(frozen=True)
class Index:
    """The drawings of a job.

    Attributes:
        pictures: that Blender can show.
        files: how many there are of all kinds.
        unit: of lengths.
    """

    pictures: tuple[Drawing, ...]
    files: int
    unit: str


_read: dict[str, tuple[int, Index | None]] = {}  # drawings.json -> (its time, what it says)


def read_index(job: Path) -> Index | None:
    """Read the drawings in a job folder; None where there are none, or where another program's file lies there."""
    path = job / FOLDER / "drawings.json"
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return None
    if _read.get(str(path), (0, None))[0] != changed:
        _read[str(path)] = changed, _parsed(path)
    return _read[str(path)][1]


def _parsed(path: Path) -> Index | None:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        files = {str(name): dict(facts) for name, facts in data["files"].items()}
        unit = str(data["unit"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    pictures = [
        Drawing(path.parent / name, str(facts.get("kind")), str(facts.get("frame", "")))
        for name, facts in files.items()
        if name.endswith(".png") and facts.get("kind") in _TITLES and Path(name).name == name
    ]
    order = list(_TITLES)
    return Index(tuple(sorted(pictures, key=lambda d: order.index(d.kind))), len(files), unit)
