# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the drone's camera stands: rings around the building and nadir rows, with exact pinhole cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray


@dataclass(frozen=True)
class Shot:
    """One photo to take; ``camera = rotation @ world + translation``, COLMAP axes (x right, y down, z forward)."""

    name: str
    rotation: NDArray[np.float64]  # [3, 3]
    translation: NDArray[np.float64]  # [3]
    exposure: float = 0.0  # stops


@dataclass(frozen=True)
class Ring:
    """An orbit: ``share`` of the photos on an ellipse at a height and a distance from the footprint, metres.

    Cameras look at the building's middle. A distance below 0 lies inside the footprint, in a court; there each camera
    looks across, at what stands on the other side.
    """

    share: float
    height: float
    distance: float
    aim: float = 7.0  # height looked at

    @property
    def towards(self) -> float:
        """Place looked at between the middle (0) and the edge on the camera's side (1) or the other side (-1)."""
        return 0.25 if self.distance >= 0 else -0.7


def look_at(
    eye: NDArray[np.float64], target: NDArray[np.float64], roll: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World-to-camera rotation and translation of a camera at ``eye`` that looks at ``target``."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.98 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.stack([c * right + s * down, -s * right + c * down, forward])
    return rotation, -rotation @ eye


def plan(
    photos: int, extent: NDArray[np.float64], rings: tuple[Ring, ...], nadir: dict[str, Any] | None,
    exposure: float, exposure_spread: float, rng: Generator, arc: tuple[float, float] = (0.0, 360.0),
) -> list[Shot]:  # fmt: skip
    """Return the shots of one flight.

    Args:
        photos: number of photos over all rings and the nadir rows.
        extent: [2, 2] low and high corner of the building on the ground.
        rings: orbits; shares that do not add up to 1 leave the rest to the nadir rows.
        nadir: ``{"height", "half_x", "half_y"}`` of rows straight down, or None.
        exposure, exposure_spread: mean and standard deviation of the exposure in stops.
        arc: part of each ring that is flown, degrees counter-clockwise from the x axis.
    """
    middle, half = extent.mean(0), (extent[1] - extent[0]) / 2
    counts = [round(photos * ring.share) for ring in rings]
    rest = photos - sum(counts)
    whole, first = np.radians(arc[1] - arc[0]), np.radians(arc[0])
    if nadir is None:
        counts[-1] += rest
        rest = 0
    eyes: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for number, (ring, count) in enumerate(zip(rings, counts, strict=True)):
        for i in range(count):
            angle = first + whole * (i + 0.5 * number) / count + rng.normal(0, 0.02)
            around = np.array([np.cos(angle), np.sin(angle)])
            ground = middle + (half + ring.distance * (1 + rng.normal(0, 0.02))) * around
            eye = np.array([*ground, ring.height * (1 + rng.normal(0, 0.02))])
            target = np.array([*(middle + ring.towards * half * around), ring.aim]) + rng.normal(0, 0.5, 3)
            eyes.append((eye, target))
    if nadir is not None and rest > 0:
        columns = max(1, round(np.sqrt(rest * nadir["half_x"] / nadir["half_y"])))
        rows = int(np.ceil(rest / columns))
        for i in range(rest):
            row, column = divmod(i, columns)
            x = nadir["half_x"] * (2 * (column + 0.5) / columns - 1)
            y = nadir["half_y"] * (2 * (row + 0.5) / rows - 1)
            eye = np.array([middle[0] + x, middle[1] + y, nadir["height"]]) + rng.normal(0, 0.3, 3)
            eyes.append((eye, eye * [1, 1, 0] + rng.normal(0, 0.4, 3) * [1, 1, 0]))
    shots = []
    for i, (eye, target) in enumerate(eyes):
        rotation, translation = look_at(eye, target, float(rng.normal(0, 0.01)))
        shots.append(Shot(f"photo_{i:03d}.jpg", rotation, translation, float(rng.normal(exposure, exposure_spread))))
    return shots
