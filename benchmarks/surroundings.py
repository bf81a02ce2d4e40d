# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands around the building in the synthetic scenes: ground, paths, neighbours, trees, cars."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.shapes import Builder, Part, wall_row


def surroundings(
    extent: NDArray[np.float64],
    eyes: NDArray[np.float64],
    rng: Generator,
    trees: int,
    trees_in_front: int,
    neighbours: int,
    cars: int,
    wall: str,
) -> list[Part]:
    """Everything but the building.

    Args:
        extent: [2, 2] low and high corner of the building on the ground, metres.
        eyes: [N, 3] camera centres; nothing is put where a camera stands.
        rng: source of all randomness.
        trees: trees around; ``trees_in_front``: trees close to the walls, which hide parts of them.
        neighbours: plain houses of a similar colour.
        cars: parked cars.
        wall: wall material of the neighbours.
    """
    parts = _ground(extent)
    low, high = extent
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    low_eyes = eyes[eyes[:, 2] < 15.0, :2]
    taken: list[tuple[NDArray[np.float64], float]] = [(eye, 1.0) for eye in low_eyes]
    for i in range(neighbours):
        spot = _free_spot(middle, (reach + 16, reach + 34), 11.0, taken, rng)
        taken.append((spot, 11.0))
        parts += _house(f"neighbour{i}.", spot, rng.uniform(0, 2 * np.pi), rng, wall)
    for i in range(trees):
        spot = _free_spot(middle, (reach + 5, reach + 32), 3.0, taken, rng)
        taken.append((spot, 3.0))
        parts += tree(f"tree{i}.", spot, rng.uniform(5, 10), rng)
    for i in range(trees_in_front):
        spot = _spot_before(i % 4, low, high, rng)
        parts += tree(f"front_tree{i}.", spot, rng.uniform(4.0, 7.0), rng)
    for i in range(cars):
        spot = np.array(
            [low[0] + (i + 0.5) * (high - low)[0] / max(cars, 1) + rng.uniform(-1, 1), low[1] - rng.uniform(9.2, 10.0)]
        )
        parts += car(f"car{i}.", spot, rng)
    return parts


def _spot_before(side: int, low: NDArray[np.float64], high: NDArray[np.float64], rng: Generator) -> NDArray[np.float64]:
    """A place close to one of the four sides of the building."""
    share, gap = rng.uniform(0.12, 0.88), rng.uniform(2.6, 4.0)
    along = low + share * (high - low)
    return np.array([(along[0], low[1] - gap), (high[0] + gap, along[1]), (along[0], high[1] + gap),
                     (low[0] - gap, along[1])][side])  # fmt: skip


def _free_spot(middle: NDArray[np.float64], reach: tuple[float, float], radius: float,
               taken: list[tuple[NDArray[np.float64], float]], rng: Generator) -> NDArray[np.float64]:  # fmt: skip
    """A place in a ring around the building that keeps clear of what is taken; the best of many tries."""
    best, room = middle, -np.inf
    for _ in range(200):
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(*reach)
        spot = middle + far * np.array([np.cos(angle), np.sin(angle)])
        gap = min((float(np.linalg.norm(spot - c)) - r - radius for c, r in taken), default=np.inf)
        if gap > 0:
            return spot
        if gap > room:
            best, room = spot, gap
    return best


def _ground(extent: NDArray[np.float64]) -> list[Part]:
    b = Builder(building=False, prefix="ground.")
    low, high = extent
    big = 3000.0
    b.polygon([(-big, -big, -0.02), (big, -big, -0.02), (big, big, -0.02), (-big, big, -0.02)], "grass")
    m = 3.0
    b.polygon(
        [
            (low[0] - m, low[1] - m, 0),
            (high[0] + m, low[1] - m, 0),
            (high[0] + m, high[1] + m, 0),
            (low[0] - m, high[1] + m, 0),
        ],
        "paving",
    )
    s = low[1] - 8.0
    b.polygon([(-big, s - 7, 0.0), (big, s - 7, 0.0), (big, s, 0.0), (-big, s, 0.0)], "asphalt")
    b.polygon([(-2.5, s, 0.005), (2.5, s, 0.005), (2.5, low[1] - m, 0.005), (-2.5, low[1] - m, 0.005)], "paving")
    for x in np.arange(-60, 60, 6.0):
        b.polygon([(x, s - 3.6, 0.01), (x + 3, s - 3.6, 0.01), (x + 3, s - 3.45, 0.01), (x, s - 3.45, 0.01)], "paint")
    return b.parts()


