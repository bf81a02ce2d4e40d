# SPDX-License-Identifier: GPL-3.0-or-later
"""Plan of a town: hull, photos and clicks of every building, from a scene and its footprints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.job_folder import remove_refused
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.town.clicks import ClickOptions, suggest_clicks
from mgf_engine.town.crop import BuildingBoxOptions
from mgf_engine.town.find import OutlineOptions, find_outlines
from mgf_engine.town.footprints import Footprints
from mgf_engine.town.hulls import (
    DOUBTFUL,
    GONE,
    READY,
    UNMAPPED,
    UNSEEN,
    WITH_JOB,
    BuildingHullOptions,
    Hull,
    make_hulls,
)
from mgf_engine.town.place import PlacedFootprints, local_points, near_scene
from mgf_engine.town.view_selection import (
    MIN_BUILDING_PHOTOS,
    BuildingViewOptions,
    HullScene,
    ViewSelection,
    choose_photos,
)

Array = NDArray[np.float64]
BUILDINGS, SCENE, FILE, ONE = "buildings", "scene", "buildings.json", "building.json"
CLICKS = "prompts.json"
#: Photos of a building at most. More tell hardly more of it: the preset ``quick`` takes 60 of a whole scene.
MOST_PHOTOS = 40


@dataclass(frozen=True)
class PlanOptions:
    """Options of the algorithms that a plan is made by."""

    beside: float = parameter(1.0, "Distance from a footprint up to which points belong to its building", "m")
    around: float = parameter(20.0, "Distance from a footprint up to which the points of its job are kept", "m")
    least_seen: float = parameter(
        0.4, "Share of walls and roof seen by two photos below which a building is doubtful", high=1
    )
    point_reach: float = parameter(15.0, "Maximum distance from a given point to the building that it means", "m")
    box: BuildingBoxOptions = BuildingBoxOptions()
    hulls: BuildingHullOptions = BuildingHullOptions()
    outlines: OutlineOptions = OutlineOptions()
    views: BuildingViewOptions = BuildingViewOptions()
    clicks: ClickOptions = ClickOptions()


@dataclass(frozen=True)
class Building:
    """Plan of one building before its job.

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
        return self.hull.state in WITH_JOB

    def photo_names(self, scene: Scene) -> list[str]:
        """Return the photos of its job by name: those of its choice, then those that somebody clicked besides."""
        chosen = [scene.views[k].name for k in self.choice.photos]
        return list(dict.fromkeys([*chosen, *self.clicks])) if self.by_hand else chosen


@dataclass(frozen=True)
class Plan:
    """All buildings of a scene and what they stand in.

    Attributes:
        scene: photos and points.
        placed: the footprints in the local frame.
        buildings: those near the photos.
        outside: number of footprints that no photo shows.
        passed_over: number of entries of the map that are no areas.
        options: that the plan was made by.
    """

    scene: Scene
    placed: PlacedFootprints
    buildings: tuple[Building, ...]
    outside: int
    passed_over: int
    options: PlanOptions = PlanOptions()


def shared_scene(source: Path, folder: Path, user_options: dict[str, Any], reporter: Reporter) -> tuple[Job, Scene]:
    """Run the scene stage of all photos, once in a job folder; the job is closed again, and removed if it was refused.

    Args:
        source: folder of the user's scene.
        folder: of the job.
        user_options: options as the user gave them.
        reporter: for progress and warnings.

    Raises:
        BadInput: as the scene stage.
    """
    from mgf_engine.jobs.results import load_scene_of
    from mgf_engine.pipeline import run_job

    new = not folder.exists()
    try:
        with Job.start(folder, source, user_options=user_options, resume=(folder / "job.json").exists()) as job:
            run_job(job, reporter, until="scene", suggest=False)
            return job, load_scene_of(job)
    except BadInput:
        if new:
            remove_refused(folder)
        raise


def make_plan(
    scene: Scene,
    placed: PlacedFootprints,
    footprints: Footprints,
    most: int,
    say: Callable[[str], None] = lambda text: None,
    options: PlanOptions = PlanOptions(),
) -> Plan:
    """Find hull, photos and clicks of every building near the photos.

    Args:
        scene: all photos.
        placed: the footprints in the local frame.
        footprints: as their file has them.
        most: photos of a building at most.
        say: takes a line of progress.
        options: of hulls, photos and clicks.
    """
    points = local_points(scene, placed.georeference)
    near = np.flatnonzero(near_scene(placed.polygons, points, placed.metre))
    hulls = make_hulls([footprints.ids[k] for k in near], placed.polygons[near], points, placed.metre, options.hulls)
    hulls += _unmapped(placed, points, hulls, options)
    standing = [h for h in hulls if h.state != GONE] or hulls
    town = HullScene.draw(scene, placed.georeference, placed.metre, points, standing, options.views)
    buildings = []
    for count, hull in enumerate(hulls, 1):
        number = next((k for k, other in enumerate(standing) if other is hull), -1)
        buildings.append(plan_building(town, hull, number, most, options))
        say(f"{count} of {len(hulls)} buildings: {hull.id}, {buildings[-1].hull.state}")
    return Plan(scene, placed, tuple(buildings), len(footprints.ids) - len(near), footprints.passed_over, options)


def _unmapped(placed: PlacedFootprints, points: Array, hulls: Sequence[Hull], options: PlanOptions) -> list[Hull]:
    """Make hulls of buildings that the map lacks: they hide what lies behind them, and the user should look at them."""
    taken = shapely.union_all([hull.polygon for hull in hulls]).buffer(options.beside * placed.metre)
    outlines = [o.polygon for o in find_outlines(points, placed.metre, options.outlines)]
    free = [polygon for polygon in outlines if polygon.intersection(taken).area < 0.1 * polygon.area]
    found = np.empty(len(free), object)
    found[:] = free
    names = [f"unmapped_{number}" for number in range(1, len(free) + 1)]
    reason = "Something as high as a building stands here, and the map has nothing; add it to the map if it is one."
    made = make_hulls(names, found, points, placed.metre, options.hulls) if free else []
    return [replace(hull, state=UNMAPPED, reason=reason) for hull in made if hull.state == READY]


def plan_building(
    town: HullScene, hull: Hull, number: int, most: int, options: PlanOptions = PlanOptions()
) -> Building:
    """Choose photos and clicks of one building.

    Args:
        town: photos and hulls.
        hull: of the building.
        number: of the hull in the town; -1 where it is not among those.
        most: photos at most.
        options: of the photos and the clicks, and what is too little.
    """
    if number < 0 or hull.state == UNMAPPED:
        return Building(hull, ViewSelection([], 0.0, 0.0, 0.0, 0), {})
    choice = choose_photos(town, number, most, options.views)
    if len(choice.photos) < MIN_BUILDING_PHOTOS:
        few = f"Photos that show it: {len(choice.photos)}, where {MIN_BUILDING_PHOTOS} are needed; fly there again."
        return Building(replace(hull, state=UNSEEN, reason=few), choice, {})
    if hull.state != READY:
        return Building(hull, choice, {})
    clicks = suggest_clicks(town, number, choice, options.clicks)
    if len(clicks) < MIN_BUILDING_PHOTOS:
        few = f"Only {len(clicks)} photos show spots that surely are on it; click it by hand."
        return Building(replace(hull, state=DOUBTFUL, reason=few), choice, {})
    if choice.seen < options.least_seen:
        dark = f"Two photos or more see only {choice.seen:.0%} of it; click it by hand if that is enough."
        return Building(replace(hull, state=DOUBTFUL, reason=dark), choice, {})
    return Building(hull, choice, clicks)
