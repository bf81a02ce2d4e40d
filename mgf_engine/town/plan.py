# SPDX-License-Identifier: GPL-3.0-or-later
"""From a scene and its footprints to a folder per building that a job can be made of.

``OUT/scene`` is a job that went as far as the scene stage; ``OUT/buildings/ID`` holds ``scene`` (the building's part of
the COLMAP model, with links to its photos), ``prompts.json`` and ``building.json``; ``buildings.json``,
``buildings.geojson`` and ``map.png`` are about all of them. Files that stay the same are not written again, so that
their times tell what has to be done anew.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from mgf_engine.town.clicks import ClickOptions, suggest_clicks
from mgf_engine.town.find import OutlineOptions, find_outlines
from mgf_engine.town.footprints import Footprints
from mgf_engine.town.hulls import BY_HAND, DOUBTFUL, GONE, READY, UNMAPPED, UNSEEN, Hull, HullOptions, make_hulls
from mgf_engine.town.place import Placed, local_points, near_scene
from mgf_engine.town.submodel import write_if_changed, write_submodel
from mgf_engine.town.view_selection import (
    FEWEST,
    BuildingViewOptions,
    HullBuffers,
    ViewSelection,
    choose_photos,
    draw_hulls,
)

Array = NDArray[np.float64]
BUILDINGS, SCENE, FILE, ONE = "buildings", "scene", "buildings.json", "building.json"
CLICKS = "prompts.json"
#: Digests of automatic clicks of a building: those that are there, and those that were about to take their place.
AUTOMATIC = "automatic.json"
FORMAT = 1
#: Photos of a building at most. More tell hardly more of it: the preset ``quick`` takes 60 of a whole scene.
MOST_PHOTOS = 40
_BESIDE = 1.0  # metre around a footprint that still is its building
_AROUND = 20.0  # metres around a footprint from which points are kept
_FREE, _SHARED, _BELOW = 1.8, 0.3, 0.3  # metres that the crop box leaves: for eaves, towards a neighbour, below
_DIM = 0.4  # share of walls and roof that two photos see, below which a building is doubtful


@dataclass(frozen=True)
class PlanOptions:
    """Options of the algorithms that a plan is made by."""

    hulls: HullOptions = HullOptions()
    outlines: OutlineOptions = OutlineOptions()
    views: BuildingViewOptions = BuildingViewOptions()
    clicks: ClickOptions = ClickOptions()


@dataclass(frozen=True)
class Building:
    """What is known of one building before its job.

    Attributes:
        hull: its prism, local frame.
        choice: its photos.
        clicks: of ``prompts.json``; empty where there are none.
        by_hand: somebody made or changed the clicks.
    """

    hull: Hull
    choice: ViewSelection
    clicks: dict[str, Any]
    by_hand: bool = False

    @property
    def runs(self) -> bool:
        """Whether a job can be made of it."""
        return self.hull.state in (READY, BY_HAND)


@dataclass(frozen=True)
class Plan:
    """All buildings of a scene and what they stand in."""

    scene: Scene
    placed: Placed
    buildings: tuple[Building, ...]
    outside: int
    passed_over: int


def shared_scene(source: Path, folder: Path, given: dict[str, Any], reporter: Reporter) -> tuple[Job, Scene]:
    """The scene stage of all photos, done once in a job folder; the job is closed again.

    Raises:
        BadInput: as the scene stage.
    """
    from mgf_engine.pipeline import run_job
    from mgf_engine.results import load_scene_of

    with Job.start(folder, source, given=given, resume=(folder / "job.json").exists()) as job:
        run_job(job, reporter, until="scene")
        return job, load_scene_of(job)


def make_plan(
    scene: Scene,
    placed: Placed,
    footprints: Footprints,
    most: int,
    say: Callable[[str], None] = lambda text: None,
    options: PlanOptions = PlanOptions(),
) -> Plan:
    """Hulls, photos and clicks of every building near the photos.

    Args:
        most: photos of a building at most.
        say: takes a line of progress.
    """
    points = local_points(scene, placed.georeference)
    near = np.flatnonzero(near_scene(placed.polygons, points, placed.metre))
    hulls = make_hulls([footprints.ids[k] for k in near], placed.polygons[near], points, placed.metre, options.hulls)
    hulls += _unmapped(placed, points, hulls, options)
    standing = [h for h in hulls if h.state != GONE] or hulls
    drawn = draw_hulls(scene, placed.georeference, standing, placed.metre, options.views)
    buildings = []
    for count, hull in enumerate(hulls, 1):
        number = next((k for k, other in enumerate(standing) if other is hull), -1)
        buildings.append(plan_building(scene, placed, hull, number, standing, points, drawn, most, options))
        say(f"{count} of {len(hulls)} buildings: {hull.id}, {buildings[-1].hull.state}")
    return Plan(scene, placed, tuple(buildings), len(footprints.ids) - len(near), footprints.passed_over)


def _unmapped(placed: Placed, points: Array, hulls: Sequence[Hull], options: PlanOptions) -> list[Hull]:
    """What stands where the map has nothing: it hides what lies behind it, and somebody should look at it."""
    import shapely

    taken = shapely.union_all([hull.polygon for hull in hulls]).buffer(_BESIDE * placed.metre)
    outlines = [o.polygon for o in find_outlines(points, placed.metre, options.outlines)]
    free = [polygon for polygon in outlines if polygon.intersection(taken).area < 0.1 * polygon.area]
    found = np.empty(len(free), object)
    found[:] = free
    names = [f"unmapped_{number}" for number in range(1, len(free) + 1)]
    reason = "Something as high as a building stands here, and the map has nothing; add it to the map if it is one."
    made = make_hulls(names, found, points, placed.metre, options.hulls) if free else []
    return [replace(hull, state=UNMAPPED, reason=reason) for hull in made if hull.state == READY]


def plan_building(
    scene: Scene,
    placed: Placed,
    hull: Hull,
    number: int,
    hulls: Sequence[Hull],
    points: Array,
    drawn: HullBuffers,
    most: int,
    options: PlanOptions = PlanOptions(),
) -> Building:
    """Photos and clicks of one building.

    Args:
        number: of the hull among ``hulls`` and in ``drawn``; -1 where it is not among them.
    """
    if number < 0 or hull.state == UNMAPPED:
        return Building(hull, ViewSelection([], 0.0, 0.0, 0.0, 0), {})
    choice = choose_photos(scene, placed.georeference, hull, number, hulls, drawn, most, placed.metre, options.views)
    if len(choice.photos) < FEWEST:
        few = f"Photos that show it: {len(choice.photos)}, where {FEWEST} are needed; fly there again."
        return Building(replace(hull, state=UNSEEN, reason=few), choice, {})
    if hull.state != READY:
        return Building(hull, choice, {})
    clicks = suggest_clicks(
        scene, placed.georeference, hull, number, hulls, points, drawn, choice, placed.metre, options.clicks
    )
    if len(clicks) < FEWEST:
        few = f"Only {len(clicks)} photos show spots that surely are on it; click it by hand."
        return Building(replace(hull, state=DOUBTFUL, reason=few), choice, {})
    if choice.seen < _DIM:
        dark = f"Two photos or more see only {choice.seen:.0%} of it; click it by hand if that is enough."
        return Building(replace(hull, state=DOUBTFUL, reason=dark), choice, {})
    return Building(hull, choice, clicks)


def write_plan(plan: Plan, job: Job, out: Path, given: dict[str, Any], footprints: Footprints, most: int,
               by_hand: Path | None) -> Plan:  # fmt: skip
    """Write everything of a plan below ``out``; clicks that somebody made or changed stay.

    Args:
        job: of the shared scene.
        given: options of the jobs.
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
            reach = building.hull.polygon.buffer((_AROUND) * placed.metre)
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


