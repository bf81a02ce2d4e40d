# SPDX-License-Identifier: GPL-3.0-or-later
"""All drawings of a job, made in a folder beside the old ones and put in their place when they are whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.elevation import ElevationOptions, draw_elevation, with_parts
from mgf_engine.drawings.facades import FacadeOptions, facade_through, find_facades, plan_frame
from mgf_engine.drawings.geotiff import write_geotiff
from mgf_engine.drawings.ground import ground_of
from mgf_engine.drawings.load import UpOptions, read_survey
from mgf_engine.drawings.model import Facade, Frame, LineDrawing, Survey
from mgf_engine.drawings.orthophoto import Visibility, paint, unseen_text
from mgf_engine.drawings.parts import PartOutlineOptions, part_lines, part_shares
from mgf_engine.drawings.project import Grid, GridBuffers, plan_grid, render_grid, round_resolution
from mgf_engine.drawings.quantities import (
    QuantityOptions,
    building_rows,
    deviation_picture,
    small_unit,
    wall_deviation,
    wall_rows,
    write_csv,
)
from mgf_engine.drawings.regions import survey_planes
from mgf_engine.drawings.section import SectionOptions, cut, section_frames
from mgf_engine.drawings.sheets import Sheet, choose_scale, fitting_scale, north_in, write_sheet
from mgf_engine.drawings.vector_files import write_dxf, write_svg
from mgf_engine.drawings.work import DrawingOptions, Work
from mgf_engine.job_folder import locked, with_algorithms_of_job
from mgf_engine.masks.store import write_png
from mgf_engine.mesh.plane_detection import PlanarOptions, Planes
from mgf_engine.messages import Reporter
from mgf_engine.output_folder import Cost, check_place, new_folder
from mgf_engine.system import write_json
from mgf_engine.texture.painting import Painting
from mgf_engine.texture.texture_pipeline import TextureOptions, choose_painting

STAGE = "drawings"
INDEX = "drawings.json"
FORMAT = 1
#: Marks of the section in the job's report.
BEGIN, END = "<!-- quantities -->", "<!-- /quantities -->"
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
    check_place(folder, INDEX, "drawings")
    cost = Cost()
    with locked(job), new_folder(folder) as beside:
        with cost.of("reading"):
            config = with_algorithms_of_job(job, wanted.algorithms)
            survey = read_survey(job, options=config.algorithm(UpOptions))
            facades = _facades(survey, wanted, config.algorithm(FacadeOptions))
            ground = ground_of(survey, facades)
        _tell(survey, reporter)
        work = Work(
            survey=survey, facades=facades, wanted=wanted, ground=ground, title=job.resolve().name,
            config=config, folder=beside, reporter=reporter, cost=cost,
        )  # fmt: skip
        _draw(work)
        write_json(beside / INDEX, _index(work))
        work.folder = folder
        if work.rows:
            _report(work, job)
    work.send(folder, facades=len(facades))
    return folder


def _report(work: Work, job: Path) -> None:
    """Put the quantities into the job's report, in the place of those of an earlier run."""
    from jinja2 import Environment, FileSystemLoader

    from mgf_engine.georef.report import replace_section

    report = job / "report.html"
    if not report.is_file():
        return
    page = work.folder / "drawings.html"
    inside = page.is_relative_to(job.resolve())
    link = page.relative_to(job.resolve()).as_posix() if inside else page.as_uri()
    environment = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    text = environment.get_template("report.html.j2").render(rows=work.rows, page=link)
    replace_section(report, f"{BEGIN}\n{text}\n{END}", BEGIN, END)


def _facades(survey: Survey, wanted: DrawingOptions, options: FacadeOptions) -> list[Facade]:
    if not wanted.facades:
        return find_facades(survey, options)
    points = [np.array(three, np.float64) for three in wanted.facades]
    return [facade_through(survey, three, f"facade-{k + 1}", options) for k, three in enumerate(points)]


