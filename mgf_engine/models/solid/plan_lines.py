# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines that cut the ground plan of a solid: walls, ridges and valleys of roofs, and outlines without a wall below."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import LEANING, Array, Survey
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.regions import RegionMap
from mgf_engine.drawings.straighten import douglas_peucker
from mgf_engine.drawings.trace import trace
from mgf_engine.models.solid.evidence_options import EvidenceOptions


@dataclass(frozen=True)
class Line2:
    """A line of the ground plan: ``normal @ x = offset``, and its extent along (-normal[1], normal[0])."""

    normal: Array
    offset: float
    low: float
    high: float
    weight: float

    @property
    def along(self) -> Array:
        """Unit direction of the line, [2]."""
        return np.array([-self.normal[1], self.normal[0]])


def wall_lines(survey: Survey, detail: float, options: EvidenceOptions = EvidenceOptions()) -> list[Line2]:
    """Return the walls as lines of the ground plan, largest first; nearly parallel ones and right angles made exact.

    Directions are taken one after the other, the one that most wall area faces first; along each, places where much of
    it stands in one plane. Unlike planes grown over the mesh this needs no even surface.
    """
    wall = np.flatnonzero(np.abs(survey.normals[:, 2]) < LEANING)
    azimuth = np.arctan2(survey.normals[wall, 1], survey.normals[wall, 0]) % np.pi  # a line has no sides
    areas, at = survey.areas[wall], survey.centres[wall][:, :2]
    least = max(4 * detail**2, options.least_wall * float(areas.sum()))
    left, found = np.ones(len(wall), bool), list[Line2]()
    for _ in range(options.most_directions):
        if float(areas[left].sum()) < least:
            break
        direction = _main_direction(azimuth[left], areas[left], np.pi, options)
        near = left & (np.abs(_turn(azimuth, direction, np.pi)) < np.radians(options.same_direction))
        found += _in_direction(at[near], areas[near], direction, detail, least)
        left &= np.abs(_turn(azimuth, direction, np.pi)) > np.radians(options.same_direction)
    return merge_lines(_turned(found, detail, options), detail, options)


def _in_direction(at: Array, areas: Array, direction: float, detail: float, least: float) -> list[Line2]:
    """Return lines square to a direction where faces of at least some area lie within half a detail, by place and
    area."""
    normal = np.array([np.cos(direction), np.sin(direction)])
    along, away = at @ np.array([-normal[1], normal[0]]), at @ normal
    lines, left = list[Line2](), np.ones(len(at), bool)
    bins = np.floor((away - away.min()) / (0.25 * detail)).astype(np.int64) if len(at) else np.zeros(0, np.int64)
    while left.any():
        count = np.bincount(bins[left], areas[left], int(bins.max()) + 1)
        wide = np.convolve(count, np.ones(5), "same")
        best = int(wide.argmax())
        if wide[best] < least:
            break
        band = left & (np.abs(bins - best) <= 2)
        for rows in _runs(np.flatnonzero(band), along, 3 * detail):
            if areas[rows].sum() >= least:
                lines.append(_fitted(at[rows], areas[rows], normal, detail))
        left &= ~band
    return lines


def _runs(rows: NDArray[np.int64], along: Array, gap: float) -> list[NDArray[np.int64]]:
    """Return rows in parts between which nothing lies for some length."""
    rows = rows[np.argsort(along[rows])]
    return np.split(rows, np.flatnonzero(np.diff(along[rows]) > gap) + 1)


def _fitted(at: Array, areas: Array, normal: Array, detail: float) -> Line2:
    """Fit the line of least squares through faces, by area; with the given normal where it is short."""
    middle = areas @ at / areas.sum()
    spread = at - middle
    if np.ptp(spread @ np.array([-normal[1], normal[0]])) > 6 * detail:
        fitted = np.linalg.eigh((spread * areas[:, None]).T @ spread)[1][:, 0]
        normal = fitted * (np.sign(fitted @ normal) or 1.0)
    return _line(at, normal, float(areas.sum()), float(middle @ normal))


