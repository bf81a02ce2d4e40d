# SPDX-License-Identifier: GPL-3.0-or-later
"""Chains of pixel corners made into few straight lines that meet: what a draughtsman would have drawn.

A chain is split where it turns (Douglas and Peucker), a line of least squares is put through each part, or the line
where its two planes meet; nearly level and upright lines become so; neighbours are brought to where they cross, and
chains that meet in one place end in one point. No point moves further than a few pixels, no long line by more than one,
except where a border is frayed (:mod:`mgf_engine.drawings.fraying`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.fraying import FrayedPart, FrayOptions, frayed_parts
from mgf_engine.options.algorithms import parameter

Array = NDArray[np.float64]
_KNOWN_TURN = 0.3  # sine of the largest angle between a segment and a known line


@dataclass(frozen=True)
class StraightenOptions:
    """Options of the straightening of borders."""

    split: float = parameter(2.0, "Tolerance of the polygon simplification (Douglas and Peucker)", "ground px")
    short: float = parameter(8.0, "Length below which a part gives way to the crossing of its neighbours", "ground px")
    level_shift: float = parameter(1.0, "Largest move of the end of a line that is made level or upright", "ground px")
    level_angle: float = parameter(6.0, "Largest angle of a line that is made level or upright", "degrees", high=45)
    crossing_angle: float = parameter(
        12.0, "Smallest angle between two lines that are extended to their crossing", "degrees", high=90
    )
    meeting_distance: float = parameter(
        4.0, "Largest distance of a crossing from the corner that it replaces", "ground px"
    )
    apart: float = parameter(
        1.5, "Distance of two level or upright lines from which they do not end in one point", "ground px"
    )
    plane_line_distance: float = parameter(
        1.5, "Largest distance of a border from the line where its two planes meet", "ground px"
    )
    same_angle: float = parameter(1.5, "Largest angle between two lines that are merged", "degrees", high=90)
    corner: float = parameter(2.5, "Length at both ends of a part that its line is not fitted to", "ground px")
    same_distance: float = parameter(0.6, "Largest distance between two lines that are merged", "ground px")
    fray: FrayOptions = FrayOptions()


@dataclass
class FittedSegment:
    """A straight part of a chain, by the line fitted to it.

    Attributes:
        at: a point on the line, [2].
        along: its unit direction, [2].
        length: of the part.
        known: whether planes of the mesh give the line.
    """

    at: Array
    along: Array
    length: float
    known: bool = False

    @property
    def upright(self) -> bool:
        return bool(self.along[0] == 0.0)

    @property
    def level(self) -> bool:
        return bool(self.along[1] == 0.0)

    def nearest(self, point: Array) -> Array:
        """Return the point of the line nearest to a point, [2]."""
        return np.asarray(self.at + self.along * float(self.along @ (point - self.at)))


@dataclass
class Stroke:
    """A chain as straight segments with the points between them.

    Attributes:
        segments: in order; points: [len(segments) + 1, 2], the first and last are its ends.
        ends: as of the chain.
    """

    segments: list[FittedSegment]
    points: Array
    ends: tuple[int, int]

    @property
    def closed(self) -> bool:
        return self.ends[0] == self.ends[1]


def straighten(
    corners: Array,
    ends: tuple[int, int],
    pixel: float,
    known: Array | None = None,
    options: StraightenOptions = StraightenOptions(),
    frayed: bool = False,
) -> Stroke:
    """Return a chain as straight segments.

    Args:
        corners: [n, 2], drawing coordinates.
        ends: numbers of the places where the chain ends.
        pixel: a ground pixel.
        known: lines ``a x + b y + c = 0`` with (a, b) of length 1 that planes give, such as where those on both sides
            meet, and where along (b, -a) each begins and ends, [K, 5]; a segment near one lies on it.
        options: how far a segment may leave the chain, and what counts as level or upright.
        frayed: whether the chain may wander about a known, level or upright line, as borders between regions do.
    """
    closed = ends[0] == ends[1]
    if closed:
        corners = _roll_to_longest(_roll_to_corner(corners), options.split * pixel)
    segments, at = _without_short(*_fit_segments(corners, pixel, known, options, frayed), pixel, closed, options)
    points = at.copy()
    for k in range(1, len(segments)):
        points[k] = crossing([segments[k - 1], segments[k]], at[k], pixel, options)
    if closed and len(segments) > 1:
        points[0] = points[-1] = crossing([segments[-1], segments[0]], at[0], pixel, options)
    elif not closed:
        points[0], points[-1] = segments[0].nearest(at[0]), segments[-1].nearest(at[-1])
    return Stroke(segments, points, ends)


def turn(one: Array, other: Array) -> float:
    """Compute the sine of the angle from one unit vector [2] to another."""
    return float(one[0] * other[1] - one[1] * other[0])


def douglas_peucker(points: Array, tolerance: float) -> list[int]:
    """Keep the rows of a polyline [n, 2] that it needs so that it nowhere leaves the rest by more (Douglas and
    Peucker)."""
    kept, left = {0, len(points) - 1}, [(0, len(points) - 1)]
    while left:
        i, j = left.pop()
        if j - i < 2:
            continue
        span = points[j] - points[i]
        length = float(np.hypot(*span))
        off = points[i + 1 : j] - points[i]
        away = np.abs(off[:, 0] * span[1] - off[:, 1] * span[0]) / length if length > 0 else np.hypot(*off.T)
        worst = int(away.argmax())
        if away[worst] > tolerance:
            kept.add(i + 1 + worst)
            left += [(i, i + 1 + worst), (i + 1 + worst, j)]
    return sorted(kept)


def crossing(
    segments: list[FittedSegment], place: Array, pixel: float, options: StraightenOptions = StraightenOptions()
) -> Array:
    """Find the point where lines meet near a place [2], by least squares; level, upright and known lines weigh more.

    Args:
        segments: lines that meet there.
        place: [2], drawing coordinates.
        pixel: a ground pixel.
        options: how far from the place they may cross; where it is further, the nearest points of the lines count.
    """
    matrix, right = 1e-9 * np.eye(2), 1e-9 * place
    weights = [s.length * (100.0 if s.known or s.upright or s.level else 1.0) for s in segments]
    for segment, weight in zip(segments, weights, strict=True):
        across = np.array([-segment.along[1], segment.along[0]])
        matrix = matrix + weight * np.outer(across, across)
        right = right + weight * across * float(across @ segment.at)
    steepest = max(
        (abs(turn(a.along, b.along)) for k, a in enumerate(segments) for b in segments[k + 1 :]), default=0.0
    )
    nearest = [segment.nearest(place) for segment in segments]
    if steepest < np.sin(np.radians(options.crossing_angle)):
        return np.asarray(np.mean(nearest, axis=0))
    found = np.linalg.solve(matrix, right)
    if np.hypot(*(found - place)) > options.meeting_distance * pixel:
        found = np.average(nearest, axis=0, weights=weights)
    return np.asarray(found, np.float64)


def join_ends(
    strokes: list[Stroke], places: dict[int, Array], pixel: float, options: StraightenOptions = StraightenOptions()
) -> None:
    """Bring all strokes that end in one place to one point.

    Args:
        strokes: changed in place.
        places: number -> where the place is, [2].
        pixel: a ground pixel.
        options: how far an end may be moved.
    """
    meeting: dict[int, list[tuple[Stroke, int]]] = {}
    for stroke in strokes:
        if not stroke.closed:
            meeting.setdefault(stroke.ends[0], []).append((stroke, 0))
            meeting.setdefault(stroke.ends[1], []).append((stroke, -1))
    for place, members in meeting.items():
        if len(members) > 1:
            _join(members, places[place], pixel, options)


def _join(members: list[tuple[Stroke, int]], place: Array, pixel: float, options: StraightenOptions) -> None:
    """Bring the ends of strokes to one point, or to two where upright or level ones lie apart.

    The edge of a roof and the wall below are such: then each of these keeps its line, and the others reach over both.

    Args:
        members: strokes and which end of each, 0 or -1; changed in place.
        place: where they meet, [2].
        pixel: a ground pixel.
        options: how far an end may be moved.
    """
    segments = [stroke.segments[end] for stroke, end in members]
    for axis, along in ((0, [segment.upright for segment in segments]), (1, [segment.level for segment in segments])):
        own = [k for k, yes in enumerate(along) if yes]
        values = np.array([segments[k].at[axis] for k in own])
        if len(own) < 2 or np.ptp(values) <= options.apart * pixel:
            continue
        others = [segment for segment, yes in zip(segments, along, strict=True) if not yes]
        groups = values > 0.5 * (values.min() + values.max())
        points = []
        for group in (False, True):
            rows = [k for k, of in zip(own, groups.tolist(), strict=True) if of == group]
            points.append(
                crossing([segments[k] for k in rows] + others, segments[rows[0]].nearest(place), pixel, options)
            )
            for k in rows:
                members[k][0].points[members[k][1]] = points[-1]
        for k, (stroke, end) in enumerate(members):
            if k not in own:
                away = np.linalg.norm(np.array(points) - stroke.points[1 if end == 0 else -2], axis=1)
                stroke.points[end] = points[int(away.argmax())]
        return
    point = crossing(segments, place, pixel, options)
    for stroke, end in members:
        stroke.points[end] = point


def _roll_to_corner(loop: Array) -> Array:
    """Begin a closed polyline where it is farthest from its middle, which is a corner of most shapes."""
    first = int(np.linalg.norm(loop[:-1] - loop[:-1].mean(0), axis=1).argmax())
    return np.concatenate([loop[first:-1], loop[: first + 1]])


def _roll_to_longest(loop: Array, tolerance: float) -> Array:
    """Begin a closed polyline where its longest straight part begins."""
    breaks = douglas_peucker(loop, tolerance)
    first = max(pairwise(breaks), key=lambda ends: float(np.hypot(*(loop[ends[1]] - loop[ends[0]]))))[0]
    return np.concatenate([loop[first:-1], loop[: first + 1]])


def _fit_segments(
    corners: Array, pixel: float, known: Array | None, options: StraightenOptions, frayed: bool
) -> tuple[list[FittedSegment], Array]:
    """Split a chain where it turns and fit a line to each part, see :func:`straighten`; with the places between."""
    breaks = douglas_peucker(corners, options.split * pixel)
    found = frayed_parts(corners, breaks, pixel, known, options.fray) if frayed else []
    parts = {part.first: part for part in found}
    within = {row for part in found for row in breaks if part.first < row < part.last}
    breaks = [row for row in breaks if row not in within]
    segments = [
        _frayed_segment(corners, parts[i], pixel, options)
        if i in parts
        else _fit_segment(corners[i : j + 1], pixel, known, options)
        for i, j in pairwise(breaks)
    ]
    at = corners[breaks]
    for part in found:
        k = breaks.index(part.first)
        at[k : k + 2] = part.nearest(at[k : k + 2])
    return segments, at


def _fit_segment(corners: Array, pixel: float, known: Array | None, options: StraightenOptions) -> FittedSegment:
    """Fit the line through part of a chain."""
    middles = 0.5 * (corners[1:] + corners[:-1])
    span = corners[-1] - corners[0]
    length = float(np.hypot(*span))
    if known is not None and length > 0:
        line = _nearest_line(middles, span, known, options.plane_line_distance * pixel)
        if line is not None:
            return _aligned_to_axes(_on_line(corners.mean(0), span, length, line), pixel, options)
    cut = min(len(middles) // 4, max(1, int(options.corner * pixel / max(length / len(middles), 1e-12))))
    inner = middles[cut : len(middles) - cut] if len(middles) > 6 else middles
    centre = inner.mean(0)
    if len(inner) > 2:
        along = np.linalg.svd(inner - centre, full_matrices=False)[2][0]
    else:
        along = span / max(length, 1e-300)
    return _aligned_to_axes(FittedSegment(centre, along * (np.sign(along @ span) or 1.0), length), pixel, options)


def _nearest_line(middles: Array, span: Array, known: Array, most: float) -> Array | None:
    """Return the line nearest to points [n, 2] of a segment whose ends are ``span`` [2] apart; None where all lines are
    turned against it, end before its middle, or are further away than ``most``."""
    off = np.median(np.abs(middles @ known[:, :2].T + known[:, 2]), axis=0)
    along = middles.mean(0) @ np.stack([known[:, 1], -known[:, 0]])
    fits = np.abs(known[:, :2] @ span) <= _KNOWN_TURN * float(np.hypot(*span))
    fits &= (off < most) & (along >= known[:, 3]) & (along <= known[:, 4])
    rows = np.flatnonzero(fits)
    return known[rows[off[rows].argmin()]] if len(rows) else None


def _frayed_segment(corners: Array, part: FrayedPart, pixel: float, options: StraightenOptions) -> FittedSegment:
    """Return the line of a frayed part of a chain."""
    ends = part.nearest(corners[[part.first, part.last]])
    span = ends[1] - ends[0]
    segment = _on_line(ends.mean(0), span, float(np.hypot(*span)), part.line)
    return _aligned_to_axes(segment, pixel, options) if part.known else replace(segment, known=False)


def _on_line(centre: Array, span: Array, length: float, line: Array) -> FittedSegment:
    """Return the segment on a line ``a x + b y + c = 0`` near a point [2], along the line as ``span`` [2] goes."""
    across = line[:2]
    along = np.array([-across[1], across[0]])
    return FittedSegment(
        centre - across * float(centre @ across + line[2]), along * (np.sign(along @ span) or 1.0), length, True
    )


def _aligned_to_axes(segment: FittedSegment, pixel: float, options: StraightenOptions) -> FittedSegment:
    """Return the segment level or upright where it is so but for a ground pixel at its ends."""
    for axis in range(2):
        lean = abs(float(segment.along[axis]))  # sine of the angle
        shift = 0.5 * segment.length * lean
        if lean < np.sin(np.radians(options.level_angle)) and shift <= options.level_shift * pixel:
            along = np.zeros(2)
            along[1 - axis] = np.sign(segment.along[1 - axis])
            return FittedSegment(segment.at, along, segment.length, segment.known)
    return segment


def _without_short(
    segments: list[FittedSegment], at: Array, pixel: float, closed: bool, options: StraightenOptions
) -> tuple[list[FittedSegment], Array]:
    """Drop short segments where the lines beside them cross nearby; the first segment of a loop is its longest."""
    k = 1
    while k < len(segments) - (not closed) and len(segments) > 2:
        last = k == len(segments) - 1
        before, segment, after = segments[k - 1], segments[k], segments[0 if last else k + 1]
        if segment.length < options.short * pixel and min(before.length, after.length) > segment.length:
            middle = 0.5 * (at[k] + at[k + 1])
            if abs(turn(before.along, after.along)) > np.sin(np.radians(options.crossing_angle)):
                place = _intersection(before, after)
                if np.hypot(*(place - middle)) < options.meeting_distance * pixel:
                    segments, at = segments[:k] + segments[k + 1 :], np.concatenate([at[:k], [place], at[k + 2 :]])
                    if last:
                        at[0] = place
                    continue
        k += 1
    return segments, at


def _intersection(one: FittedSegment, other: FittedSegment) -> Array:
    matrix = np.stack([one.along, -other.along], 1)
    return np.asarray(one.at + one.along * np.linalg.solve(matrix, other.at - one.at)[0])
