# SPDX-License-Identifier: GPL-3.0-or-later
"""Building blocks of the synthetic scenes: named polygon soups made with numpy, in metres, z up.

Nothing here knows Blender: the same parts become the rendered scene and the true mesh.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """One object of a scene.

    Attributes:
        name: unique in its scene.
        material: key into the table of materials.
        vertices: float64 [N, 3], metres.
        faces: polygons (convex, planar), counter-clockwise seen from outside.
        element: name of the second-level element it belongs to; empty for plain structure.
        building: true for what the reconstruction should hold; false for its surroundings.
    """

    name: str
    material: str
    vertices: Points
    faces: tuple[tuple[int, ...], ...]
    element: str = ""
    building: bool = True

    def triangles(self) -> Points:
        """Fans of all polygons, float64 [T, 3, 3]."""
        rows = [(f[0], f[i], f[i + 1]) for f in self.faces for i in range(1, len(f) - 1)]
        return self.vertices[np.array(rows, dtype=np.int64).reshape(-1, 3)]


@dataclass(frozen=True)
class Opening:
    """A hole in a wall, in the wall's own frame: u from its left end, v from its foot, metres.

    Attributes:
        u0, v0, u1, v1: its left, foot, right and top.
        kind: what fills it.
        rise: height of its arched head, which ends at ``v1``; half the width is a semicircle, 0 a level lintel.
    """

    u0: float
    v0: float
    u1: float
    v1: float
    kind: str = "window"
    rise: float = 0.0

    @property
    def head(self) -> list[tuple[float, float]]:
        """Corners of the upper end from right to left."""
        if not self.rise:
            return [(self.u1, self.v1), (self.u0, self.v1)]
        half, middle = (self.u1 - self.u0) / 2, (self.u0 + self.u1) / 2
        radius = (half**2 + self.rise**2) / (2 * self.rise)
        end = np.arctan2(half, radius - self.rise)
        at = [(middle + radius * np.sin(t), self.v1 - radius * (1 - np.cos(t))) for t in np.linspace(end, -end, 17)]
        return [(self.u1, at[0][1]), *at[1:8], (middle, self.v1), *at[9:16], (self.u0, at[-1][1])]

    def top_at(self, u: float) -> float:
        """Return the height of the upper end there."""
        right, above = zip(*self.head[::-1], strict=True)
        return float(np.interp(u, right, above))


@dataclass(frozen=True)
class Casing:
    """How the openings of a wall are cased.

    Attributes:
        depth: of their reveals, metres.
        trim: material of reveals and surrounds.
        surround: whether a band runs around each opening.
    """

    depth: float = 0.18
    trim: str = "stone"
    surround: bool = True


@dataclass
class Builder:
    """Collects parts; faces with one element and material become one part."""

    building: bool = True
    prefix: str = ""
    _soup: dict[tuple[str, str], tuple[list[Points], list[tuple[int, ...]]]] = field(default_factory=dict)

    def polygon(self, corners: Iterable[ArrayLike], material: str, element: str = "") -> None:
        """Add one planar convex polygon, counter-clockwise seen from outside."""
        points = np.array(list(corners), dtype=np.float64)
        store, faces = self._soup.setdefault((element, material), ([], []))
        start = sum(len(block) for block in store)
        store.append(points)
        faces.append(tuple(range(start, start + len(points))))

    def mesh(self, vertices: Points, faces: Iterable[tuple[int, ...]], material: str, element: str = "") -> None:
        """Add a ready mesh."""
        store, rows = self._soup.setdefault((element, material), ([], []))
        start = sum(len(block) for block in store)
        store.append(np.asarray(vertices, dtype=np.float64))
        rows.extend(tuple(i + start for i in face) for face in faces)

    def box(self, low: Sequence[float], high: Sequence[float], material: str, element: str = "") -> None:
        """Add an axis-aligned box."""
        low_, high_ = np.array(low, dtype=float), np.array(high, dtype=float)
        self.bar((low_ + high_) / 2, np.eye(3), (high_ - low_) / 2, material, element)

    def bar(self, centre: ArrayLike, axes: Points, half: Sequence[float], material: str, element: str = "") -> None:
        """Add a box with its own axes (rows of a rotation) and half sizes."""
        signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=float)
        corners = np.asarray(centre) + (signs * np.asarray(half)) @ np.asarray(axes)
        quads = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
        self.mesh(corners, quads, material, element)

    def beam(self, start: ArrayLike, end: ArrayLike, width: float, material: str, element: str = "") -> None:
        """Add a square beam between two points."""
        a, b = np.array(start, dtype=float), np.array(end, dtype=float)
        along = (b - a) / np.linalg.norm(b - a)
        guess = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        side = np.cross(guess, along)
        side /= np.linalg.norm(side)
        axes = np.stack([along, side, np.cross(along, side)])
        self.bar((a + b) / 2, axes, (float(np.linalg.norm(b - a)) / 2, width / 2, width / 2), material, element)

    def wall(
        self,
        left: Sequence[float],
        right: Sequence[float],
        heights: tuple[float, float],
        material: str,
        openings: Sequence[Opening] = (),
        element: str = "",
        gable: float = 0.0,
        casing: Casing = Casing(),
    ) -> None:
        """Add a vertical wall with real openings: reveals, frames, panes and a surround.

        Args:
            left, right: ground points [2] as seen from outside.
            heights: of its foot and its top.
            material: of the wall.
            openings: holes in the wall's frame; they must not overlap.
            element: second-level element it belongs to.
            gable: height of a triangle on top of the wall.
            casing: of all openings.
        """
        foot, top = heights
        frame = WallFrame.make(left, right, foot)
        height = top - foot
        cuts_u = sorted({0.0, frame.length, *(o.u0 for o in openings), *(o.u1 for o in openings)})
        cuts_v = sorted({0.0, height, *(o.v0 for o in openings), *(o.v1 for o in openings)})
        for u0, u1 in pairwise(cuts_u):
            for v0, v1 in pairwise(cuts_v):
                middle_u, middle_v = (u0 + u1) / 2, (v0 + v1) / 2
                if not any(o.u0 < middle_u < o.u1 and o.v0 < middle_v < o.v1 for o in openings):
                    self.polygon(frame.rectangle(u0, v0, u1, v1, 0.0), material, element)
        for hole in openings:
            for (u1, v1), (u0, v0) in pairwise(hole.head if hole.rise else ()):
                corners = dict.fromkeys([(u0, v0), (u1, v1), (u1, hole.v1), (u0, hole.v1)])
                self.polygon([frame.point(*corner, 0.0) for corner in corners], material, element)
        if gable > 0:
            apex = frame.point(frame.length / 2, height + gable, 0.0)
            self.polygon([frame.point(0, height, 0), frame.point(frame.length, height, 0), apex], material, element)
        for number, hole in enumerate(openings):
            name = f"{element}.{hole.kind}{number}" if element else f"{hole.kind}{number}"
            self._fill(frame, hole, name, casing)

    def _fill(self, frame: WallFrame, hole: Opening, element: str, casing: Casing) -> None:
        """Reveals, a surround, and the window or door itself."""
        depth, trim = casing.depth, casing.trim
        u0, v0, u1, v1 = hole.u0, hole.v0, hole.u1, hole.v1
        p = frame.point
        rim = [(u0, v0), (u1, v0), *hole.head]
        for start, end in zip(rim, rim[1:] + rim[:1], strict=True):
            self.polygon([p(*start, 0), p(*end, 0), p(*end, -depth), p(*start, -depth)], trim, "")
        if hole.kind == "void":
            return
        filling = {"window": "glass", "door": "wood", "gate": "metal_door"}[hole.kind]
        self.polygon([p(*corner, -depth) for corner in rim], filling, element)
        bar, spring = 0.07, hole.head[0][1]
        bars = [(u0, u0 + bar, v0, spring), (u1 - bar, u1, v0, spring), (u0, u1, v0, v0 + bar)]
        if not hole.rise:
            bars.append((u0, u1, v1 - bar, v1))
        if hole.kind == "window":
            count = max(1, round((u1 - u0) / 0.8))
            for c in (u0 + (u1 - u0) * i / count for i in range(1, count)):
                bars.append((c - bar / 2, c + bar / 2, v0, hole.top_at(c)))
            if hole.rise > 0.3:
                bars.append((u0, u1, spring - bar / 2, spring + bar / 2))
            elif v1 - v0 > 1.3:
                cross = v0 + 0.68 * (v1 - v0)
                bars.append((u0, u1, cross - bar / 2, cross + bar / 2))
        for a, b, c, d in bars:
            self._slab(frame, (a, c, b, d), (-depth, -depth + 0.06), "frame", element)
        if hole.rise:
            self._arch(frame, hole.head, -bar, (-depth, -depth + 0.06), "frame", element)
        if casing.surround:
            t, out = 0.16, (0.0, 0.05)
            if hole.rise:
                self._arch(frame, hole.head, t, out, trim, "")
            else:
                self._slab(frame, (u0 - t, v1, u1 + t, v1 + t), out, trim, "")
            self._slab(frame, (u0 - t, v0, u0, spring), out, trim, "")
            self._slab(frame, (u1, v0, u1 + t, spring), out, trim, "")
            if hole.kind == "window":
                self._slab(frame, (u0 - t, v0 - 0.12, u1 + t, v0), (0.0, 0.1), trim, "")

    def _slab(self, frame: WallFrame, box: tuple[float, ...], depth: tuple[float, float], material: str,
              element: str) -> None:  # fmt: skip
        """A box lying on a wall: from u0, v0 to u1, v1 along it, and from its back to its front."""
        (u0, v0, u1, v1), (back, front) = box, depth
        axes = np.stack([frame.along, np.array([0.0, 0.0, 1.0]), frame.out])
        centre = frame.point((u0 + u1) / 2, (v0 + v1) / 2, (back + front) / 2)
        self.bar(centre, axes, ((u1 - u0) / 2, (v1 - v0) / 2, (front - back) / 2), material, element)

    def _arch(self, frame: WallFrame, head: Sequence[tuple[float, float]], wide: float, depth: tuple[float, float],
              material: str, element: str) -> None:  # fmt: skip
        """Straight boxes along an arched head, ``wide`` upwards from it, and from their back to their front."""
        (back, front), up = depth, np.array([0.0, 0.0, 1.0])
        for (u1, v1), (u0, v0) in pairwise(head):
            length = float(np.hypot(u1 - u0, v1 - v0))
            along = ((u1 - u0) * frame.along + (v1 - v0) * up) / length
            across = ((u1 - u0) * up - (v1 - v0) * frame.along) / length
            centre = frame.point((u0 + u1) / 2, (v0 + v1) / 2, (back + front) / 2) + 0.5 * wide * across
            half = (length / 2, abs(wide) / 2, (front - back) / 2)
            self.bar(centre, np.stack([along, across, frame.out]), half, material, element)

    def roof_slab(self, quad: Sequence[ArrayLike], thickness: float, material: str, edge: str, element: str) -> None:
        """A plate of some thickness under a planar polygon that is counter-clockwise seen from outside."""
        top = np.array(quad, dtype=float)
        normal = np.cross(top[1] - top[0], top[2] - top[0])
        low = top - normal / np.linalg.norm(normal) * thickness
        self.polygon(top, material, element)
        self.polygon(low[::-1], edge, "")
        for i in range(len(top)):
            j = (i + 1) % len(top)
            self.polygon([low[i], low[j], top[j], top[i]], edge, "")

    def parts(self) -> list[Part]:
        """Return everything added so far, one part per element and material."""
        result = []
        for (element, material), (blocks, faces) in self._soup.items():
            name = f"{self.prefix}{element or 'structure'}:{material}"
            result.append(Part(name, material, np.concatenate(blocks), tuple(faces), element, self.building))
        return result


@dataclass(frozen=True)
class WallFrame:
    """Coordinates on a wall: u along, v up, w outwards."""

    origin: Points
    along: Points
    out: Points
    length: float

    @classmethod
    def make(cls, left: Sequence[float], right: Sequence[float], foot: float) -> WallFrame:
        a, b = np.array([*left[:2], foot], dtype=float), np.array([*right[:2], foot], dtype=float)
        length = float(np.linalg.norm(b - a))
        along = (b - a) / length
        return cls(a, along, np.cross(along, [0.0, 0.0, 1.0]), length)

    def point(self, u: float, v: float, w: float) -> Points:
        return self.origin + u * self.along + np.array([0.0, 0.0, v]) + w * self.out

    def rectangle(self, u0: float, v0: float, u1: float, v1: float, w: float) -> list[Points]:
        return [self.point(u0, v0, w), self.point(u1, v0, w), self.point(u1, v1, w), self.point(u0, v1, w)]


def wall_row(
    length: float, count: int, width: float, foot: float, height: float, kind: str = "window"
) -> list[Opening]:
    """Evenly spaced openings of one floor."""
    pitch = length / count
    return [
        Opening((i + 0.5) * pitch - width / 2, foot, (i + 0.5) * pitch + width / 2, foot + height, kind)
        for i in range(count)
    ]


def true_mesh(parts: Iterable[Part]) -> tuple[Points, NDArray[np.int32]]:
    """Return the building's triangles as one mesh with equal corners merged: vertices [N, 3], faces [F, 3]."""
    vertices, faces, _ = labelled_mesh([p for p in parts if p.building])
    return vertices, faces


def labelled_mesh(parts: Sequence[Part]) -> tuple[Points, NDArray[np.int32], NDArray[np.int32]]:
    """All triangles as one mesh with equal corners merged: vertices [N, 3], faces [F, 3], each face's part [F]."""
    triangles = [p.triangles() for p in parts]
    keys, index = np.unique(np.round(np.concatenate(triangles).reshape(-1, 3), 5), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int32)
    owner = np.repeat(np.arange(len(triangles), dtype=np.int32), [len(t) for t in triangles])
    good = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return keys, faces[good], owner[good]