def _turn(parts: list[Part], centre: NDArray[np.float64], angle: float) -> list[Part]:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    offset = np.array([centre[0], centre[1], 0.0])
    return [Part(p.name, p.material, p.vertices @ turn + offset, p.faces, "", False) for p in parts]


def _house(name: str, centre: NDArray[np.float64], angle: float, rng: Generator, wall: str) -> list[Part]:
    b = Builder(building=False, prefix=name)
    x, y, eaves = rng.uniform(5, 7.5), rng.uniform(4, 5), rng.uniform(5, 6.5)
    ridge = eaves + rng.uniform(2.8, 4.0)
    floors = [hole for foot in (1.0, 3.8) for hole in wall_row(2 * x, 4, 1.1, foot, 1.4) if foot + 1.4 < eaves - 0.3]
    ends = [hole for foot in (1.0,) for hole in wall_row(2 * y, 2, 1.1, foot, 1.4)]
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for i in range(4):
        b.wall(
            corners[i],
            corners[(i + 1) % 4],
            (0, eaves),
            wall,
            floors if i % 2 == 0 else ends,
            gable=ridge - eaves if i % 2 else 0.0,
        )
    low = eaves - (ridge - eaves) / y * 0.4 + 0.2
    for s in (-1, 1):
        quad = [
            (-x - 0.4, s * (y + 0.4), low),
            (x + 0.4, s * (y + 0.4), low),
            (x + 0.4, 0, ridge + 0.2),
            (-x - 0.4, 0, ridge + 0.2),
        ]
        b.roof_slab(quad if s < 0 else quad[::-1], 0.2, "tiles", "wood_trim", "")
    return _turn(b.parts(), centre, angle)


def tree(name: str, spot: NDArray[np.float64], height: float, rng: Generator) -> list[Part]:
    """A tree of a tapered trunk and some thousands of leaf quads around a few branch ends."""
    b = Builder(building=False, prefix=name)
    root = np.array([spot[0], spot[1], 0.0])
    crown = 0.36 * height
    b.beam(root, root + np.array([0, 0, 0.6 * height]), 0.03 * height + 0.06, "bark")
    blobs = root + [0, 0, 0.66 * height] + rng.normal(size=(9, 3)) * [crown * 0.42, crown * 0.42, crown * 0.42]
    for end in blobs:
        b.beam(root + np.array([0, 0, 0.42 * height]), end, 0.015 * height, "bark")
    count = int(240 * height)
    middle = blobs[rng.integers(0, len(blobs), count)]
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centre = middle + direction * crown * 0.5 * rng.uniform(0.5, 1.05, (count, 1))
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(u, direction + 0.3 * rng.normal(size=(count, 3)))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    size = rng.uniform(0.10, 0.2, (count, 1)) * (height / 8) ** 0.5
    quads = np.stack(
        [
            centre - size * u - size * v,
            centre + size * u - size * v,
            centre + size * u + size * v,
            centre - size * u + size * v,
        ],
        1,
    )
    b.mesh(quads.reshape(-1, 3), [(4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3) for i in range(count)], "leaves")
    return b.parts()


def car(name: str, spot: NDArray[np.float64], rng: Generator) -> list[Part]:
    """A parked car of a random colour."""
    b = Builder(building=False, prefix=name)
    paint = str(rng.choice(["car_red", "car_white", "car_blue", "car_grey"]))
    side = [(-2.1, 0.35), (2.1, 0.35), (2.15, 0.75), (1.3, 0.9), (0.8, 1.42), (-1.1, 1.45), (-1.9, 0.95), (-2.15, 0.85)]
    _extrude(b, [(x, z) for x, z in side], 0.82, paint)
    glass = [(1.2, 0.92), (0.78, 1.36), (-1.05, 1.39), (-1.75, 0.98)]
    _extrude(b, glass, 0.83, "glass")
    for x in (-1.35, 1.35):
        wheel = [(x + 0.33 * np.cos(t), 0.33 + 0.33 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 13)[:-1]]
        _extrude(b, wheel, 0.86, "rubber")
    return _turn(b.parts(), spot, float(rng.uniform(-0.06, 0.06)))


def _extrude(b: Builder, outline: list[tuple[float, float]], half: float, material: str) -> None:
    """A prism along y from an outline in (x, z), counter-clockwise seen from -y."""
    b.polygon([(x, -half, z) for x, z in outline], material)
    b.polygon([(x, half, z) for x, z in outline[::-1]], material)
    for (x0, z0), (x1, z1) in zip(outline, outline[1:] + outline[:1], strict=True):
        b.polygon([(x1, -half, z1), (x0, -half, z0), (x0, half, z0), (x1, half, z1)], material)
