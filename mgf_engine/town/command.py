# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf buildings``: a folder per building, with photos and clicks, from a scene and a map of footprints."""

from __future__ import annotations

import argparse
import contextlib
import sys
from typing import Any

from mgf_engine.console.shared_arguments import path_of
from mgf_engine.console.terminal import format_duration, make_sink
from mgf_engine.errors import EXIT_DONE, BadInput
from mgf_engine.messages import Reporter
from mgf_engine.options.config import make_config
from mgf_engine.system.memory import GB
from mgf_engine.town.folder import town_folder
from mgf_engine.town.hulls import WITH_JOB
from mgf_engine.town.plan import BUILDINGS, MOST_PHOTOS, Plan
from mgf_engine.town.plan_files import read_plan


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what ``mgf buildings`` and ``mgf town`` take beside the options of jobs."""
    parser.add_argument("scene", type=path_of, help="COLMAP scene, or a folder of photos")
    parser.add_argument(
        "--footprints", type=path_of, default=None, metavar="FILE",
        help="outlines of the buildings: GeoJSON, GeoPackage, Shapefile or CityJSON",
    )  # fmt: skip
    parser.add_argument(
        "--find", action="store_true", default=False,
        help="without footprints: take what stands above the ground in the sparse points",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=path_of, required=True, metavar="FOLDER", help="where the folders of buildings go"
    )
    parser.add_argument("--layer", default="", help="of a GeoPackage; the first one with areas by default")
    parser.add_argument(
        "--footprints-crs", default="", metavar="CRS",
        help="coordinate reference system of the footprints, where the file names none or a wrong one; 'scene' for "
        "coordinates of the scene itself",
    )  # fmt: skip
    parser.add_argument(
        "--pairs", type=path_of, default=None, metavar="FILE",
        help="three points or more known in map and scene (CSV: east, north, height, x, y, z)",
    )  # fmt: skip
    parser.add_argument(
        "--photos-per-building", type=int, default=MOST_PHOTOS, metavar="N", help=f"at most (default {MOST_PHOTOS})"
    )
    parser.add_argument(
        "--clicks", type=path_of, default=None, metavar="FOLDER",
        help="clicks by hand, ID.json for each building that has some; they win over automatic ones",
    )  # fmt: skip


def buildings_command(args: argparse.Namespace, user_options: dict[str, Any]) -> int:
    """Make the plan, write it, and say what was found."""
    with town_folder(args.out, args.scene):
        plan = plan_town(args, user_options)
    print(format_plan(plan))
    rows = [row for row in read_plan(args.out)["buildings"] if row["state"] in WITH_JOB]
    if rows:
        print(time_and_memory(rows))
    print(f"Written to {args.out / BUILDINGS}; look at {args.out / 'map.png'} before the jobs.")
    return EXIT_DONE


def plan_town(args: argparse.Namespace, user_options: dict[str, Any]) -> Plan:
    """Make the plan on disk from the arguments, and show progress on the terminal.

    Raises:
        BadInput: what :mod:`mgf_engine.town.plan` and its parts raise, or impossible arguments.
    """
    with contextlib.closing(Reporter(make_sink("auto"))) as reporter:
        return _plan_town(args, user_options, reporter)


def _plan_town(args: argparse.Namespace, user_options: dict[str, Any], reporter: Reporter) -> Plan:
    from mgf_engine.town.find import find_buildings
    from mgf_engine.town.footprints import read_footprints
    from mgf_engine.town.map import draw_map
    from mgf_engine.town.place import place_footprints
    from mgf_engine.town.plan import SCENE, PlanOptions, make_plan, shared_scene
    from mgf_engine.town.plan_files import write_plan
    from mgf_engine.town.view_selection import MIN_BUILDING_PHOTOS

    if args.photos_per_building < MIN_BUILDING_PHOTOS:
        raise BadInput(f"--photos-per-building must be {MIN_BUILDING_PHOTOS} or more; a building needs that many.")
    if args.clicks is not None and not args.clicks.is_dir():
        raise BadInput(f"The clicks '{args.clicks}' are no folder; give one that holds ID.json for each building.")
    if args.find == (args.footprints is not None):
        raise BadInput("Give either --footprints FILE, or --find to look for buildings in the sparse points.")
    footprints = read_footprints(args.footprints, args.layer) if args.footprints is not None else None
    job, scene = shared_scene(args.scene, args.out / SCENE, {**user_options, "max_photos": 0}, reporter)
    if footprints is None:
        footprints, placed = find_buildings(scene, make_config(user_options), reporter.warning)
    else:
        placed = place_footprints(
            footprints, scene, make_config(user_options), args.footprints_crs, args.pairs, reporter.warning
        )
    try:
        plan = make_plan(scene, placed, footprints, args.photos_per_building, _say, job.config.algorithm(PlanOptions))
    finally:
        _say("")
    plan = write_plan(plan, job, args.out, user_options, footprints, args.photos_per_building, args.clicks)
    outlines = [(b.hull.id, b.hull.state, b.hull.polygon) for b in plan.buildings]
    draw_map(args.out / "map.png", scene, placed, outlines)
    return plan


def _say(text: str) -> None:
    """Show a line of progress in the place of the one before, where somebody watches."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


def format_plan(plan: Plan) -> str:
    """Return the plan as people read it, what is doubtful below."""
    metre = plan.placed.metre
    wide = 2 + max([18, *(len(building.hull.id) for building in plan.buildings)])
    head = f"{'building':<{wide}}{'state':<18}{'height':>8}{'area':>9}{'photos':>8}{'clicked':>9}{'pixel':>9}"
    lines = [plan.placed.note, "", head]
    for building in plan.buildings:
        hull, choice = building.hull, building.choice
        height, area = (hull.high - hull.low) / metre, hull.polygon.area / metre**2
        pixel = f"{100 * choice.pixel:>6.1f} cm" if choice.photos else ""
        lines.append(
            f"{hull.id:<{wide}}{hull.state:<18}{height:>6.1f} m{area:>6.0f} m2"
            f"{len(choice.photos):>8}{len(building.clicks):>9}{pixel}"
        )
    lines += [""] + [f"{b.hull.id}: {b.hull.reason}" for b in plan.buildings if b.hull.reason]
    if plan.outside:
        lines.append(f"{plan.outside} footprints lie outside of what the photos show.")
    if plan.passed_over:
        lines.append(f"{plan.passed_over} entries of the map are no areas and were passed over.")
    return "\n".join(lines)


def time_and_memory(rows: list[dict[str, Any]]) -> str:
    """Return one sentence: what the jobs of these buildings will take together, and the largest of them."""
    seconds = sum(row["estimate"]["seconds"] for row in rows)
    memory = max(row["estimate"]["bytes"] for row in rows)
    return (
        f"Jobs: {len(rows)}, about {format_duration(seconds)} one after the other; the largest takes "
        f"{memory / GB:.1f} GB."
    )
