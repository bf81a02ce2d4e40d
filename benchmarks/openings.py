# SPDX-License-Identifier: GPL-3.0-or-later
"""How well elevations draw windows, doors and gates: ``python -m benchmarks.openings JOB...``.

Each job is of a generated scene and has its mesh. The rectangles that its elevations draw are compared with the
openings of the building that the generator made: an opening is found where a rectangle overlaps it by half
(intersection over union); it is missed otherwise. A rectangle that overlaps no opening by half is false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.buildings import BUILDINGS
from benchmarks.job_table import print_job_table
from benchmarks.shapes import Part
from mgf_engine.drawings.elevation import ElevationOptions, draw_elevation
from mgf_engine.drawings.facades import FacadeOptions, find_facades
from mgf_engine.drawings.ground import find_ground_level
from mgf_engine.drawings.load import UpOptions, read_survey
from mgf_engine.drawings.model import DrawingFrame, Survey
from mgf_engine.drawings.openings import elevation_photos
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.photo_lines import PhotoLineOptions
from mgf_engine.drawings.regions import survey_planes
from mgf_engine.evaluation.surfaces import Surface, read_surface
from mgf_engine.geometry.boxes import intersection_over_union
from mgf_engine.jobs.job_folder import with_algorithms_of_job
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.texture.texture_pipeline import TextureOptions, choose_painting

Array = NDArray[np.float64]
FILLINGS = ("glass", "wood", "metal_door")  # of windows, doors and gates: one polygon over the whole opening
OVERLAP = 0.5
FACING = 0.98  # cosine between an opening and the elevation that shows it
DEEP = 0.4  # metres in front of an opening's filling within which nothing else stands


@dataclass(frozen=True)
class Score:
    """What became of the openings of one job.

    Attributes:
        openings, found, false: how many there are, how many of them were found, and how many were drawn besides.
        off: of those found, by how much left, low, right and high are too large, metres [found, 4].
    """

    openings: int
    found: int
    false: int
    off: Array

    @property
    def rms(self) -> float:
        """Root mean square distance of the corners, millimetres; NaN where nothing was found."""
        return 1000 * float(np.sqrt(2 * np.mean(self.off**2))) if len(self.off) else float("nan")

    @property
    def edges(self) -> tuple[float, float]:
        """Median distance of the edges at the sides, and of those above and below, millimetres."""
        if not len(self.off):
            return float("nan"), float("nan")
        return 1000 * float(np.median(np.abs(self.off[:, ::2]))), 1000 * float(np.median(np.abs(self.off[:, 1::2])))


def true_openings(parts: Sequence[Part]) -> list[Array]:
    """Return the corners of each opening of a building, [4 or, with an arched head, more, 3], scene frame."""
    return [
        part.vertices[list(face)]
        for part in parts
        if part.building and part.material in FILLINGS and _is_opening(part.element)
        for face in part.faces
        if len(face) >= 4
    ]


def _is_opening(element: str) -> bool:
    return any(kind in element.rpartition(".")[2] for kind in ("window", "door", "gate"))


def boxes_in(openings: Sequence[Array], frame: DrawingFrame, survey: Survey, truth: Surface) -> Array:
    """Return left, low, right, high of the openings that an elevation shows, [N, 4]."""
    toward = survey.turn.T @ frame.normal @ survey.georeference.rotation  # scene frame
    boxes = []
    for corners in openings:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        if normal @ toward < FACING * np.linalg.norm(normal):
            continue
        begin = corners.mean(0) + 100.0 * toward
        face, share = truth.first_hits(begin, (corners.mean(0) - begin)[None])
        if face[0] >= 0 and 100.0 * (1 - share[0]) > DEEP:
            continue
        at = frame.to_drawing(survey.local(corners))[:, :2]
        boxes.append(np.concatenate([at.min(0), at.max(0)]))
    return np.array(boxes).reshape(-1, 4)


def compare(true: Array, drawn: Array) -> Score:
    """Match drawn rectangles [M, 4] with true ones [N, 4]."""
    overlap = intersection_over_union(true, drawn)
    rows, columns = linear_sum_assignment(overlap, maximize=True)
    good = overlap[rows, columns] >= OVERLAP
    off = drawn[columns[good]] - true[rows[good]]
    return Score(len(true), int(good.sum()), len(drawn) - int(good.sum()), off)


def score(job: Path, scene: Path, spec: dict[str, Any]) -> Score:
    """Compare all elevations of a job with the truth of its scene.

    Raises:
        BadInput: the job has no mesh.
    """
    openings = true_openings(BUILDINGS[spec["building"]](spec["wall"]))
    truth, config = read_surface(scene / "truth.ply"), with_algorithms_of_job(job, {})
    survey = read_survey(job, options=config.algorithm(UpOptions))
    planes = survey_planes(survey, config.algorithm(PlanarOptions))
    options = config.algorithm(TextureOptions)
    painting = choose_painting(survey.normalised, survey.scene, survey.masks, options=options)
    visibility = Visibility(survey, painting)
    photos = elevation_photos(survey, painting, visibility, config.algorithm(PhotoLineOptions))
    facades = find_facades(survey, config.algorithm(FacadeOptions))
    scores, ground = [], find_ground_level(survey, facades)
    for facade in facades:
        drawing = draw_elevation(survey, planes, facade.frame, config.algorithm(ElevationOptions), photos, ground)
        true = boxes_in(openings, facade.frame, survey, truth)
        scores.append(compare(true, np.array(drawing.openings).reshape(-1, 4)))
    return Score(
        sum(s.openings for s in scores), sum(s.found for s in scores), sum(s.false for s in scores),
        np.concatenate([s.off for s in scores]),
    )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table, a row for each job."""

    def row(job: Path, scene: Path, spec: dict[str, Any]) -> list[Any]:
        s = score(job, scene, spec)
        return [s.openings, s.found, s.openings - s.found, s.false, *(f"{v:.0f}" for v in (s.rms, *s.edges))]

    header = ("openings", "found", "missed", "false", "RMS of corners, mm", "median at the sides", "above and below")
    return print_job_table("python -m benchmarks.openings", __doc__, header, row, argv)


if __name__ == "__main__":
    raise SystemExit(main())
