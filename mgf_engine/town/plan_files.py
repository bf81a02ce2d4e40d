# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a town's plan: a folder per building that a job can be made of, and what tells of all of them.

``OUT/scene`` is a job that went as far as the scene stage; ``OUT/buildings/ID`` holds ``scene`` (the building's part of
the COLMAP model, with links to its photos), ``prompts.json`` and ``building.json``; ``buildings.json`` and
``buildings.geojson`` are about all buildings. Files that stay the same are not written again, so that their times tell
what has to be done anew.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.config import Config, make_config
from mgf_engine.errors import BadInput
from mgf_engine.estimate import Photos, estimate
from mgf_engine.georef.model import Georeference, write_georeference
from mgf_engine.job import Job
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.scene.adjust import AdjustOptions, adjust_if_inconsistent
from mgf_engine.scene.colmap import find_model, read_model
from mgf_engine.scene.sparse import SparseModel
from mgf_engine.system import json_text
from mgf_engine.town.crop import crop_box
from mgf_engine.town.footprints import Footprints
from mgf_engine.town.hulls import BY_HAND, DOUBTFUL
from mgf_engine.town.plan import BUILDINGS, CLICKS, FILE, ONE, SCENE, Building, Plan
from mgf_engine.town.submodel import write_if_changed, write_submodel

#: Digests of automatic clicks of a building: those that are there, and those that were about to take their place.
AUTOMATIC = "automatic.json"
FORMAT = 1


def write_plan(
    plan: Plan,
    job: Job,
    out: Path,
    given: dict[str, Any],
    footprints: Footprints,
    most: int,
    by_hand: Path | None,
) -> Plan:
    """Write everything of a plan below ``out``; clicks that somebody made or changed stay.

    Args:
        plan: as :func:`mgf_engine.town.plan.make_plan` made it.
        job: of the shared scene.
        out: folder of the town.
        given: options of the jobs.
        footprints: the map, for its file's name.
        most: maximum number of photos of a building.
        by_hand: folder with ``ID.json`` for buildings that were clicked by hand; they win.

    Returns:
        The plan with the clicks that hold.

    Raises:
        BadInput: a file of clicks cannot be read.
    """
    model = _model_of(job)
    placed = plan.placed
    model_points = placed.georeference.local(model.points.xyz)
    earlier = _earlier(out)
    polygons = {building.hull.id: building.hull.polygon for building in plan.buildings}
    photos = {view.name: Path(view.photo) for view in plan.scene.views}
    by_name = {image.name.replace("\\", "/"): image.name for image in model.images}
    done, rows = [], []
    for building in plan.buildings:
        building = _with_hand(building, out, by_hand, earlier, {v.name for v in plan.scene.views})
        folder = out / BUILDINGS / building.hull.id
        if building.runs or building.hull.state == DOUBTFUL:
            names = [plan.scene.views[k].name for k in building.choice.photos]
            names = list(dict.fromkeys([*names, *building.clicks])) if building.by_hand else names
            reach = building.hull.polygon.buffer(plan.options.around * placed.metre)
            kept = _within(reach, model_points)
            write_submodel(
                model, [by_name[name] for name in names], kept, {by_name[n]: photos[n] for n in names},
                folder / SCENE,
            )  # fmt: skip
            if building.clicks:
                _write_clicks(building, folder, earlier)
        row = _row(building, plan, given, polygons)
        if building.runs:
            needed = {key: row[key] for key in ("id", "photos", "options")}  # no estimate, which learns from each job
            write_if_changed(folder / ONE, json_text(needed, indent=1))
        done.append(building)
        rows.append(row)
    result = replace(plan, buildings=tuple(done))
    write_georeference(placed.georeference, out)
    head = {
        "format": FORMAT, "source": str(job.source), "footprints": str(footprints.file), "note": placed.note,
        "metre": placed.metre, "crs": placed.georeference.crs, "outside": plan.outside, "most_photos": most,
        "passed_over": plan.passed_over,
    }  # fmt: skip
    write_if_changed(out / FILE, json_text({**head, "buildings": rows}, indent=1))
    write_if_changed(out / "buildings.geojson", json_text(_geojson(result, rows), indent=1))
    return result


def _model_of(job: Job) -> SparseModel:
    """The COLMAP model of the shared scene: the user's, or the one found from the photos."""
    folder = find_model(job.source, job.folder) or find_model(job.path("scene", "sfm"))
    if folder is None:
        raise BadInput(f"The COLMAP model of '{job.source}' is gone; run again in a new folder.")
    options = job.config.algorithm(AdjustOptions)
    return adjust_if_inconsistent(read_model(folder), job.config.resolution, Reporter(), options)  # as its scene stage


def _write_clicks(building: Building, folder: Path, earlier: dict[str, str]) -> None:
    """Write the clicks; automatic ones are known as such even where the plan ends in the middle."""
    if not building.by_hand:
        known, new = _automatic(folder, earlier), _digest(building.clicks)
        there = _digest(_read_clicks(folder / CLICKS)) if (folder / CLICKS).is_file() else ""
        if new not in known:
            write_if_changed(folder / AUTOMATIC, json_text(sorted({there} & known | {new})))
    write_if_changed(folder / CLICKS, json_text(building.clicks, indent=1))


