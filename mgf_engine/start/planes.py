# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit planes through the lines of a building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.normals import unit_vectors
from mgf_engine.start.lines import Line3D
from mgf_engine.start.options import PlaneOptions

_MOST_PAIRED = 1500  # longest lines that are paired: the number of pairs is quadratic
_DIRECTION_ROUNDS = 5  # of the mean shift of a dominant direction


@dataclass(frozen=True)
class LinePlanes:
    """Planes through lines, [K, 4] (unit normal, offset), strongest first.

    Attributes:
        members: numbers of the lines of each plane.
        strength: length in px of the lines on each, limited where these run in one direction only, [K].
    """

    planes: NDArray[np.float64]
    members: list[NDArray[np.int64]]
    strength: NDArray[np.float64]

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the signed distances of points [N, 3] from the planes, [N, K]."""
        return np.asarray(points @ self.planes[:, :3].T + self.planes[:, 3])


@dataclass(frozen=True)
class _Lines:
    """Lines as arrays: ends ``a``, ``b`` [N, 3], unit ``direction`` [N, 3] and ``length`` [N]."""

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    direction: NDArray[np.float64]
    length: NDArray[np.float64]

    @classmethod
    def of(cls, lines: Sequence[Line3D]) -> _Lines:
        a, b = np.stack([line.ends[0] for line in lines]), np.stack([line.ends[1] for line in lines])
        return cls(a, b, unit_vectors(b - a), np.linalg.norm(b - a, axis=1))

    @property
    def middle(self) -> NDArray[np.float64]:
        return (self.a + self.b) / 2


def dominant_directions(
    directions: NDArray[np.float64], lengths: NDArray[np.float64], options: PlaneOptions
) -> NDArray[np.float64]:
    """Find the dominant directions of lines greedily, each by the length of the lines parallel to no earlier one.

    Args:
        directions: unit vectors of the lines, either sign, [N, 3].
        lengths: of the lines, [N].
        options: angles and shares.

    Returns:
        unit vectors [M, 3], most length first.
    """
    left = lengths.copy()
    found: list[NDArray[np.float64]] = []
    limit = np.cos(np.radians(options.direction_angle))
    parallel = np.abs(directions @ directions.T) > limit
    while len(found) < options.directions:
        votes = parallel @ left
        best = int(votes.argmax()) if len(votes) else 0
        if not len(votes) or votes[best] < options.direction_share * lengths.sum():
            break
        d = directions[best]
        for _ in range(_DIRECTION_ROUNDS):
            cosine = directions @ d
            near = np.abs(cosine) > limit
            d = (directions[near] * (np.sign(cosine[near]) * left[near])[:, None]).sum(0)
            d = d / max(float(np.linalg.norm(d)), 1e-30)
        found.append(d)
        left[near] = 0
    return np.array(found).reshape(-1, 3)


def fit_planes_to_lines(lines: Sequence[Line3D], pixel: float, options: PlaneOptions) -> LinePlanes:
    """Find planes through lines greedily, each by the length of its lines that lie on no earlier plane.

    Candidates are pairs of dominant directions at each line parallel to both, and pairs of lines that lie in one plane.

    Args:
        lines: in the normalised frame.
        pixel: size of a pixel at the building.
        options: lengths in pixels, angles and weights.
    """
    if len(lines) < 2:
        return LinePlanes(np.zeros((0, 4)), [], np.zeros(0))
    all_lines = _Lines.of(lines)
    regular, pairs = _planes_of_directions(all_lines, options), _planes_of_pairs(all_lines, pixel, options)
    candidates = np.concatenate([regular, pairs])
    selection = _Selection(all_lines, candidates, np.arange(len(candidates)) < len(regular), pixel, options)
    selection.take_unexplained()
    selection.take_separate()
    return LinePlanes(selection.planes, selection.members, np.array(selection.strength))


class _Selection:
    """Planes taken from candidates [C, 4] one after another, the one with most line length first.

    Attributes:
        planes: taken so far and fitted to their lines, [K, 4].
        members: numbers of the lines on each.
        strength: length in px of the lines on each (see LinePlanes).
    """

    def __init__(
        self,
        lines: _Lines,
        candidates: NDArray[np.float64],
        regular: NDArray[np.bool_],
        pixel: float,
        options: PlaneOptions,
    ) -> None:
        self.lines, self.candidates, self.regular, self.pixel, self.options = lines, candidates, regular, pixel, options
        self.inlier = _lines_on_planes(candidates, lines, options.near * pixel).astype(np.float32)
        self.weight = np.minimum(lines.length / pixel, options.longest)
        self.turned = np.abs(lines.direction @ lines.direction.T) < np.cos(np.radians(options.crossing))
        self.across = self.inlier * self.turned[np.where(self.inlier > 0, self.weight, 0).argmax(1)]
        self.taken = np.zeros(len(lines.length), np.int64)
        self.planes = np.zeros((0, 4))
        self.members: list[NDArray[np.int64]] = []
        self.strength: list[float] = []

    def take_unexplained(self) -> None:
        """Take planes until none carries enough length of lines that lie on no earlier one."""
        alive, distance = np.ones(len(self.candidates), bool), self.options.same_distance * self.pixel
        while len(self.planes) < self.options.most and alive.any():
            gain = self._gain(self.options.carried) * alive
            best = int(gain.argmax())
            if gain[best] < self.options.least:
                break
            alive[best] = False
            plane, mine = self._fit(best)
            if not len(mine):
                continue
            alive &= ~parallel_beside(self.candidates, plane, self.options.same_cosine, distance)
            if not parallel_beside(self.planes, plane, self.options.same_cosine, distance).any():
                self._add(plane, mine)

    def take_separate(self) -> None:
        """Take strong planes along two dominant directions where no parallel plane is near, most length first.

        All lines of a plain wall, its foot, corners and eaves, may lie on its neighbours: nothing of it is unexplained.
        """
        if not self.planes.size:
            return
        distance = self.options.rectangle_layer * self.pixel
        least = self.options.separate * float(np.median(self.strength))
        alive = self.regular.copy()
        for plane in self.planes:
            alive &= ~parallel_beside(self.candidates, plane, self.options.layer_cosine, distance)
        gain = self._gain((1.0, 1.0))
        order = np.argsort(-gain, kind="stable")
        for number in order[(alive & (gain >= self.options.least))[order]]:
            if not alive[number]:
                continue
            plane, mine = self._fit(int(number))
            if len(mine) and self._strength(mine) >= least:
                alive &= ~parallel_beside(self.candidates, plane, self.options.layer_cosine, distance)
                self._add(plane, mine)

    def _gain(self, carried: tuple[float, float]) -> NDArray[np.float64]:
        """Return the weighted length in px of the lines on each candidate, [C].

        Args:
            carried: weights of a line that lies on one plane taken before, and of a line that lies on several.
        """
        w = (self.weight * np.select([self.taken == 0, self.taken == 1], [1.0, carried[0]], carried[1])).astype("f4")
        whole, other = self.inlier @ w, self.across @ w  # what runs another way than the longest line must hold its own
        held = self.options.cross_factor * other + np.where(self.regular, self.options.regular_share * whole, 0)
        return np.asarray(np.where(self.regular, self.options.regular_weight, 1.0) * np.minimum(whole, held))

    def _fit(self, number: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Fit a candidate to its lines; returns the plane [4] and the lines on it, none where these are too few."""
        regular = bool(self.regular[number])
        plane = _fit_plane(self.candidates[number], self.inlier[number] > 0, self.lines, regular)
        mine = np.flatnonzero(_lines_on_planes(plane[None], self.lines, self.options.near * self.pixel)[0])
        return plane, mine if len(mine) >= (2 if regular else 3) else mine[:0]

    def _strength(self, mine: NDArray[np.int64]) -> float:
        """Return the length in px of lines on one plane, limited where these run in one direction only."""
        weight = self.weight[mine]
        crossing = self.turned[mine[weight.argmax()]][mine]
        held = self.options.cross_factor * weight[crossing].sum() + self.options.strength_share * weight.sum()
        return float(min(weight.sum(), held))

    def _add(self, plane: NDArray[np.float64], mine: NDArray[np.int64]) -> None:
        """Add a plane [4] on which the lines ``mine`` lie."""
        self.planes = np.concatenate([self.planes, plane[None]])
        self.members.append(mine)
        self.taken[mine] += 1
        self.strength.append(self._strength(mine))


