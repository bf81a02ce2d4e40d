# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the files of ``mgf drawings``: rasters, vector files, sheets, a page that shows all, the index for Blender."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.geotiff import write_geotiff
from mgf_engine.drawings.model import LineDrawing
from mgf_engine.drawings.project import Grid, GridBuffers
from mgf_engine.drawings.quantities import deviation_picture, small_unit
from mgf_engine.drawings.sheets import Sheet, choose_scale, fitting_scale, north_in, write_sheet
from mgf_engine.drawings.vector_files import write_dxf, write_svg
from mgf_engine.drawings.work import Work
from mgf_engine.files.html_section import replace_section
from mgf_engine.masks.store import write_image

FORMAT = 1  # of drawings.json
#: Marks of the section in the job's report.
BEGIN, END = "<!-- quantities -->", "<!-- /quantities -->"


def add_to_report(work: Work, job: Path) -> None:
    """Put the quantities into the job's report, in the place of those of an earlier run."""
    from jinja2 import Environment, FileSystemLoader

    report = job / "report.html"
    if not report.is_file():
        return
    page = work.folder / "drawings.html"
    inside = page.is_relative_to(job.resolve())
    link = page.relative_to(job.resolve()).as_posix() if inside else page.as_uri()
    environment = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    text = environment.get_template("report.html.j2").render(rows=work.rows, page=link)
    replace_section(report, f"{BEGIN}\n{text}\n{END}", BEGIN, END)


def write_sheets(work: Work, drawing: LineDrawing, image: NDArray[np.uint8], grid: Grid) -> None:
    """Write the sheets of an orthophoto and of its lines.

    Args:
        work: the run.
        drawing: lines of the plane.
        image: orthophoto RGBA uint8 [h, w, 4].
        grid: places of its pixels.
    """
    name = drawing.frame.name
    above = drawing.frame.from_above
    for kind, photo in (("orthophoto", image), ("lines", None)):
        shown = drawing if photo is None else LineDrawing(drawing.frame, [], [])
        what = "orthophoto" if photo is not None else "roof" if above else "elevation"
        under = None if photo is None else (photo, grid)
        write_sheet_files(work, f"{kind}-{name}", f"{name.capitalize()}: {what}", shown, under)


def write_sheet_files(
    work: Work, name: str, title: str, drawing: LineDrawing, photo: tuple[NDArray[np.uint8], Grid] | None = None
) -> None:
    """Write one sheet as PDF and SVG.

    Args:
        work: the run.
        name: of the files, after ``sheet-``.
        title: in the title block.
        drawing: its lines.
        photo: what lies under them, RGBA uint8 [h, w, 4] and the places of its pixels; None for nothing.
    """
    paper = work.wanted.paper
    scale = choose_scale(drawing.frame.size, paper, work.wanted.scale)
    sheet = Sheet(paper, scale, title, work.title, _facts_of(work, photo), work.levels(drawing.frame),
                  north_in(work.survey, drawing.frame))  # fmt: skip
    for ending in ("pdf", "svg"):
        path = work.add(f"sheet-{name}.{ending}", kind="sheet", frame=drawing.frame.name, paper=paper, scale=scale)
        write_sheet(path, sheet, drawing, photo)


def _facts_of(work: Work, photo: tuple[NDArray[np.uint8], Grid] | None) -> str:
    """Return a sheet's note on coordinates, lengths and size of a pixel."""
    survey = work.survey
    facts = [survey.georeference.crs or "", "" if survey.georeference.metric else "lengths in units of the scene"]
    if photo is not None:
        size = photo[1].resolution
        facts.append(f"{1000 * size:.3g} mm per pixel" if survey.georeference.metric else f"{size:.3g} per pixel")
    return "   ".join(fact for fact in facts if fact)


def write_deviation(work: Work, deviation: NDArray[np.float32], grid: Grid) -> None:
    """Write how far a wall lies from its plane, [h, w], as GeoTIFF and as a coloured picture."""
    facts = {"kind": "deviation", "frame": grid.frame.name, "resolution": grid.resolution}
    name = f"deviation-{grid.frame.name}"
    write_geotiff(work.add(f"{name}.tif", **facts), deviation, grid, work.survey, {"KIND": "deviation"})
    picture = cv2.cvtColor(deviation_picture(deviation, small_unit(work.survey)), cv2.COLOR_RGBA2BGRA)
    write_image(work.add(f"{name}.png", **facts), np.asarray(picture, np.uint8))


def write_page(work: Work) -> None:
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


def write_lines(work: Work, name: str, drawing: LineDrawing, kind: str, **facts: Any) -> None:
    """Write lines as DXF and SVG.

    Args:
        work: the run.
        name: of the files.
        drawing: the lines.
        kind: elevation or section, for the index.
        facts: further entries of the index.
    """
    facts = {"kind": kind, "frame": drawing.frame.name, "lines": len(drawing.lines), **facts}
    scale = work.wanted.scale or fitting_scale(drawing.frame.size, work.wanted.paper)
    write_dxf(work.add(f"{name}.dxf", **facts), drawing, work.survey, scale)
    write_svg(work.add(f"{name}.svg", **facts), drawing, work.survey, scale)


def write_heights(work: Work, seen: GridBuffers) -> None:
    """Write the heights seen from above as a GeoTIFF."""
    with work.cost.of("heights"):
        heights = seen.before + np.float32(work.survey.world(np.zeros(3))[2])
        path = work.add(f"heights-{seen.grid.frame.name}.tif", kind="heights", frame=seen.grid.frame.name)
        write_geotiff(path, heights, seen.grid, work.survey, {"KIND": "heights"})


def write_orthophoto(work: Work, image: NDArray[np.uint8], grid: Grid) -> None:
    """Write an orthophoto RGBA [h, w, 4] as GeoTIFF and PNG."""
    name = f"orthophoto-{grid.frame.name}"
    facts = {
        "kind": "orthophoto", "frame": grid.frame.name, "resolution": grid.resolution,
        "width": grid.width, "height": grid.height, "covered": round(float((image[..., 3] > 0).mean()), 4),
    }  # fmt: skip
    write_geotiff(work.add(f"{name}.tif", **facts), image, grid, work.survey, {"KIND": "orthophoto"})
    write_image(work.add(f"{name}.png", **facts), np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA)))


def index_of(work: Work) -> dict[str, Any]:
    """Return the content of ``drawings.json``, for Blender and scripts."""
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