def _turn(angle: Array | float, other: float, whole: float) -> Array:
    """Return the signed difference of directions that repeat after ``whole``."""
    return np.asarray((np.asarray(angle) - other + whole / 2) % whole - whole / 2)


def _main_direction(angle: Array, weight: Array, whole: float, options: EvidenceOptions) -> float:
    """Return the direction that most of the weight lies around."""
    grid = np.linspace(0, whole, 360, endpoint=False)
    bins = np.bincount((angle % whole * 720 / whole).astype(np.int64) % 720, weight, 720)
    at = (np.arange(720) + 0.5) * whole / 720
    near = np.maximum(1 - (_turn(at[None] - grid[:, None], 0.0, whole)) ** 2 / np.radians(options.main_angle) ** 2, 0)
    best = float(grid[int((near**2 @ bins).argmax())])
    off = _turn(angle, best, whole)
    share = np.maximum(1 - (off / np.radians(options.main_angle)) ** 2, 0) ** 2 * weight
    return float(best + (share @ off) / max(float(share.sum()), 1e-300))


def _line(points: Array, normal: Array, weight: float, offset: float | None = None) -> Line2:
    along = points @ np.array([-normal[1], normal[0]])
    low, high = np.percentile(along, (1, 99)).tolist()
    return Line2(normal, float(np.median(points @ normal)) if offset is None else offset, low, high, weight)


def _turned(lines: list[Line2], detail: float, options: EvidenceOptions) -> list[Line2]:
    """Turn lines near a main direction into it around their middle, where that moves their ends by little."""
    if not lines:
        return []
    angle = np.array([np.arctan2(line.normal[1], line.normal[0]) for line in lines])
    weight = np.array([line.weight for line in lines])
    main = _main_direction(angle, weight, np.pi / 2, options)
    result = []
    for line, a in zip(lines, angle, strict=True):
        turn = float(_turn(a, main, np.pi / 2))
        if abs(turn) < np.radians(options.main_angle) and 0.5 * (line.high - line.low) * abs(turn) < 0.7 * detail:
            middle = line.normal * line.offset + line.along * 0.5 * (line.low + line.high)
            normal = np.array([np.cos(a - turn), np.sin(a - turn)])
            along = float(middle @ np.array([-normal[1], normal[0]]))
            half = 0.5 * (line.high - line.low)
            line = Line2(normal, float(middle @ normal), along - half, along + half, line.weight)
        result.append(line)
    return result


def merge_lines(lines: list[Line2], detail: float, options: EvidenceOptions = EvidenceOptions()) -> list[Line2]:
    """Merge lines less than a detail apart, the ones with the largest weight first."""
    kept: list[Line2] = []
    for line in sorted(lines, key=lambda each: -each.weight):
        for k, other in enumerate(kept):
            if distance_between(line, other, options) < detail:
                middle = line.normal * line.offset + line.along * 0.5 * (line.low + line.high)
                share = line.weight / (line.weight + other.weight)
                offset = other.offset + share * (float(middle @ other.normal) - other.offset)
                ends = [
                    float((line.normal * line.offset + line.along * t) @ other.along) for t in (line.low, line.high)
                ]
                kept[k] = Line2(other.normal, offset, min(other.low, *ends), max(other.high, *ends),
                                line.weight + other.weight)  # fmt: skip
                break
        else:
            kept.append(line)
    return kept


