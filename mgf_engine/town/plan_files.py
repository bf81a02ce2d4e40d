# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a town's plan: a folder per building that a job can be made of, and what tells of all of them.

``OUT/scene`` is a job that went as far as the scene stage; ``OUT/buildings/ID`` holds ``scene`` (the building's part of
the COLMAP model, with links to its photos), ``prompts.json`` and ``building.json``; ``buildings.json`` and
``buildings.geojson`` are about all buildings. Files that stay the same are not written again, so that their times tell
what has to be done anew.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason
from mgf_engine.files.atomic import json_text
from mgf_engine.georef.model import Georeference, write_georeference
from mgf_engine.jobs.estimate import PhotoSummary, estimate
from mgf_engine.jobs.job import Job
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config, make_config
from mgf_engine.scene.adjust import AdjustOptions, adjust_if_inconsistent
from mgf_engine.scene.colmap import find_model, read_model
from mgf_engine.scene.sparse import SparseModel
from mgf_engine.town.click_files import count_clicks, digest, read_automatic, with_hand_clicks, write_clicks
from mgf_engine.town.crop import crop_box
from mgf_engine.town.footprints import Footprints
from mgf_engine.town.hulls import DOUBTFUL
from mgf_engine.town.plan import BUILDINGS, FILE, ONE, SCENE, Building, Plan
from mgf_engine.town.submodel import write_if_changed, write_submodel

FORMAT = 1


def write_plan(
    plan: Plan,
    job: Job,
    out: Path,
    user_options: dict[str, Any],
    footprints: Footprints,
    most: int,
    by_hand: Path | None,
) -> Plan:
    """Write everything of a plan below ``out``; clicks that somebody made or changed stay.

    Args:
        plan: as :func:`mgf_engine.town.plan.make_plan` made it.
        job: of the shared scene.
        out: folder of the town.
        user_options: options of the jobs.
        footprints: the map, for its file's name.
        most: maximum number of photos of a building.
        by_hand: folder with ``ID.json`` for buildings that were clicked by hand; they win.

    Returns:
        The plan with the clicks that hold.

    Raises:
        BadInput: a file of clicks cannot be read.
    """
    earlier, photos = read_automatic(out / FILE), {view.name: Path(view.photo) for view in plan.scene.views}
    plan = replace(plan, buildings=tuple(
        with_hand_clicks(building, _folder(out, building), by_hand, earlier, photos) for building in plan.buildings
    ))  # fmt: skip
    submodels, polygons = _Submodels(plan, job, photos), {b.hull.id: b.hull.polygon for b in plan.buildings}
    rows = [_row(building, plan, user_options, polygons) for building in plan.buildings]
    for building, row in zip(plan.buildings, rows, strict=True):
        folder = _folder(out, building)
        if building.runs or building.hull.state == DOUBTFUL:
            submodels.write(building, folder / SCENE)
            if building.clicks:
                write_clicks(building, folder, earlier)
        if building.runs:
            needed = {key: row[key] for key in ("id", "photos", "options")}  # no estimate, which learns from each job
            write_if_changed(folder / ONE, json_text(needed, indent=1))
    write_georeference(plan.placed.georeference, out)
    head = {
        "format": FORMAT, "source": str(job.source), "footprints": str(footprints.file), "note": plan.placed.note,
        "metre": plan.placed.metre, "crs": plan.placed.georeference.crs, "outside": plan.outside, "most_photos": most,
        "passed_over": plan.passed_over,
    }  # fmt: skip
    write_if_changed(out / FILE, json_text({**head, "buildings": rows}, indent=1))
    write_if_changed(out / "buildings.geojson", json_text(_geojson(plan, rows), indent=1))
    return plan


def _folder(out: Path, building: Building) -> Path:
    return out / BUILDINGS / building.hull.id