def _lines_on_planes(planes: NDArray[np.float64], lines: _Lines, near: float) -> NDArray[np.bool_]:
    """Tell which lines lie within ``near`` of which planes [K, 4], bool [K, N]."""
    ends = (lines.a, lines.b)
    return np.asarray(np.all([np.abs(planes[:, :3] @ p.T + planes[:, 3:]) < near for p in ends], axis=0))


def parallel_beside(
    planes: NDArray[np.float64], plane: NDArray[np.float64], cosine: float, distance: float
) -> NDArray[np.bool_]:
    """Tell which planes are parallel to one and near it, bool [K].

    Args:
        planes: [K, 4].
        plane: the one, [4].
        cosine: between their normals from which two planes are parallel.
        distance: up to which they are near, in the units of the offsets.
    """
    along = planes[:, :3] @ plane[:3]
    near = np.abs(planes[:, 3] * np.sign(along) - plane[3]) < distance
    return np.asarray((np.abs(along) > cosine) & near)


def _planes_of_directions(lines: _Lines, options: PlaneOptions) -> NDArray[np.float64]:
    """Return candidates [C, 4] along two dominant directions, through each line that is parallel to both."""
    main, middle = dominant_directions(lines.direction, lines.length, options), lines.middle
    found = [np.zeros((0, 4))]
    for i in range(len(main)):
        for j in range(i):
            normal = np.cross(main[i], main[j])
            if np.linalg.norm(normal) < options.direction_sine:
                continue
            normal = normal / np.linalg.norm(normal)
            rows = np.abs(lines.direction @ normal) < np.sin(np.radians(options.along))
            found.append(np.c_[np.broadcast_to(normal, (rows.sum(), 3)), -(middle[rows] @ normal)])
    return np.concatenate(found)


