# SPDX-License-Identifier: GPL-3.0-or-later
"""Buildings of which every plane is known, as fine meshes with walls and roof, without floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mgf_engine.model.mesh import Mesh

Plane = tuple[float, float, float]  # z = a x + b y + c


@dataclass(frozen=True)
class Wing:
    """A box with a roof: the lowest of its planes over its rectangle (west, south, east, north)."""

    box: tuple[float, float, float, float]
    planes: Sequence[Plane]

    def heights(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Of its planes, [P, ...]; -inf beside the box."""
        west, south, east, north = self.box
        inside = (x > west) & (x < east) & (y > south) & (y < north)
        return np.where(inside, np.stack([a * x + b * y + c for a, b, c in self.planes]), -np.inf)


def gable(box: tuple[float, float, float, float], eaves: float, ridge: float, along_x: bool = True) -> Wing:
    """A gable roof; the ridge runs along x or along y."""
    west, south, east, north = box
    low, high = (south, north) if along_x else (west, east)
    slope = (ridge - eaves) / (0.5 * (high - low))
    up, down = eaves - slope * low, eaves + slope * high
    return Wing(box, [(0, slope, up), (0, -slope, down)] if along_x else [(slope, 0, up), (-slope, 0, down)])


def flat(box: tuple[float, float, float, float], height: float) -> Wing:
    """A flat roof."""
    return Wing(box, [(0, 0, height)])


def hip(box: tuple[float, float, float, float], eaves: float, slope: float) -> Wing:
    """A hip roof: four planes of one slope."""
    west, south, east, north = box
    return Wing(box, [(0, slope, eaves - slope * south), (0, -slope, eaves + slope * north),
                      (slope, 0, eaves - slope * west), (-slope, 0, eaves + slope * east)])  # fmt: skip


def volume(wings: Sequence[Wing], step: float = 0.02) -> float:
    """True volume over the ground at 0, by sums."""
    x, y = _middles(wings, step, 0.0)
    top = _top(wings, x, y)[0]
    return float(np.maximum(top, 0).sum()) * step**2


def building(wings: Sequence[Wing], step: float = 0.1, overhang: float = 0.0, noise: float = 0.005) -> Mesh:
    """The mesh: of each grid cell the piece of roof over it, and walls wherever heights differ.

    Args:
        overhang: by which the roof sheets reach beyond the walls.
        noise: standard deviation of every coordinate.
    """
    x, y = _middles(wings, step, overhang)
    wide = [Wing(_grown(wing.box, overhang), wing.planes) for wing in wings]
    (top, piece), (under, _) = _top(wide, x, y), _top(wings, x, y)
    planes = np.array([plane for wing in wings for plane in wing.planes])
    quads: list[np.ndarray] = []
    half = step / 2
    corner = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    row, column = np.nonzero(np.isfinite(top))
    at = np.stack([x[row, column], y[row, column]], 1)[:, None] + corner
    a, b, c = planes[piece[row, column]].T[..., None]
    quads.append(np.concatenate([at, (a * at[..., 0] + b * at[..., 1] + c)[..., None]], -1))
    walls = np.where(np.isfinite(under), piece, -1)
    for (dr, dc), ends in (((0, 1), (1, 2)), ((0, -1), (3, 0)), ((1, 0), (2, 3)), ((-1, 0), (0, 1))):
        other = np.roll(walls, (-dr, -dc), (0, 1))
        quads += _walls(x, y, walls, other, corner[list(ends)], planes, step)
    points = np.concatenate(quads).reshape(-1, 3)
    place, index = np.unique(np.round(points, 5), axis=0, return_inverse=True)
    quad = index.reshape(-1, 4)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)
    faces = faces[(faces != np.roll(faces, 1, 1)).all(1)]
    place = place + np.random.default_rng(0).normal(0, noise, place.shape)
    return Mesh(place, faces, np.full((len(place), 3), 128, np.uint8))


def _walls(x: np.ndarray, y: np.ndarray, own: np.ndarray, other: np.ndarray, ends: np.ndarray, planes: np.ndarray,
           step: float) -> list[np.ndarray]:  # fmt: skip
    """Upright quads from the neighbour's height up to the own, seen from the neighbour's side."""
    result = []
    for r, c in zip(*np.nonzero((own >= 0) & (own != other)), strict=True):
        at = ends + np.array([x[r, c], y[r, c]])
        high = at @ planes[own[r, c], :2] + planes[own[r, c], 2]
        low = at @ planes[other[r, c], :2] + planes[other[r, c], 2] if other[r, c] >= 0 else np.zeros(2)
        if (high - low).max() < 1e-6:
            continue
        count = max(1, round(float((high - low).max()) / step))
        for k in range(count):
            bottom, top = low + (high - low) * k / count, low + (high - low) * (k + 1) / count
            result.append(np.array([[*at[0], bottom[0]], [*at[1], bottom[1]], [*at[1], top[1]], [*at[0], top[0]]]))
    return [np.array(result)] if result else []


def _top(wings: Sequence[Wing], x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The height over each place, and the plane that makes it, numbered over all wings."""
    lowest = [wing.heights(x, y) for wing in wings]
    first = np.cumsum([0] + [len(wing.planes) for wing in wings[:-1]])
    heights = np.stack([h.min(0) for h in lowest])
    pieces = np.stack([start + h.argmin(0) for start, h in zip(first, lowest, strict=True)])
    wing = heights.argmax(0)
    return np.take_along_axis(heights, wing[None], 0)[0], np.take_along_axis(pieces, wing[None], 0)[0]


def _grown(box: tuple[float, float, float, float], by: float) -> tuple[float, float, float, float]:
    return box[0] - by, box[1] - by, box[2] + by, box[3] + by


def _middles(wings: Sequence[Wing], step: float, margin: float) -> tuple[np.ndarray, np.ndarray]:
    boxes = np.array([wing.box for wing in wings])
    low, high = boxes[:, :2].min(0) - margin - step, boxes[:, 2:].max(0) + margin + step
    count = np.rint((high - low) / step).astype(int)
    x, y = (low[k] + (np.arange(count[k]) + 0.5) * step for k in range(2))
    grid: Callable[..., tuple[np.ndarray, np.ndarray]] = np.meshgrid
    return grid(x, y)


BUILDINGS: dict[str, list[Wing]] = {
    "two wings": [gable((-6, -3, 6, 3), 4, 7), gable((-2, -8, 2, 3), 4, 6, along_x=False)],
    "church": [gable((-8, -3, 4, 3), 5, 9), flat((4, -2, 8, 2), 14)],
    "hip roof with a flat annex": [hip((-5, -4, 5, 4), 3, 0.8), flat((5, -2, 9, 2), 2.8)],
    "courtyard": [flat((-6, -6, 6, -3), 4), flat((-6, 3, 6, 6), 4), flat((-6, -6, -3, 6), 6), flat((3, -6, 6, 6), 4)],
    "shed roof": [Wing((-3, -2, 3, 2), [(0.3, 0, 3.5)])],
}
