# SPDX-License-Identifier: GPL-3.0-or-later
"""What the mesh tells about a solid: heights from above, roof planes, wall lines, and where the ground is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import igl
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, median_filter

from mgf_engine.algorithms import parameter
from mgf_engine.drawings.facades import plan_frame
from mgf_engine.drawings.model import LEANING, Array, Survey
from mgf_engine.drawings.project import Grid, plan_grid, render_grid
from mgf_engine.drawings.regions import LOOSE, RegionOptions, Regions, find_regions, survey_planes
from mgf_engine.drawings.trace import trace
from mgf_engine.mesh.plane_detection import PlanarOptions
from mgf_engine.model.mesh import Mesh


@dataclass(frozen=True)
class EvidenceOptions:
    """Options of the evidence for a solid."""

    detail_pixels: float = parameter(8.0, "Detail, where none is given", "ground px", low=0.1)
    detail_share: float = parameter(0.01, "Minimum of that detail, as a share of the building's size", high=1)
    steepest: float = parameter(75.0, "Largest tilt of a roof plane", "degrees", high=89)
    level: float = parameter(1.5, "Tilt below which a roof plane is made level", "degrees", high=45)
    least_roof: float = parameter(0.005, "Minimum area of a roof plane, as a share of the footprint", high=1)
    main_angle: float = parameter(
        4.0, "Largest angle between a wall and the main direction that it is turned into", "degrees", low=0.1, high=45
    )
    most_lines: int = parameter(60, "Maximum number of lines that cut the ground plan", low=4)
    same_angle: float = parameter(8.0, "Largest angle between two lines that are merged", "degrees", high=90)
    overhang: float = parameter(4.0, "Largest distance between a wall and its eaves, in details")
    overhang_share: float = parameter(0.1, "Minimum of that distance, as a share of the building's height")
    winding: float = parameter(0.35, "Winding number of the mesh from which a place is inside", high=1)
    inside_height: float = parameter(0.45, "Height at which places are tested, as a share of the building's", high=1)
    least_wall: float = parameter(0.004, "Minimum area of a wall, as a share of all walls", high=1)
    same_direction: float = parameter(15.0, "Largest angle between the walls of one direction", "degrees", high=90)
    most_directions: int = parameter(12, "Maximum number of directions of walls", low=1)
    regions: RegionOptions = RegionOptions()
    planes: PlanarOptions = PlanarOptions()


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
        return np.array([-self.normal[1], self.normal[0]])


@dataclass(frozen=True)
class Evidence:
    """What a solid is made from; the ground plan has the axes of the local frame.

    Attributes:
        height: float64 [H, W] from above, NaN where nothing is seen; inside: bool [H, W], where the building stands.
        label: int32 [H, W], row of ``slopes`` + 1 where a pixel lies in a roof plane, else 0.
        slopes: [P, 3], roof planes ``z = a x + b y + c``.
        lines: candidates for edges of the ground plan, walls first.
        top: height that nearly all of the building stays below.
        block: height of what is seen from above, for a block with a level top.
    """

    grid: Grid
    height: Array
    inside: NDArray[np.bool_]
    label: NDArray[np.int32]
    slopes: Array
    lines: list[Line2]
    ground: float
    ground_from: str
    top: float
    block: float
    detail: float

    def pixels(self) -> Array:
        """Return the middles of all pixels in the ground plan, [H, W, 2]."""
        row, column = np.mgrid[: self.grid.height, : self.grid.width] + 0.5
        return self.grid.places(np.stack([column, row], -1))


def gather_evidence(
    survey: Survey,
    detail: float | None = None,
    options: EvidenceOptions = EvidenceOptions(),
    taken: shapely.Geometry | None = None,
) -> Evidence:
    """Read all that the mesh tells.

    Args:
        survey: mesh in the local frame, and what is known of it.
        detail: steps and offsets below this size are left out; None takes it from photos and size.
        options: least sizes, angles and areas.
        taken: ground of the neighbours, as :func:`mgf_engine.models.solid.build.build_solid` takes it.
    """
    size = float(np.linalg.norm(np.ptp(survey.mesh.vertices[:, :2], axis=0)))
    if detail is None:
        detail = max(options.detail_pixels * survey.working_pixel, options.detail_share * size)
    coarse = replace(survey, working_pixel=max(survey.working_pixel, 0.25 * detail))
    regions = find_regions(coarse, survey_planes(coarse, options.planes), plan_frame(survey, []), options.regions)
    grid = regions.grid
    seen = render_grid(survey, plan_grid(grid.frame, grid.resolution, survey.unit))
    height = np.where(seen.face >= 0, seen.before, np.nan).astype(np.float64)
    bottom = float(np.percentile(survey.mesh.vertices[:, 2], 0.5))
    top = float(np.nanpercentile(height, 90)) if np.isfinite(height).any() else float(survey.mesh.vertices[:, 2].max())
    closed = survey.mesh if taken is None else hang_party_walls(survey.mesh, taken, bottom)
    inside = _footprint(closed, height, grid, detail, bottom, top, options)
    upper = height[np.isfinite(height) & (height > bottom + options.inside_height * (top - bottom))]
    block = float(np.median(upper)) if len(upper) else top
    label, slopes = _roofs(regions, inside, options)
    _take_loose(label, slopes, height, inside, grid, 0.5 * detail)
    walls = wall_lines(survey, detail, options)
    reach = max(options.overhang * detail, options.overhang_share * (top - bottom))
    lines = walls + _roof_lines(label, slopes, regions, walls, detail, reach, options)
    lines += _outlines(inside, grid, walls, detail, reach, options)
    ground, ground_from = find_ground(survey, inside, grid)
    return Evidence(
        grid, height, inside, label, slopes, lines[:options.most_lines], ground, ground_from, top, block, detail
    )  # fmt: skip


def hang_party_walls(mesh: Mesh, taken: shapely.Geometry, bottom: float) -> Mesh:
    """Hang a vertical wall below each open edge that lies on the ground of neighbours, down to ``bottom``.

    Where nobody sees a party wall the mesh ends at the rim of the roof, and does not wind around what is below it.
    """
    edges = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    _, which, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    rim = edges[count[which.ravel()] == 1]
    rim = rim[shapely.contains_xy(taken, mesh.vertices[rim].mean(1)[:, :2])]
    used, ends = np.unique(rim, return_inverse=True)
    a, b = (ends.reshape(-1, 2) + len(mesh.vertices)).T  # their feet
    feet = mesh.vertices[used].copy()
    feet[:, 2] = np.minimum(feet[:, 2], bottom)
    walls = np.concatenate([np.stack([rim[:, 1], rim[:, 0], a], 1), np.stack([rim[:, 1], a, b], 1)])
    return Mesh(
        np.concatenate([mesh.vertices, feet]), np.concatenate([mesh.faces, walls]).astype(np.int32),
        np.concatenate([mesh.colors, mesh.colors[used]]),
    )  # fmt: skip


def _footprint(
    mesh: Mesh, height: Array, grid: Grid, detail: float, bottom: float, top: float, options: EvidenceOptions
) -> NDArray[np.bool_]:
    """Find where the building stands: the mesh winds around places half way up to what is seen from above.

    That holds below a roof that no photo shows, in courtyards and under eaves, and for walls with gaps. Where nothing
    is seen from above, places at ``inside_height`` of the height tell.
    """
    step = max(1, round(0.3 * detail / grid.resolution))
    row, column = np.arange(step // 2, grid.height, step), np.arange(step // 2, grid.width, step)
    at = grid.places(np.stack(np.meshgrid(column, row), -1).astype(np.float64) + 0.5)
    over = height[np.ix_(row, column)]
    level = bottom + options.inside_height * (np.where(np.isfinite(over), over, top) - bottom)
    points = np.column_stack([at.reshape(-1, 2), level.ravel()])
    winding = igl.fast_winding_number(mesh.vertices, mesh.faces.astype(np.int64), points)
    inside = binary_opening(median_filter(np.asarray(winding).reshape(level.shape) > options.winding, 3), iterations=1)
    wide = cv2.resize(inside.astype(np.uint8), (grid.width, grid.height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(wide > 0)


def _roofs(regions: Regions, inside: NDArray[np.bool_], options: EvidenceOptions) -> tuple[NDArray[np.int32], Array]:
    """Return roof planes of some size, renumbered: the label of each pixel and their slopes."""
    count = np.bincount(np.where(regions.label < LOOSE, regions.label, 0)[inside], minlength=len(regions.slope) + 1)
    slope = np.hypot(regions.slope[:, 0], regions.slope[:, 1])
    kept = np.flatnonzero(
        (count[1:] > options.least_roof * inside.sum()) & (slope < np.tan(np.radians(options.steepest)))
    )
    number = np.zeros(len(regions.slope) + 1, np.int32)
    number[kept + 1] = np.arange(1, len(kept) + 1)
    label = number[np.where(regions.label < LOOSE, regions.label, 0)]
    slopes = np.array(regions.slope[kept]).reshape(-1, 3)  # the plan's axes are those of the local frame
    for k, plane in enumerate(slopes):
        if np.hypot(*plane[:2]) < np.tan(np.radians(options.level)):
            row, column = np.nonzero(label == k + 1)
            at = regions.grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5).mean(0)
            slopes[k] = 0.0, 0.0, float(plane[:2] @ at + plane[2])
    return label, slopes


def _take_loose(
    label: NDArray[np.int32], slopes: Array, height: Array, inside: NDArray[np.bool_], grid: Grid, near: float
) -> None:
    """Give pixels in no plane to the plane that they lie in, where that goes on behind something else."""
    row, column = np.nonzero((label == 0) & inside & np.isfinite(height))
    at, best = grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5), np.full(len(row), near)
    for k, (a, b, c) in enumerate(slopes):
        off = np.abs(at @ (a, b) + c - height[row, column])
        better = off < best
        best[better] = off[better]
        label[row[better], column[better]] = k + 1


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
    """Return lines less than a detail apart made one, the heavier ones first."""
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
    """Return how far a line's extent lies from another line; inf where they are not parallel or lie beside each
    other."""
    if abs(float(line.normal @ other.normal)) < np.cos(np.radians(options.same_angle)):
        return np.inf
    ends = [line.normal * line.offset + line.along * t for t in (line.low, line.high)]
    reach = sorted(float(end @ other.along) for end in ends)
    slack = 0.5 * (other.high - other.low) + 0.5 * (reach[1] - reach[0])
    if reach[0] > other.high + slack or reach[1] < other.low - slack:
        return np.inf
    return float(np.mean([abs(float(end @ other.normal) - other.offset) for end in ends]))


def _roof_lines(
    label: NDArray[np.int32],
    slopes: Array,
    regions: Regions,
    walls: list[Line2],
    detail: float,
    reach: float,
    options: EvidenceOptions,
) -> list[Line2]:
    """Find where roof planes meet, exactly, and where one stands over another without a wall near that."""
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


def _outlines(
    inside: NDArray[np.bool_], grid: Grid, walls: list[Line2], detail: float, reach: float, options: EvidenceOptions
) -> list[Line2]:
    """Return straight parts of the outline from above that no wall stands below."""
    found: list[Line2] = []
    for chain in trace(inside.astype(np.int32)):
        at = grid.places(chain.corners)
        found += [line for line in _straight(at, detail) if not _explained(line, walls, reach, options)]
    return merge_lines(_turned(found, detail, options), detail, options)


def _straight(at: Array, detail: float) -> list[Line2]:
    """Return the straight parts of a polyline [n, 2] that are longer than two details."""
    from mgf_engine.drawings.straighten import split

    if len(at) > 2 and np.allclose(at[0], at[-1]):
        first = int(np.linalg.norm(at[:-1] - at[:-1].mean(0), axis=1).argmax())
        at = np.concatenate([at[first:-1], at[: first + 1]])
        far = int(np.linalg.norm(at - at[0], axis=1).argmax())
        parts = [at[: far + 1], at[far:]]
    else:
        parts = [at]
    lines = []
    for part in parts:
        breaks = split(part, detail)
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


def find_ground(survey: Survey, inside: NDArray[np.bool_], grid: Grid) -> tuple[float, str]:
    """Find the height of the ground: of the terrain's points around the building, else of the mesh's lower end."""
    z = survey.mesh.vertices[:, 2]
    bottom, height = float(np.percentile(z, 0.5)), float(np.ptp(z))
    scene = survey.scene
    points = survey.local(scene.to_normalised.invert(scene.points[~survey.masks.point_mask]))
    row, column = np.nonzero(inside)
    if not len(row) or not len(points):
        return bottom, "mesh"
    plan = grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5)
    reach = 0.3 * float(np.linalg.norm(np.ptp(plan, axis=0)))
    near = ((points[:, :2] > plan.min(0) - reach) & (points[:, :2] < plan.max(0) + reach)).all(1)
    near &= np.abs(points[:, 2] - bottom) < 0.2 * height
    column, row = np.floor(grid.pixels(points[:, :2])).astype(np.int64).T
    within = (column >= 0) & (column < grid.width) & (row >= 0) & (row < grid.height)
    near[within] &= ~inside[row[within], column[within]]
    if near.sum() < 30:
        return bottom, "mesh"
    low, found, high = np.percentile(points[near, 2], (25, 50, 75)).tolist()
    level = high - low < 0.1 * height and abs(found - bottom) < 0.15 * height
    return (found, "terrain") if level else (bottom, "mesh")
