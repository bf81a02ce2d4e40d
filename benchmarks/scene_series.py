# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that are hard by how they are built, flown or sized: rows of the failure map that no photo can be painted for.

Every level is a scene of its own from the generator, or the same scene worked on at fewer pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from benchmarks.camera_path import Ring
from benchmarks.catalogue import SCENES, SceneSpec
from benchmarks.suites import Options


@dataclass(frozen=True)
class Level:
    """One scene of a series: what the generator renders and what the engine is told."""

    spec: SceneSpec
    options: Options = field(default_factory=dict)


@dataclass(frozen=True)
class Series:
    """One way scenes get harder.

    Attributes:
        title, unit: for charts and tables.
        scenes: level -> scene, from harmless to hopeless.
        by_pixel: F1 is taken at two ground pixels of each level instead of 10 cm: the camera moves away.
        masks: where runs take their masks from.
    """

    title: str
    unit: str
    scenes: dict[float, Level]
    by_pixel: bool = False
    masks: str = "prompts"

    @property
    def levels(self) -> tuple[float, ...]:
        return tuple(self.scenes)


_DEMO, _TREES, _BARS = SCENES["demo"], SCENES["masks_trees"], SCENES["steel_frame_hall40"]
_BLOCK = replace(SCENES["masks_block"], wall="brick", photos=30, trees_in_front=0)
_BRACE = 2.1  # px of 480 that a brace of the frame is wide: 16 cm


def _farther(factor: float) -> SceneSpec:
    """The demo flown on orbits farther out and higher by a factor."""
    if factor == 1:
        return _DEMO
    return replace(
        _DEMO, rings=tuple(Ring(r.share, factor * r.height, factor * r.distance, r.aim) for r in _DEMO.rings)
    )


SERIES: dict[str, Series] = {
    "far": Series(
        "Camera farther away", "times", {factor: Level(_farther(factor)) for factor in (1, 1.5, 2.3, 3.5)},
        by_pixel=True,
    ),
    "bars": Series(
        "Thin bars: width of a brace", "px",
        {round(_BRACE * width / 480, 1): Level(_BARS, {"resolution": width}) for width in (480, 360, 240, 160)},
    ),
    "trees": Series(
        "Trees in front", "trees", {count: Level(replace(_TREES, trees_in_front=count)) for count in (0, 7, 14)}
    ),
    "neighbours": Series(
        "Neighbours of the same brick", "houses",
        {count: Level(replace(_TREES, neighbours=count)) for count in (0, 5, 9)},
    ),
    "repeats": Series(
        "Alike windows: texture of the walls", "of all",
        {share: Level(replace(_BLOCK, texture_strength=share)) for share in (1, 0.3, 0.1)},
    ),
}  # fmt: skip