def _tell(survey: Survey, reporter: Reporter) -> None:
    if not survey.georeference.metric:
        reporter.warning(
            "The job has no true coordinates, so one unit of its scene is drawn as one metre; run 'mgf georef' first "
            "for true lengths."
        )


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
    _write_page(work)


def _draw_frame(
    work: Work,
    frame: Frame,
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
            _write_orthophoto(work, image, seen.grid)
    if facade is None and work.wants("orthophotos"):
        _write_heights(work, seen)
    work.reporter.progress(share(1.0))
    with work.cost.of("lines"):
        outlines = work.config.algorithm(PartOutlineOptions)
        parts = part_lines(part_shares(survey, painting, visibility, seen, outlines), seen.grid, outlines)
        if work.wants("elevations", "sheets"):
            drawing = with_parts(draw_elevation(survey, planes, frame, work.config.algorithm(ElevationOptions)), parts)
        if drawing is not None and work.wants("elevations"):
            _write_lines(work, "roof" if facade is None else f"elevation-{frame.name}", drawing, "elevation")
    if drawing is not None and image is not None and work.wants("sheets"):
        with work.cost.of("sheets"):
            _write_sheets(work, drawing, image, seen.grid)
    if facade is not None and work.wants("quantities"):
        with work.cost.of("quantities"):
            deviation = wall_deviation(survey, facade, seen, work.config.algorithm(QuantityOptions))
            _write_deviation(work, deviation, seen.grid)
            work.rows += wall_rows(survey, facade, deviation, parts)


def _write_sheets(work: Work, drawing: LineDrawing, image: NDArray[np.uint8], grid: Grid) -> None:
    """Write the sheets of an orthophoto and of its lines."""
    name = drawing.frame.name
    above = drawing.frame.normal[2] > 0.5
    for kind, photo in (("orthophoto", image), ("lines", None)):
        shown = drawing if photo is None else LineDrawing(drawing.frame, [], [])
        what = "orthophoto" if photo is not None else "roof" if above else "elevation"
        under = None if photo is None else (photo, grid)
        _write_sheet(work, f"{kind}-{name}", f"{name.capitalize()}: {what}", shown, under)


def _write_sheet(
    work: Work, name: str, title: str, drawing: LineDrawing, photo: tuple[NDArray[np.uint8], Grid] | None = None
) -> None:
    """Write one sheet as PDF and SVG."""
    paper = work.wanted.paper
    scale = choose_scale(drawing.frame.size, paper, work.wanted.scale)
    sheet = Sheet(paper, scale, title, work.title, _facts_of(work, photo), work.levels(drawing.frame),
                  north_in(work.survey, drawing.frame))  # fmt: skip
    for ending in ("pdf", "svg"):
        path = work.add(f"sheet-{name}.{ending}", kind="sheet", frame=drawing.frame.name, paper=paper, scale=scale)
        write_sheet(path, sheet, drawing, photo)


def _facts_of(work: Work, photo: tuple[NDArray[np.uint8], Grid] | None) -> str:
    """Return what a sheet says of its coordinates, lengths and pixels."""
    survey = work.survey
    facts = [survey.georeference.crs or "", "" if survey.georeference.metric else "lengths in units of the scene"]
    if photo is not None:
        size = photo[1].resolution
        facts.append(f"{1000 * size:.3g} mm per pixel" if survey.georeference.metric else f"{size:.3g} per pixel")
    return "   ".join(fact for fact in facts if fact)


def _write_deviation(work: Work, deviation: NDArray[np.float32], grid: Grid) -> None:
    facts = {"kind": "deviation", "frame": grid.frame.name, "resolution": grid.resolution}
    name = f"deviation-{grid.frame.name}"
    write_geotiff(work.add(f"{name}.tif", **facts), deviation, grid, work.survey, {"KIND": "deviation"})
    picture = cv2.cvtColor(deviation_picture(deviation, small_unit(work.survey)), cv2.COLOR_RGBA2BGRA)
    write_png(work.add(f"{name}.png", **facts), np.asarray(picture, np.uint8))


def _write_page(work: Work) -> None:
    """Write ``drawings.html``: every picture on one page, with the quantities."""
    from jinja2 import Environment, FileSystemLoader

    groups: dict[str, list[str]] = {}
    for name, facts in work.files.items():
        groups.setdefault(str(facts.get("frame", "all")), []).append(name)
    environment = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    text = environment.get_template("page.html.j2").render(
        groups=groups.items(), rows=work.rows, unit=work.survey.georeference.unit, crs=work.survey.georeference.crs
    )
    work.add("drawings.html", kind="page").write_text(text, encoding="utf-8")


def _sections(work: Work, frames: Sequence[Frame]) -> None:
    for k, frame in enumerate(frames):
        work.reporter.progress(_PAINTED + (1.0 - _PAINTED) * k / len(frames))
        with work.cost.of("sections"):
            made = cut(work.survey, frame, work.config.algorithm(SectionOptions))
            if not made.drawing.lines:
                work.reporter.warning(f"The section {frame.name} cuts nothing of the mesh; give another place.")
                continue
            facts = {"area": round(made.area, 6), "closed": made.closed, "bridged": round(made.bridged, 6)}
            _write_lines(work, f"section-{frame.name}", made.drawing, "section", **facts)
        if work.wants("sheets"):
            with work.cost.of("sheets"):
                _write_sheet(work, f"section-{frame.name}", f"Section {frame.name}", made.drawing)


def _write_lines(work: Work, name: str, drawing: LineDrawing, kind: str, **facts: Any) -> None:
    facts = {"kind": kind, "frame": drawing.frame.name, "lines": len(drawing.lines), **facts}
    scale = work.wanted.scale or fitting_scale(drawing.frame.size, work.wanted.paper)
    write_dxf(work.add(f"{name}.dxf", **facts), drawing, work.survey, scale)
    write_svg(work.add(f"{name}.svg", **facts), drawing, work.survey, scale)


def _write_heights(work: Work, seen: GridBuffers) -> None:
    with work.cost.of("heights"):
        heights = seen.before + np.float32(work.survey.world(np.zeros(3))[2])
        path = work.add(f"heights-{seen.grid.frame.name}.tif", kind="heights", frame=seen.grid.frame.name)
        write_geotiff(path, heights, seen.grid, work.survey, {"KIND": "heights"})


def _grid(work: Work, frame: Frame) -> Grid:
    resolution = work.wanted.resolution or round_resolution(work.survey.pixel)
    return plan_grid(frame, resolution, work.survey.unit)


def _write_orthophoto(work: Work, image: NDArray[np.uint8], grid: Grid) -> None:
    name = f"orthophoto-{grid.frame.name}"
    facts = {
        "kind": "orthophoto", "frame": grid.frame.name, "resolution": grid.resolution,
        "width": grid.width, "height": grid.height, "covered": round(float((image[..., 3] > 0).mean()), 4),
    }  # fmt: skip
    write_geotiff(work.add(f"{name}.tif", **facts), image, grid, work.survey, {"KIND": "orthophoto"})
    write_png(work.add(f"{name}.png", **facts), np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA)))


def _index(work: Work) -> dict[str, Any]:
    """Return what ``drawings.json`` holds, for Blender and scripts."""
    survey = work.survey
    facades = [
        {
            "name": f.name, "direction": round(f.direction, 3), "tilt": round(f.tilt, 4),
            "width": float(f.frame.size[0]), "height": float(f.frame.size[1]),
            "origin": survey.world(f.frame.origin).tolist(), "normal": (f.frame.normal @ survey.turn).tolist(),
        }
        for f in work.facades
    ]  # fmt: skip
    return {
        "format": FORMAT, "unit": survey.georeference.unit, "crs": survey.georeference.crs, "pixel": survey.pixel,
        "facades": facades, "files": work.files, "cpu_seconds": work.cost.seconds, "peak_memory": work.cost.memory,
    }  # fmt: skip