def _planes_of_pairs(lines: _Lines, pixel: float, options: PlaneOptions) -> NDArray[np.float64]:
    """Return candidates [C, 4] through two lines that cross or run side by side, those of long lines first."""
    strong = np.argsort(-lines.length, kind="stable")[:_MOST_PAIRED]
    i, j = (strong[k] for k in np.triu_indices(len(strong), 1))
    d, middle = lines.direction, lines.middle
    cosine = np.abs((d[i] * d[j]).sum(1))
    beside = cosine > np.cos(np.radians(options.parallel))
    keep = beside | (cosine < np.cos(np.radians(options.crossing)))
    i, j, beside = i[keep], j[keep], beside[keep]
    across = middle[j] - middle[i]
    across -= (across * d[i]).sum(1)[:, None] * d[i]
    normal = np.where(beside[:, None], np.cross(d[i], across), np.cross(d[i], d[j]))
    size = np.linalg.norm(normal, axis=1)
    usable = (size > 1e-9) & (~beside | (np.linalg.norm(across, axis=1) > options.apart * pixel))
    i, j, normal = i[usable], j[usable], normal[usable] / size[usable, None]
    offset = -(normal * (middle[i] + middle[j]) / 2).sum(1)
    reach = [np.abs((normal * p).sum(1) + offset) for p in (lines.a[i], lines.a[j])]
    touch = np.flatnonzero(np.maximum(*reach) < options.near * pixel)
    shorter = np.minimum(lines.length[i[touch]], lines.length[j[touch]])
    touch = touch[np.argsort(-shorter, kind="stable")[: options.candidates]]
    return np.c_[normal[touch], offset[touch]]


def _fit_plane(
    plane: NDArray[np.float64], mine: NDArray[np.bool_], lines: _Lines, regular: bool
) -> NDArray[np.float64]:
    """Fit a plane [4] to its lines (bool [N]) by weighted least squares; a regular one keeps its direction."""
    rows = np.flatnonzero(mine)
    if regular:
        middle = np.average(lines.middle[rows], axis=0, weights=lines.length[rows])
        return np.r_[plane[:3], -plane[:3] @ middle]
    if len(rows) < 3:
        return plane
    points, weight = np.concatenate([lines.a[rows], lines.b[rows]]), np.r_[lines.length[rows], lines.length[rows]]
    centre = np.average(points, axis=0, weights=weight)
    normal = np.linalg.svd((points - centre) * np.sqrt(weight)[:, None], full_matrices=False)[2][2]
    return np.r_[normal, -normal @ centre]
