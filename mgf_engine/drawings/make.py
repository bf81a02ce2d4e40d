# SPDX-License-Identifier: GPL-3.0-or-later
"""Make all drawings of a job; the folder replaces the earlier one when it is complete."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from mgf_engine.drawings.elevation import ElevationOptions, draw_elevation, with_parts
from mgf_engine.drawings.facades import FacadeOptions, facade_through, find_facades, plan_frame
from mgf_engine.drawings.ground import GroundLevelOptions, find_ground_level
from mgf_engine.drawings.kinds import KINDS
from mgf_engine.drawings.load import UpOptions, read_survey, warn_of_unknown_scale
from mgf_engine.drawings.model import DrawingFrame, Facade, Survey
from mgf_engine.drawings.openings import elevation_photos
from mgf_engine.drawings.orthophoto import Visibility, paint, unseen_text
from mgf_engine.drawings.parts import PartOutlineOptions, part_lines, part_shares
from mgf_engine.drawings.photo_lines import PhotoLineOptions
from mgf_engine.drawings.project import Grid, plan_grid, render_grid, round_resolution
from mgf_engine.drawings.quantities import (
    QuantityOptions,
    building_rows,
    wall_deviation,
    wall_rows,
    write_csv,
)
from mgf_engine.drawings.regions import survey_planes
from mgf_engine.drawings.section import SectionOptions, cut
from mgf_engine.drawings.section_planes import section_frames
from mgf_engine.drawings.sheets import choose_scale
from mgf_engine.drawings.work import DrawingOptions, Work
from mgf_engine.drawings.write import (
    add_to_report,
    index_of,
    write_deviation,
    write_heights,
    write_lines,
    write_orthophoto,
    write_page,
    write_sheet_files,
    write_sheets,
)
from mgf_engine.files.atomic import write_json
from mgf_engine.jobs.job_folder import with_algorithms_of_job
from mgf_engine.jobs.output_folder import Cost, replace_outputs
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.mesh.plane_detection import Planes
from mgf_engine.messages import Reporter
from mgf_engine.texture.painting import Painting
from mgf_engine.texture.texture_pipeline import TextureOptions, choose_painting

STAGE = "drawings"
INDEX = "drawings.json"
_CHOSEN, _PAINTED = 0.3, 0.8  # shares of the work


def make_drawings(job: Path, out: Path | None, wanted: DrawingOptions, reporter: Reporter) -> Path:
    """Draw everything; returns the folder.

    Args:
        job: its folder.
        out: folder of the drawings; None for ``drawings`` in the job folder.
        wanted: drawings, formats and scales.
        reporter: for progress, warnings and the request to cancel.

    Raises:
        BadInput: the job has no mesh, or something wanted is impossible.
    """
    reporter.stages = (STAGE,)
    reporter.stage(STAGE)
    folder = (out or job / "drawings").resolve()
    cost, complete = Cost(), wanted.kinds == frozenset(KINDS)
    with replace_outputs(job, folder, INDEX, "drawings", reporter, complete) as beside:
        with cost.of("reading"):
            config = with_algorithms_of_job(job, wanted.algorithms, reporter.warning)
            survey = read_survey(job, options=config.algorithm(UpOptions))
            facades = _facades(survey, wanted, config.algorithm(FacadeOptions))
            ground = find_ground_level(survey, facades, config.algorithm(GroundLevelOptions))
        warn_of_unknown_scale(survey, reporter)
        work = Work(
            survey=survey, facades=facades, wanted=wanted, ground=ground, title=job.resolve().name,
            config=config, folder=beside, reporter=reporter, cost=cost,
        )  # fmt: skip
        _draw(work)
        write_json(beside / INDEX, index_of(work))
        work.folder = folder
        if work.rows:
            add_to_report(work, job)
    work.send(folder, facades=len(facades))
    return folder


def _facades(survey: Survey, wanted: DrawingOptions, options: FacadeOptions) -> list[Facade]:
    if not wanted.facades:
        return find_facades(survey, options)
    points = [np.array(three, np.float64) for three in wanted.facades]
    return [facade_through(survey, three, f"facade-{k + 1}", options) for k, three in enumerate(points)]


def _draw(work: Work) -> None:
    """Draw the orthophotos of the facades and from above, their lines, the heights, and the sections."""
    survey = work.survey
    frames = [facade.frame for facade in work.facades] + [plan_frame(survey, work.facades)]
    cuts = []
    if work.wants("sections"):
        cuts = section_frames(
            survey, work.facades, work.wanted.sections, work.ground.height, work.config.algorithm(SectionOptions)
        )
    if work.wants("sheets"):
        for frame in (*frames, *cuts):
            choose_scale(frame.size, work.wanted.paper, work.wanted.scale)  # refused before anything is painted
    if work.wants("orthophotos", "elevations", "sheets", "quantities"):
        with work.cost.of("choosing photos"):
            painting = choose_painting(
                survey.normalised, survey.scene, survey.masks, lambda share: work.reporter.progress(_CHOSEN * share),
                work.config.algorithm(TextureOptions),
            )  # fmt: skip
            visibility = Visibility(survey, painting)
        with work.cost.of("lines"):
            planes = survey_planes(survey, work.config.algorithm(PlanarOptions))
        with work.cost.of("quantities"):
            work.building = building_rows(survey, planes, work.ground, work.config.algorithm(QuantityOptions))
        for k, frame in enumerate(frames):
            begun, length = _CHOSEN + (_PAINTED - _CHOSEN) * k / len(frames), (_PAINTED - _CHOSEN) / len(frames)
            facade = work.facades[k] if k < len(work.facades) else None
            _draw_frame(work, frame, facade, painting, visibility, planes, lambda s: begun + length * s)  # noqa: B023
        if work.wants("quantities"):
            with work.cost.of("quantities"):
                work.rows += work.building
                write_csv(work.add("quantities.csv", kind="quantities"), work.rows)
    _sections(work, cuts)
    write_page(work)


def _draw_frame(
    work: Work,
    frame: DrawingFrame,
    facade: Facade | None,
    painting: Painting,
    visibility: Visibility,
    planes: Planes,
    share: Callable[[float], float],
) -> None:
    """Draw all that was asked for on one plane.

    Args:
        facade: whose plane it is; None for the one seen from above.
        share: of this plane's orthophoto -> of the whole run.
    """
    survey, image, drawing = work.survey, None, None
    with work.cost.of("orthophotos"):
        seen = render_grid(survey, _grid(work, frame))
        if work.wants("orthophotos", "sheets"):
            image = paint(survey, painting, visibility, seen, lambda s: work.reporter.progress(share(s)))
            text = unseen_text(frame.name, image, seen) if facade is not None else None
            if text is not None:
                work.reporter.warning(text)
        if image is not None and work.wants("orthophotos"):
            write_orthophoto(work, image, seen.grid)
    if facade is None and work.wants("orthophotos"):
        write_heights(work, seen)
    work.reporter.progress(share(1.0))
    with work.cost.of("lines"):
        outlines = work.config.algorithm(PartOutlineOptions)
        parts = part_lines(part_shares(survey, painting, visibility, seen, outlines), seen.grid, outlines)
        if work.wants("elevations", "sheets"):
            photos = elevation_photos(survey, painting, visibility, work.config.algorithm(PhotoLineOptions))
            lines = draw_elevation(survey, planes, frame, work.config.algorithm(ElevationOptions), photos, work.ground)
            drawing = with_parts(lines, parts)
        if drawing is not None and work.wants("elevations"):
            write_lines(work, "roof" if facade is None else f"elevation-{frame.name}", drawing, "elevation")
    if drawing is not None and image is not None and work.wants("sheets"):
        with work.cost.of("sheets"):
            write_sheets(work, drawing, image, seen.grid)
    if facade is not None and work.wants("quantities"):
        with work.cost.of("quantities"):
            deviation = wall_deviation(survey, facade, seen, work.config.algorithm(QuantityOptions))
            write_deviation(work, deviation, seen.grid)
            work.rows += wall_rows(survey, facade, deviation, parts)


def _sections(work: Work, frames: Sequence[DrawingFrame]) -> None:
    """Draw the sections that the frames cut, and their sheets."""
    for k, frame in enumerate(frames):
        work.reporter.progress(_PAINTED + (1.0 - _PAINTED) * k / len(frames))
        with work.cost.of("sections"):
            made = cut(work.survey, frame, work.config.algorithm(SectionOptions))
            if not made.drawing.lines:
                work.reporter.warning(f"The section {frame.name} cuts nothing of the mesh; give another place.")
                continue
            facts = {"area": round(made.area, 6), "closed": made.closed, "bridged": round(made.bridged, 6)}
            write_lines(work, f"section-{frame.name}", made.drawing, "section", **facts)
        if work.wants("sheets"):
            with work.cost.of("sheets"):
                write_sheet_files(work, f"section-{frame.name}", f"Section {frame.name}", made.drawing)


def _grid(work: Work, frame: DrawingFrame) -> Grid:
    resolution = work.wanted.resolution or round_resolution(work.survey.pixel)
    return plan_grid(frame, resolution)