class _Submodels:
    """Parts of the COLMAP model of the shared scene, one for each building."""

    def __init__(self, plan: Plan, job: Job, photos: dict[str, Path]) -> None:
        self.plan, self.model = plan, _model_of(job)
        self.points = plan.placed.georeference.local(self.model.points.xyz)
        self.photos = photos
        self.images = {image.name.replace("\\", "/"): image.name for image in self.model.images}

    def write(self, building: Building, folder: Path) -> None:
        """Write the images of a building, and the points around its footprint."""
        names = building.photo_names(self.plan.scene)
        reach = building.hull.polygon.buffer(self.plan.options.around * self.plan.placed.metre)
        images = [self.images[name] for name in names]
        photos = {self.images[name]: self.photos[name] for name in names}
        write_submodel(self.model, images, _within(reach, self.points), photos, folder)


def _model_of(job: Job) -> SparseModel:
    """Read the COLMAP model of the shared scene: the user's, or the one found from the photos."""
    folder = find_model(job.source, job.folder) or find_model(job.path("scene", "sfm"))
    if folder is None:
        raise BadInput(f"The COLMAP model of '{job.source}' is gone; run again in a new folder.")
    options = job.config.algorithm(AdjustOptions)
    return adjust_if_inconsistent(read_model(folder), job.config.resolution, Reporter(), options)  # as its scene stage


def _within(area: shapely.Geometry, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points [N, 3] lie within an area of the plan, bool [N]."""
    return np.asarray(shapely.contains_xy(area, points[:, :2]))


def _row(building: Building, plan: Plan, user_options: dict[str, Any], polygons: dict[str, Any]) -> dict[str, Any]:
    """Describe a building as plain data, for ``buildings.json``."""
    hull, choice, metre = building.hull, building.choice, plan.placed.metre
    names = building.photo_names(plan.scene)
    options = {**user_options, "gps": "off", "crop_box": crop_box(hull, polygons, plan.placed, plan.options.box)}
    for name in ("crs", "control", "marks", "scale_bars"):  # the town has them, once for all
        options.pop(name, None)
    row: dict[str, Any] = {
        "id": hull.id, "state": hull.state, "reason": hull.reason, "ground": round(hull.low, 3),
        "height": round((hull.high - hull.low) / metre, 2), "area": round(hull.polygon.area / metre**2, 2),
        "points": hull.points, "photos": names, "candidates": choice.candidates, "share": round(choice.share, 4),
        "pixel": round(choice.pixel, 4), "seen": round(choice.seen, 3),
        "clicked": count_clicks(building.clicks),
        "automatic": "" if building.by_hand else digest(building.clicks), "options": options,
    }  # fmt: skip
    if names:
        row["estimate"] = _estimate(plan.scene, len(names), choice.share, options)
    return row


def _estimate(scene: Scene, count: int, share: float, options: dict[str, Any]) -> dict[str, Any]:
    """Estimate the seconds and bytes of the job of a building.

    Args:
        scene: of the town.
        count: number of the building's photos.
        share: of such a photo that the building fills.
        options: of the job.
    """
    config: Config = make_config(options)
    sizes = Counter((view.original_width, view.original_height) for view in scene.views)
    width, height = sizes.most_common(1)[0][0]
    photos = PhotoSummary(count, (max(width, height), min(width, height)), True, max(0.02, share))
    found = estimate(config, photos)
    return {"seconds": round(sum(found.seconds.values()), 1), "bytes": round(max(found.memory.values()))}


def _geojson(plan: Plan, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the buildings as GeoJSON in the CRS of the georeference, or in local coordinates."""
    georeference: Georeference = plan.placed.georeference
    features = []
    for building, row in zip(plan.buildings, rows, strict=True):
        shape = shapely.transform(building.hull.polygon, lambda p: p + np.array(georeference.offset[:2]))
        kept = {key: row[key] for key in ("id", "state", "reason", "height", "area", "points", "candidates", "seen")}
        # No seconds: what is learned of the machine's speed changes them, and the terrain would be made again.
        properties = {**kept, "photos": len(row["photos"])}
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
        raise BadInput(f"'{out / FILE}' cannot be used ({reason(error)}); run 'mgf buildings' again.") from error
