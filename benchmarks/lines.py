# SPDX-License-Identifier: GPL-3.0-or-later
"""How true the lines of elevations and roof plans are: ``python -m benchmarks.lines JOB...``.

Each job is of a generated scene and has its mesh. The true mesh is seen along the same parallel rays, in pixels of a
quarter of a ground pixel; its edges are outlines, steps in depth of half a ground pixel or more, and creases of five
degrees or more. Lines are precise where a true edge is within one ground pixel (or two); recall is the share of true
outlines and of steps of three pixels or more with a line within two. Lines are those of ``mgf drawings``, which come
to where the photos have them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.job_table import print_job_table
from mgf_engine.drawings.elevation import ElevationOptions, draw_elevation
from mgf_engine.drawings.facades import FacadeOptions, find_facades, plan_frame
from mgf_engine.drawings.ground import find_ground_level
from mgf_engine.drawings.load import UpOptions, read_survey
from mgf_engine.drawings.model import DrawingFrame, Polyline
from mgf_engine.drawings.openings import elevation_photos
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.photo_lines import PhotoLineOptions
from mgf_engine.drawings.project import plan_grid
from mgf_engine.drawings.regions import survey_planes
from mgf_engine.evaluation.surfaces import read_surface
from mgf_engine.geometry.rasterize import render_parallel
from mgf_engine.jobs.job_folder import with_algorithms_of_job
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.texture.texture_pipeline import TextureOptions, choose_painting

Array = NDArray[np.float64]
FINE = 0.25  # ground pixels of the true mesh's pictures, and between points of lines
STEP, LARGE_STEP = 0.5, 3.0  # ground pixels
CREASE = np.cos(np.radians(5.0))
FAR = 4.0  # ground pixels from all true edges


@dataclass(frozen=True)
class Score:
    """Lines of one or more drawings against the true edges.

    Attributes:
        lines: number of lines, polylines counted once.
        distance: of points on the lines from the nearest true edge, ground pixels [n].
        missed: distance of points on the main true edges from the nearest line, ground pixels [m].
    """

    lines: int
    distance: Array
    missed: Array

    def row(self) -> list[str]:
        """Return number, precision within one and two pixels, recall within two, and length far from all edges."""
        shares = [(self.distance <= 1).mean(), (self.distance <= 2).mean(), (self.missed <= 2).mean()]
        far = FINE * float((self.distance > FAR).sum())
        return [str(self.lines), *(f"{100 * share:.1f} %" for share in shares), f"{far:.0f}"]


def true_edges(at: Array, faces: NDArray[np.int64], frame: DrawingFrame, pixel: float) -> tuple[Array, Array]:
    """Find the edges of a mesh that a frame shows.

    Args:
        at: vertices in drawing coordinates and before the plane, [V, 3].
        faces: of the mesh, [F, 3].
        frame: what the drawing shows.
        pixel: a ground pixel.

    Returns:
        points on all edges, and on outlines and large steps alone, drawing coordinates [n, 2] and [m, 2].
    """
    grid = plan_grid(frame, FINE * pixel)
    seen = render_parallel(
        np.column_stack([grid.pixels(at), at[:, 2]]), faces.astype(np.int32), grid.height, grid.width
    )
    normal = np.cross(at[faces[:, 1]] - at[faces[:, 0]], at[faces[:, 2]] - at[faces[:, 0]])
    normal *= np.where(normal[:, 2:] < 0, -1, 1) / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    every, main = list[Array](), list[Array]()
    for axis, (dx, dy) in enumerate(((grid.resolution, 0.0), (0.0, -grid.resolution))):
        one, other = (np.moveaxis(seen.face, 1 - axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        near, far = (np.moveaxis(seen.depth, 1 - axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        both, outline = (one >= 0) & (other >= 0), (one < 0) != (other < 0)
        normals = normal[one], normal[other]
        rise = [-(n[..., 0] * dx + n[..., 1] * dy) / np.maximum(n[..., 2], 0.02) for n in normals]
        step = np.minimum(*(np.abs(far - near - r) for r in rise)) / pixel
        crease = (normals[0] * normals[1]).sum(-1) < CREASE
        for found, into in (
            (outline | (both & ((step > STEP) | crease)), every),
            (outline | (both & (step > LARGE_STEP)), main),
        ):
            first, second = np.nonzero(found)
            column, row = (first + 1.0, second + 0.5) if axis == 0 else (second + 0.5, first + 1.0)
            into.append(grid.places(np.stack([column, row], 1)))
    return np.concatenate(every), np.concatenate(main)


def points_on(lines: Sequence[Polyline], spacing: float) -> Array:
    """Return points at even distances on lines, [n, 2]."""
    points = [np.zeros((0, 2))]
    for line in lines:
        for begin, end in pairwise(line.points):
            count = max(1, round(float(np.hypot(*(end - begin))) / spacing))
            points.append(begin + (np.arange(count)[:, None] + 0.5) / count * (end - begin))
    return np.concatenate(points)


def compare(lines: Sequence[Polyline], edges: tuple[Array, Array], pixel: float) -> Score:
    """Compare the lines of a drawing with points on all true edges and on the main ones."""
    points = points_on(lines, FINE * pixel)
    distance = cKDTree(edges[0]).query(points)[0] if len(edges[0]) else np.full(len(points), np.inf)
    missed = cKDTree(points).query(edges[1])[0] if len(points) else np.full(len(edges[1]), np.inf)
    return Score(len(lines), distance / pixel, missed / pixel)


def score(job: Path, scene: Path) -> Score:
    """Compare all elevations and the roof plan of a job with the truth of its scene.

    Raises:
        BadInput: the job has no mesh.
    """
    truth, config = read_surface(scene / "truth.ply"), with_algorithms_of_job(job, {})
    survey = read_survey(job, options=config.algorithm(UpOptions))
    planes = survey_planes(survey, config.algorithm(PlanarOptions))
    facades = find_facades(survey, config.algorithm(FacadeOptions))
    ground = find_ground_level(survey, facades)
    options = config.algorithm(TextureOptions)
    painting = choose_painting(survey.normalised, survey.scene, survey.masks, options=options)
    visibility = Visibility(survey, painting)
    photos = elevation_photos(survey, painting, visibility, config.algorithm(PhotoLineOptions))
    scores = []
    for frame in (*(facade.frame for facade in facades), plan_frame(survey, facades)):
        drawing = draw_elevation(survey, planes, frame, config.algorithm(ElevationOptions), photos, ground)
        at = frame.to_drawing(survey.local(truth.vertices))
        edges = true_edges(at, truth.faces, frame, survey.working_pixel)
        scores.append(compare(drawing.lines, edges, survey.working_pixel))
    return Score(
        sum(s.lines for s in scores), np.concatenate([s.distance for s in scores]),
        np.concatenate([s.missed for s in scores]),
    )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table, a row for each job."""
    header = ("lines", "within one pixel", "within two", "recall within two", "pixels far from all edges")
    return print_job_table(
        "python -m benchmarks.lines", __doc__, header, lambda job, scene, spec: score(job, scene).row(), argv
    )


if __name__ == "__main__":
    raise SystemExit(main())
