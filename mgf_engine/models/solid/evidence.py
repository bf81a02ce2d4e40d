# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence for a solid, measured on the mesh: heights from above, roof planes, wall lines, and the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import igl
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, median_filter

from mgf_engine.drawings.facades import plan_frame
from mgf_engine.drawings.ground import find_ground_level_around
from mgf_engine.drawings.model import Array, Survey
from mgf_engine.drawings.project import Grid, plan_grid, render_grid
from mgf_engine.drawings.regions import LOOSE, RegionMap, find_regions, survey_planes
from mgf_engine.geometry.clean import open_edges
from mgf_engine.model.mesh import Mesh
from mgf_engine.models.solid.evidence_options import EvidenceOptions
from mgf_engine.models.solid.plan_lines import Line2, outline_lines, roof_lines, wall_lines
from mgf_engine.models.solid.round_roofs import add_round_roofs


@dataclass(frozen=True)
class SolidEvidence:
    """Measurements that a solid is built from; the ground plan has the axes of the local frame.

    Attributes:
        height: float64 [H, W], from above; NaN where nothing is seen.
        inside: bool [H, W], where the building stands.
        label: int32 [H, W], row of ``slopes`` + 1 where a pixel lies in a roof plane, else 0.
        slopes: [P, 3], roof planes ``z = a x + b y + c``.
        lines: candidates for edges of the ground plan, walls first.
        roof_seen: share of the footprint that lies in planes of the mesh's roof.
        top: height that nearly all of the building stays below.
        block: height of what is seen from above, for a block with a level top.
    """

    grid: Grid
    height: Array
    inside: NDArray[np.bool_]
    label: NDArray[np.int32]
    slopes: Array
    lines: list[Line2]
    roof_seen: float
    ground: float
    ground_from: str
    top: float
    block: float
    detail: float

    def pixels(self) -> Array:
        """Return the middles of all pixels in the ground plan, [H, W, 2]."""
        row, column = np.mgrid[: self.grid.height, : self.grid.width] + 0.5
        return self.grid.places(np.stack([column, row], -1))


def gather_solid_evidence(
    survey: Survey,
    detail: float | None = None,
    options: EvidenceOptions = EvidenceOptions(),
    taken: shapely.Geometry | None = None,
) -> SolidEvidence:
    """Measure the mesh: heights from above, roof planes, wall lines and the ground.

    Args:
        survey: mesh in the local frame, and what is known of it.
        detail: steps and offsets below this size are left out; None takes it from photos and size.
        options: least sizes, angles and areas.
        taken: ground of the neighbours, as :func:`mgf_engine.models.solid.build.build_solid` takes it.
    """
    if detail is None:
        detail = detail_of(survey, options)
    coarse = replace(survey, working_pixel=max(survey.working_pixel, 0.25 * detail))
    regions = find_regions(coarse, survey_planes(coarse, options.planes), plan_frame(survey, []), options.regions)
    grid = regions.grid
    seen = render_grid(survey, plan_grid(grid.frame, grid.resolution))
    height = np.where(seen.face >= 0, seen.before, np.nan).astype(np.float64)
    bottom = float(np.percentile(survey.mesh.vertices[:, 2], 0.5))
    top = float(np.nanpercentile(height, 90)) if np.isfinite(height).any() else float(survey.mesh.vertices[:, 2].max())
    closed = survey.mesh if taken is None else hang_party_walls(survey.mesh, taken, bottom)
    inside = _footprint(closed, height, grid, detail, bottom, top, options)
    upper = height[np.isfinite(height) & (height > bottom + options.inside_height * (top - bottom))]
    block = float(np.median(upper)) if len(upper) else top
    label, slopes = _roofs(regions, inside, options)
    _take_loose(label, slopes, height, inside, grid, 0.5 * detail)
    roof_seen = float((label[inside] > 0).mean()) if len(slopes) else 0.0
    walls = wall_lines(survey, detail, options)
    turn = float(np.arctan2(walls[0].normal[1], walls[0].normal[0])) if walls else 0.0
    slopes = add_round_roofs(label, slopes, height, inside, grid, detail, turn, options)
    reach = max(options.overhang * detail, options.overhang_share * (top - bottom))
    lines = walls + roof_lines(label, slopes, regions, walls, detail, reach, options)
    lines += outline_lines(inside, grid, walls, detail, reach, options)
    found = find_ground_level_around(survey, inside, grid, options.ground)
    ground, ground_from = found.height, found.source
    return SolidEvidence(
        grid, height, inside, label, slopes, lines[:options.most_lines], roof_seen, ground, ground_from, top, block,
        detail,
    )  # fmt: skip


def detail_of(survey: Survey, options: EvidenceOptions = EvidenceOptions()) -> float:
    """Return the size below which steps and offsets are left out, by the photos and the building's size."""
    size = float(np.linalg.norm(np.ptp(survey.mesh.vertices[:, :2], axis=0)))
    return max(options.detail_pixels * survey.working_pixel, options.detail_share * size)


def hang_party_walls(mesh: Mesh, taken: shapely.Geometry, bottom: float) -> Mesh:
    """Hang a vertical wall below each open edge that lies on the ground of neighbours, down to ``bottom``.

    Where nobody sees a party wall the mesh ends at the rim of the roof, and does not wind around what is below it.
    """
    rim = np.stack(open_edges(mesh), 1).astype(np.int64)
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


def _roofs(regions: RegionMap, inside: NDArray[np.bool_], options: EvidenceOptions) -> tuple[NDArray[np.int32], Array]:
    """Return roof planes of some size, renumbered: the label of each pixel and their slopes."""
    count = np.bincount(np.where(regions.label < LOOSE, regions.label, 0)[inside], minlength=len(regions.slope) + 1)
    slope = np.hypot(regions.slope[:, 0], regions.slope[:, 1])
    kept = np.flatnonzero(
        (count[1:] > options.least_roof * inside.sum()) & (slope < np.tan(np.radians(options.largest_tilt)))
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
