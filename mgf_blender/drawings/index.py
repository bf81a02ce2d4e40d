# SPDX-License-Identifier: GPL-3.0-or-later
"""Read ``drawings.json``, the list of what ``mgf drawings`` made, again whenever it changes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..common.json_cache import JsonCache
from ..common.text import N_, tr

FOLDER, PAGE = "drawings", "drawings.html"
_TITLES = {"orthophoto": N_("Orthophoto {name}"), "deviation": N_("Deviation {name}")}
#: What the engine calls facades where it knows north, and the building from above.
_FRAMES = {
    "north": N_("north"), "north-east": N_("north-east"), "east": N_("east"), "south-east": N_("south-east"),
    "south": N_("south"), "south-west": N_("south-west"), "west": N_("west"), "north-west": N_("north-west"),
    "plan": N_("plan"),
}  # fmt: skip


@dataclass(frozen=True)
class Drawing:
    """A picture of a drawing: its file, its kind (a key of ``_TITLES``), and the facade or section that it shows."""

    path: Path
    kind: str
    frame: str

    @property
    def title(self) -> str:
        """For a button."""
        name, number = re.fullmatch(r"(.*?)(-\d+)?", self.frame, re.DOTALL).groups("")
        return tr(_TITLES[self.kind], name=tr(_FRAMES[name]) + number if name in _FRAMES else self.frame)


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


def read_index(job: Path) -> Index | None:
    """Read the drawings in a job folder; None where there are none, or where another program's file lies there."""
    return _indices.get(job / FOLDER / "drawings.json")


def _parsed(path: Path, data: dict[str, Any]) -> Index:
    files = {str(name): dict(facts) for name, facts in data["files"].items()}
    pictures = [
        Drawing(path.parent / name, str(facts.get("kind")), str(facts.get("frame", "")))
        for name, facts in files.items()
        if name.endswith(".png") and facts.get("kind") in _TITLES and Path(name).name == name
    ]
    order = list(_TITLES)
    return Index(tuple(sorted(pictures, key=lambda d: order.index(d.kind))), len(files), str(data["unit"]))


_indices = JsonCache(_parsed)
