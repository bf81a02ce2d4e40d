# SPDX-License-Identifier: GPL-3.0-or-later
"""Solids of a town: of each building, made by the process of its job (:mod:`mgf_engine.town.worker`), and all in one
file.

A building without a solid is no failure: ``solid.json`` says why there is none.
"""

from __future__ import annotations

import json
import time
import traceback
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from mgf_engine.errors import BadInput, Cancelled, explain
from mgf_engine.files.atomic import write_json
from mgf_engine.georef.model import Georeference, read_georeference
from mgf_engine.system.machine import cpu_seconds
from mgf_engine.town.hulls import GONE
from mgf_engine.town.plan_files import read_plan

CITYJSON, DONE = "solid.city.json", "solid.json"


def write_solid(folder: Path, job: Path) -> None:
    """Make the solid of a finished building of a town, and write ``solid.json``: what it is, or why there is none.

    Args:
        folder: of the building, in the town's.
        job: its finished job.

    Raises:
        Cancelled: the user asked to stop.
    """
    try:
        figures = make_solid(folder, job, folder.parents[1])
    except (Cancelled, KeyboardInterrupt, OSError):
        raise
    except Exception as error:
        if not isinstance(error, BadInput):
            traceback.print_exception(error)
        figures = {"lod": None, "reason": explain(error)[1]}
    write_json(folder / DONE, figures)


def make_solid(folder: Path, job: Path, town: Path) -> dict[str, Any]:
    """Make the solid of a finished building in the frame of its town; returns what is known about it.

    Args:
        folder: of the building.
        job: its finished job.
        town: its folder, with georeference and plan.

    Raises:
        BadInput: the job is damaged.
    """
    from mgf_engine.drawings.load import UpOptions, read_survey
    from mgf_engine.jobs.job_folder import with_algorithms_of_job
    from mgf_engine.models.cityjson import make_cityjson
    from mgf_engine.models.solid.build import NoSolid, SolidOptions, build_solid
    from mgf_engine.town.view_selection import BuildingViewOptions

    began, cpu = time.perf_counter(), cpu_seconds()
    config = with_algorithms_of_job(job, {})
    survey = read_survey(job, read_georeference(town), config.algorithm(UpOptions))
    (folder / CITYJSON).unlink(missing_ok=True)
    try:
        reach = config.algorithm(BuildingViewOptions).party_wall * float(read_plan(town)["metre"])
        taken = ground_of_neighbours(town, folder.resolve().name, survey.georeference, reach)
        solid = build_solid(survey, options=config.algorithm(SolidOptions), taken=taken)
    except NoSolid as reason:
        return {"lod": None, "reason": str(reason)}
    write_json(folder / CITYJSON, make_cityjson(solid, survey, folder.name))
    return {
        "lod": solid.level, "faces": len(solid.faces), "volume": round(solid.volume, 2),
        "party_walls": solid.party, "unseen_walls": solid.unseen["wall"],
        "seconds": round(time.perf_counter() - began, 1), "cpu_seconds": round(cpu_seconds() - cpu, 1),
    }  # fmt: skip


def ground_of_neighbours(town: Path, name: str, georeference: Georeference, reach: float) -> shapely.Geometry:
    """Return the footprints of the other buildings of a town with so much around them, local frame; not of what is torn
    down.

    Args:
        town: its folder.
        name: of the building whose neighbours are meant.
        georeference: of the building's job, whose local frame is taken.
        reach: metres around the footprints that count as theirs.
    """
    features = json.loads((town / "buildings.geojson").read_text(encoding="utf-8"))["features"]
    others = [f["geometry"] for f in features if f["properties"]["id"] != name and f["properties"]["state"] != GONE]
    shapes = shapely.from_geojson([json.dumps(geometry) for geometry in others])
    local = shapely.transform(shapes, lambda places: places - np.array(georeference.offset[:2]))
    return shapely.union_all(shapely.buffer(local, reach))


def merge_cityjson(parts: list[dict[str, Any]], title: str) -> dict[str, Any]:
    """Merge CityJSON files of one CRS and one step into a single one.

    Args:
        parts: as :func:`mgf_engine.models.cityjson.make_cityjson` makes them, each with objects of other names.
    """
    step = parts[0]["transform"]["scale"][0]
    places = [
        np.array(part["vertices"], np.float64) * part["transform"]["scale"] + part["transform"]["translate"]
        for part in parts
    ]
    every = np.concatenate(places)
    low = np.floor(every.min(0))
    objects, count = dict[str, Any](), 0
    for part in parts:
        for name, item in part["CityObjects"].items():
            geometry = [{**g, "boundaries": _shifted(g["boundaries"], count)} for g in item["geometry"]]
            objects[name] = {**item, "geometry": geometry}
        count += len(part["vertices"])
    extent = [round(float(v), 3) for v in (*every.min(0), *every.max(0))]
    metadata = {**parts[0]["metadata"], "geographicalExtent": extent, "title": title}
    return {
        "type": "CityJSON", "version": parts[0]["version"],
        "transform": {"scale": [step] * 3, "translate": low.tolist()}, "metadata": metadata, "CityObjects": objects,
        "vertices": np.rint((every - low) / step).astype(np.int64).tolist(),
    }  # fmt: skip


def _shifted(nested: Any, count: int) -> Any:
    """Shift indices in nested lists by a number."""
    return [_shifted(inner, count) for inner in nested] if isinstance(nested, list) else nested + count


def read_solids(folders: list[Path]) -> list[dict[str, Any]]:
    """Read the CityJSON of those buildings that have a solid."""
    files = [folder / CITYJSON for folder in folders]
    return [json.loads(file.read_text(encoding="utf-8")) for file in files if file.is_file()]