def _within(area: Any, points: Array) -> NDArray[np.bool_]:
    import shapely

    return np.asarray(shapely.contains_xy(area, points[:, :2]))


def _row(building: Building, plan: Plan, given: dict[str, Any], polygons: dict[str, Any]) -> dict[str, Any]:
    """A building as plain data."""
    hull, choice, metre = building.hull, building.choice, plan.placed.metre
    names = [plan.scene.views[k].name for k in choice.photos]
    options = {**given, "gps": "off", "crop_box": crop_box(hull, polygons, plan.placed)}
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


def crop_box(hull: Hull, polygons: dict[str, Any], placed: Placed) -> str:
    """The box that the mesh of a building is cut to, as the option ``crop_box`` takes it (scene frame).

    It is the smallest rectangle around the footprint, wider by the eaves at free sides and only by the footprint's
    own error where a neighbour begins.
    """
    import shapely

    metre = placed.metre
    box = shapely.oriented_envelope(hull.polygon)
    corners = shapely.get_coordinates(box)[:4]
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    sizes = np.linalg.norm(along), np.linalg.norm(across)
    axes = along / sizes[0], across / sizes[1]
    others = [p for name, p in polygons.items() if name != hull.id and p.distance(box) < 3 * metre]
    reach = []
    for axis, other, size, start in ((axes[0], axes[1], sizes[1], 0), (axes[1], axes[0], sizes[0], 1)):
        origin = corners[0]
        length = sizes[start]
        for sign, base in ((-1.0, origin), (1.0, origin + axis * length)):
            strip = shapely.Polygon([base, base + other * size, base + other * size + sign * axis * 1.2 * metre,
                                     base + sign * axis * 1.2 * metre])  # fmt: skip
            taken = sum(strip.intersection(p).area for p in others) > 0.1 * strip.area
            reach.append((_SHARED if taken else _FREE) * metre)
    low = np.array([-reach[0], -reach[2]])
    high = np.array([sizes[0] + reach[1], sizes[1] + reach[3]])
    middle, half = (low + high) / 2, (high - low) / 2
    bottom, top = hull.low - _BELOW * metre, hull.high + max(4 * metre, 0.75 * (hull.high - hull.low))
    matrix = np.eye(4)
    matrix[:2, 0], matrix[:2, 1] = axes[0] * half[0], axes[1] * half[1]
    matrix[2, 2] = (top - bottom) / 2
    matrix[:2, 3] = corners[0] + axes[0] * middle[0] + axes[1] * middle[1]
    matrix[2, 3] = (top + bottom) / 2
    return " ".join(f"{v:.12g}" for v in (np.linalg.inv(placed.georeference.to_local) @ matrix).ravel())


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
    """What :func:`write_plan` wrote as ``buildings.json``.

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