def distance_between(line: Line2, other: Line2, options: EvidenceOptions = EvidenceOptions()) -> float:
    """Compute the mean distance of the ends of a line from another line; inf if not parallel or not overlapping.

    Args:
        line: whose ends are measured.
        other: the line.
        options: largest angle between parallel lines.
    """
    if abs(float(line.normal @ other.normal)) < np.cos(np.radians(options.same_angle)):
        return np.inf
    ends = [line.normal * line.offset + line.along * t for t in (line.low, line.high)]
    reach = sorted(float(end @ other.along) for end in ends)
    slack = 0.5 * (other.high - other.low) + 0.5 * (reach[1] - reach[0])
    if reach[0] > other.high + slack or reach[1] < other.low - slack:
        return np.inf
    return float(np.mean([abs(float(end @ other.normal) - other.offset) for end in ends]))


def roof_lines(
    label: NDArray[np.int32],
    slopes: Array,
    regions: RegionMap,
    walls: list[Line2],
    detail: float,
    reach: float,
    options: EvidenceOptions,
) -> list[Line2]:
    """Find where roof planes meet, exactly, and where one stands over another without a wall near that.

    Args:
        label: of each pixel of the ground plan, row of ``slopes`` + 1; 0 for none.
        slopes: [P, 3], roof planes ``z = a x + b y + c``.
        regions: with the grid of the ground plan.
        walls: lines that explain others near them.
        detail: twice of it is the length of the shortest line.
        reach: distance within which a wall explains a line.
        options: angles of lines that are merged.
    """
    found: list[Line2] = []
    for chain in trace(label):
        if chain.low == 0:
            continue
        at = regions.grid.places(chain.corners)
        length = float(np.linalg.norm(np.diff(at, axis=0), axis=1).sum())
        if length < 2 * detail:
            continue
        meet = slopes[chain.low - 1] - slopes[chain.high - 1]
        scale = float(np.hypot(meet[0], meet[1]))
        if scale > 1e-3:
            normal, offset = meet[:2] / scale, -float(meet[2]) / scale
            if np.median(np.abs(at @ normal - offset)) < 2 * detail:
                found.append(_line(at, normal, length, offset))
                continue
        found += [line for line in _straight(at, detail) if not _explained(line, walls, reach, options)]
    return sorted(found, key=lambda line: -line.weight)


def outline_lines(
    inside: NDArray[np.bool_], grid: Grid, walls: list[Line2], detail: float, reach: float, options: EvidenceOptions
) -> list[Line2]:
    """Return straight parts of the outline from above that no wall stands below.

    Args:
        inside: bool [H, W], where the building stands.
        grid: of the ground plan.
        walls: lines that explain others near them.
        detail: twice of it is the length of the shortest line.
        reach: distance within which a wall explains a line.
        options: angles of lines that are merged.
    """
    found: list[Line2] = []
    for chain in trace(inside.astype(np.int32)):
        at = grid.places(chain.corners)
        found += [line for line in _straight(at, detail) if not _explained(line, walls, reach, options)]
    return merge_lines(_turned(found, detail, options), detail, options)


def _straight(at: Array, detail: float) -> list[Line2]:
    """Return the straight parts of a polyline [n, 2] that are longer than two details."""
    if len(at) > 2 and np.allclose(at[0], at[-1]):
        first = int(np.linalg.norm(at[:-1] - at[:-1].mean(0), axis=1).argmax())
        at = np.concatenate([at[first:-1], at[: first + 1]])
        far = int(np.linalg.norm(at - at[0], axis=1).argmax())
        parts = [at[: far + 1], at[far:]]
    else:
        parts = [at]
    lines = []
    for part in parts:
        breaks = douglas_peucker(part, detail)
        for i, j in pairwise(breaks):
            span = part[j] - part[i]
            length = float(np.hypot(*span))
            if length > 2 * detail:
                inner = part[i : j + 1]
                direction = np.linalg.svd(inner - inner.mean(0), full_matrices=False)[2][0]
                lines.append(_line(inner, np.array([direction[1], -direction[0]]), length))
    return lines


def _explained(line: Line2, others: list[Line2], reach: float, options: EvidenceOptions) -> bool:
    return any(distance_between(line, other, options) < reach for other in others)