def _automatic(folder: Path, earlier: dict[str, str]) -> set[str]:
    """Digests of the automatic clicks that were written for a building, or were about to be."""
    try:
        marked = {str(digest) for digest in json.loads((folder / AUTOMATIC).read_text(encoding="utf-8"))}
    except (OSError, ValueError, TypeError):
        marked = set()
    return marked | {earlier.get(folder.name, "")}


def _earlier(out: Path) -> dict[str, str]:
    """Digest of the automatic clicks of each building as they were written before."""
    try:
        rows = json.loads((out / FILE).read_text(encoding="utf-8"))["buildings"]
        return {str(row["id"]): str(row["automatic"]) for row in rows}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _digest(clicks: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(clicks, sort_keys=True).encode()).hexdigest() if clicks else ""


def _with_hand(
    building: Building, out: Path, by_hand: Path | None, earlier: dict[str, str], names: set[str]
) -> Building:
    """The building with clicks by hand in the place of automatic ones, where there are some."""
    own = out / BUILDINGS / building.hull.id / CLICKS
    given = None if by_hand is None else by_hand / f"{building.hull.id}.json"
    clicks = None
    if given is not None and given.is_file():
        clicks = _read_clicks(given)
    elif own.is_file():
        found = _read_clicks(own)
        clicks = found if _digest(found) not in _automatic(own.parent, earlier) else None
    if not clicks:
        return building
    strange = sorted(set(clicks) - names)
    if strange:
        raise BadInput(f"'{given or own}' names the photo '{strange[0]}', which the scene does not have; correct it.")
    return replace(building, hull=replace(building.hull, state=BY_HAND, reason=""), clicks=clicks, by_hand=True)


def _read_clicks(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
        if not isinstance(data, dict):
            raise ValueError("no entries of photos")
        return data
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(f"The clicks '{path}' cannot be read ({error}); correct or delete the file.") from error


def _within(area: Any, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    import shapely

    return np.asarray(shapely.contains_xy(area, points[:, :2]))


def _row(building: Building, plan: Plan, given: dict[str, Any], polygons: dict[str, Any]) -> dict[str, Any]:
    """A building as plain data."""
    hull, choice, metre = building.hull, building.choice, plan.placed.metre
    names = [plan.scene.views[k].name for k in choice.photos]
    options = {**given, "gps": "off", "crop_box": crop_box(hull, polygons, plan.placed, plan.options.box)}
    for name in ("crs", "control", "marks", "scale_bars"):  # the town has them, once for all
        options.pop(name, None)
    row: dict[str, Any] = {
        "id": hull.id, "state": hull.state, "reason": hull.reason, "ground": round(hull.low, 3),
        "height": round((hull.high - hull.low) / metre, 2), "area": round(hull.polygon.area / metre**2, 2),
        "points": hull.points, "photos": names, "candidates": choice.candidates, "share": round(choice.share, 4),
        "pixel": round(choice.pixel, 4), "seen": round(choice.seen, 3),
        "clicked": {name: [len(e.get("positive", [])), len(e.get("negative", []))]
                    for name, e in building.clicks.items()},
        "automatic": "" if building.by_hand else _digest(building.clicks), "options": options,
    }  # fmt: skip
    if names:
        row["estimate"] = _estimate(plan.scene, building, options)
    return row


def _estimate(scene: Scene, building: Building, options: dict[str, Any]) -> dict[str, Any]:
    """Seconds and bytes of the building's job."""
    config: Config = make_config(options)
    sizes = Counter((view.original_width, view.original_height) for view in scene.views)
    width, height = sizes.most_common(1)[0][0]
    photos = Photos(
        len(building.choice.photos), (max(width, height), min(width, height)), True, max(0.02, building.choice.share)
    )
    found = estimate(config, photos)
    return {"seconds": round(sum(found.seconds.values()), 1), "bytes": round(max(found.memory.values()))}


def _geojson(plan: Plan, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The buildings as GeoJSON in the CRS of the georeference, or in local coordinates."""
    import shapely

    georeference: Georeference = plan.placed.georeference
    features = []
    for building, row in zip(plan.buildings, rows, strict=True):
        shape = shapely.transform(building.hull.polygon, lambda p: p + np.array(georeference.offset[:2]))
        kept = {key: row[key] for key in ("id", "state", "reason", "height", "area", "points", "candidates", "seen")}
        properties = {**kept, "photos": len(row["photos"]), **row.get("estimate", {})}
        geometry = json.loads(shapely.to_geojson(shape))
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    data: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if georeference.crs:
        data["crs"] = {"type": "name", "properties": {"name": georeference.crs}}
    return data


def read_plan(out: Path) -> dict[str, Any]:
    """Read what :func:`write_plan` wrote as ``buildings.json``.

    Raises:
        BadInput: it is not there or damaged.
    """
    try:
        data = json.loads((out / FILE).read_text(encoding="utf-8"))
        if data["format"] != FORMAT or not isinstance(data["buildings"], list):
            raise ValueError("it was written by another version of MGF")
        return dict(data)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"'{out / FILE}' cannot be used ({error}); run 'mgf buildings' again.") from error
