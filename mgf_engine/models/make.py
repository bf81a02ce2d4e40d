# SPDX-License-Identifier: GPL-3.0-or-later
"""All models of a job, made in a folder beside the old ones and put in their place when they are whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mgf_engine.drawings.load import UpOptions, read_survey, warn_of_unknown_scale
from mgf_engine.files.atomic import write_json
from mgf_engine.geometry.mesh_files import COORDINATES, IMAGE, read_texture
from mgf_engine.jobs.job_folder import with_algorithms_of_job
from mgf_engine.jobs.output_folder import Cost, replace_outputs
from mgf_engine.messages import Reporter
from mgf_engine.models.cityjson import FILE as CITYJSON
from mgf_engine.models.cityjson import make_cityjson
from mgf_engine.models.ifc import FILE as IFC
from mgf_engine.models.ifc import write_ifc
from mgf_engine.models.kinds import KINDS
from mgf_engine.models.levels import write_levels
from mgf_engine.models.place import to_geocentric
from mgf_engine.models.points import FILE as POINTS
from mgf_engine.models.points import MAX_POINTS, least_spacing, surface_points, write_laz
from mgf_engine.models.report import add_to_report
from mgf_engine.models.solid.build import NoSolid, SolidOptions, build_solid
from mgf_engine.models.solid.openings import OpeningOptions, add_openings
from mgf_engine.models.work import ModelOptions, Work

STAGE = "models"
INDEX = "models.json"
FORMAT = 1
#: Shares of the work after which the solid, its windows and doors, IFC, and the points begin, for the progress bar.
_SOLID, _OPENINGS, _IFC, _POINTS, _LAZ = 0.75, 0.85, 0.9, 0.92, 0.96


def make_models(job: Path, out: Path | None, wanted: ModelOptions, reporter: Reporter) -> Path:
    """Make everything that is wanted; returns the folder.

    Args:
        job: its folder.
        out: folder of the models; None for ``models`` in the job folder.
        wanted: levels of detail, solid and points.
        reporter: for progress, warnings and the request to cancel.

    Raises:
        BadInput: the job has no mesh, or something wanted is impossible.
    """
    reporter.stages = (STAGE,)
    reporter.stage(STAGE)
    folder = (out or job / STAGE).resolve()
    cost, complete = Cost(), set(wanted.kinds) == set(KINDS)
    with replace_outputs(job, folder, INDEX, STAGE, reporter, complete) as beside:
        with cost.of("reading"):
            config = with_algorithms_of_job(job, wanted.algorithms, reporter.warning)
            survey = read_survey(job, options=config.algorithm(UpOptions))
            painted = (job / IMAGE).is_file() and (job / COORDINATES).is_file()
            texture = read_texture(job) if painted else None
        warn_of_unknown_scale(survey, reporter)
        reporter.check()
        work = Work(
            job=job, survey=survey, texture=texture, wanted=wanted,
            config=config, folder=beside, reporter=reporter, cost=cost,
        )  # fmt: skip
        if {"lod", "tiles", "usd"} & set(wanted.kinds):
            write_levels(work)
        if {"solid", "ifc"} & set(wanted.kinds):
            _solid(work)
        if "points" in wanted.kinds:
            _points(work)
        write_json(beside / INDEX, _index(work))
    if out is None:
        add_to_report(job / "report.html", work)
    work.send(folder)
    return folder


def _points(work: Work) -> None:
    """Write the points of the surface as LAZ."""
    wanted, least = work.wanted.spacing or work.survey.working_pixel, least_spacing(work.survey.mesh)
    spacing = max(wanted, least)
    if wanted < least:
        work.reporter.warning(
            f"Points {wanted:.3g} {work.survey.unit} apart would be more than {MAX_POINTS // 1_000_000} million; they "
            f"lie {spacing:.3g} {work.survey.unit} apart."
        )
    work.reporter.progress(_POINTS)
    with work.cost.of("points"):
        points, colors, normals = surface_points(work.survey.mesh, work.texture, spacing)
        work.reporter.progress(_LAZ)
        path = work.add(POINTS, kind="points", points=len(points), spacing=round(spacing, 6))
        write_laz(path, work.survey, points, colors, normals)


def _solid(work: Work) -> None:
    """Write the solid as CityJSON and IFC; a sentence where there is none, or only a block."""
    work.reporter.progress(_SOLID)
    with work.cost.of("solid"):
        try:
            solid = build_solid(work.survey, work.wanted.detail, work.config.algorithm(SolidOptions))
        except NoSolid as error:
            work.reporter.warning(f"There is no solid of this building ({error}); {error.cure}.")
            return
        if solid.level == 1:
            work.reporter.warning(
                "The photos do not show enough of the roof, so the solid is a block with a level top (LoD1)."
            )
        if solid.party:
            work.reporter.warning(
                f"{solid.party:.0%} of the walls are party walls: nobody saw them, and roof and walls end in their "
                "planes ('--set party_walls.found=off' leaves them open)."
            )
        work.reporter.progress(_OPENINGS)
        detailed = add_openings(solid, work.survey, work.config.algorithm(OpeningOptions))
        ground = float(work.survey.world(np.array([0.0, 0.0, solid.ground]))[2])
        facts = {
            "kind": "solid", "lod": solid.level, "faces": len(solid.faces), "volume": round(solid.volume, 3),
            "ground": round(ground, 3), "ground_from": solid.ground_from,
            "detail": round(solid.detail, 4), "unseen": solid.unseen,
            "openings": 0 if detailed is None else len(detailed.faces) - len(solid.faces),
            "deviation": None if solid.deviation is None else solid.deviation.as_dict(),
        }  # fmt: skip
        name = f"building-{work.job.resolve().name}"
        if "solid" in work.wanted.kinds:
            write_json(work.add(CITYJSON, **facts), make_cityjson(solid, work.survey, name, detailed))
    if "ifc" in work.wanted.kinds:
        work.reporter.progress(_IFC)
        with work.cost.of("IFC"):
            write_ifc(work.add(IFC, **{**facts, "kind": "ifc"}), detailed or solid, work.survey, name)


def _index(work: Work) -> dict[str, Any]:
    """Return the content of ``models.json``, for Blender and scripts."""
    survey = work.survey
    to_scene = np.eye(4)
    to_scene[:3, 3] = survey.georeference.scene(np.zeros(3))
    to_scene[:3, :3] = (survey.georeference.scene(np.eye(3) @ survey.turn) - to_scene[:3, 3]).T
    place = to_geocentric(survey) if "tiles" in work.wanted.kinds else None
    return {
        "format": FORMAT, "unit": survey.georeference.unit, "crs": survey.georeference.crs,
        "offset": survey.world(np.zeros(3)).tolist(), "to_scene": to_scene.tolist(),
        "to_geocentric": None if place is None else place.tolist(), "files": work.files,
        "cpu_seconds": work.cost.seconds, "peak_memory": work.cost.memory,
    }  # fmt: skip
