# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf suggest-clicks``: automatic clicks on one building without a map, to be checked before use."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.console.commands import run_reported
from mgf_engine.console.shared_arguments import add_reporting_arguments, path_of
from mgf_engine.errors import BadInput
from mgf_engine.files.images import write_picture
from mgf_engine.georef.model import Georeference
from mgf_engine.jobs.job_folder import check_no_file, remove_refused
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config
from mgf_engine.scene.cameras import from_original
from mgf_engine.scene.crop import parse_crop_box
from mgf_engine.town.click_files import digest, made_automatically, read_clicks, write_automatic
from mgf_engine.town.clicks import suggest_clicks
from mgf_engine.town.find import find_outlines
from mgf_engine.town.hulls import READY, make_hulls
from mgf_engine.town.place import local_points, place_scene
from mgf_engine.town.plan import CLICKS, SCENE, PlanOptions, shared_scene
from mgf_engine.town.view_selection import MIN_BUILDING_PHOTOS, HullScene, choose_photos

Array = NDArray[np.float64]
Clicks = dict[str, dict[str, list[list[float]]]]
STAGE = "suggest"
SHEET = "clicks.jpg"
_GREEN, _RED, _TILE = (60, 220, 60), (40, 40, 235), 480


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what ``mgf suggest-clicks`` takes beside the options of jobs."""
    parser.add_argument("scene", type=path_of, help="COLMAP scene, or a folder of photos")
    parser.add_argument("--out", type=path_of, required=True, metavar="FOLDER", help=f"for {CLICKS} and {SHEET}")
    parser.add_argument(
        "--job", type=path_of, default=None, metavar="FOLDER",
        help="job folder of the scene, whose scene stage is used, or made where it is missing (default: OUT/scene)",
    )  # fmt: skip
    parser.add_argument(
        "--point", type=float, nargs=3, default=None, metavar=("X", "Y", "Z"),
        help="a point on the building, scene coordinates; default: the building in --crop-box, else the largest one",
    )  # fmt: skip
    add_reporting_arguments(parser)


def suggest_command(args: argparse.Namespace, user_options: dict[str, Any]) -> int:
    """Write the clicks and a sheet of pictures with them; returns the exit code."""
    return run_reported(args, lambda reporter: _suggest(args, user_options, reporter))


def _suggest(args: argparse.Namespace, user_options: dict[str, Any], reporter: Reporter) -> None:
    """Suggest the clicks, write them and the sheet, and report them.

    Raises:
        BadInput: ``--point`` is no place, the folder holds clicks by hand, or as the scene stage and
            :func:`suggest_for_one`; earlier clicks are then still there.
    """
    if args.point is not None and not np.isfinite(args.point).all():
        raise BadInput("--point takes three finite numbers, X Y Z in the coordinates of the scene.")
    check_earlier(args.out)
    every = {**user_options, "max_photos": 0}  # a job of its own keeps the photos that it was told to use
    where = (args.out / SCENE, every) if args.job is None else (args.job, user_options)
    new = not args.out.exists()
    try:
        job, scene = shared_scene(args.scene, *where, reporter)
    except BadInput:
        if new:
            remove_refused(args.out)
        raise
    reporter.stages = (*reporter.stages, STAGE)
    reporter.stage(STAGE)
    clicks, place = suggest_for_one(scene, job.config, args.point, reporter)
    args.out.mkdir(parents=True, exist_ok=True)
    write_automatic(clicks, args.out, made_automatically(args.out))
    draw_clicks(scene, clicks, args.out / SHEET)
    count = sum(len(points) for entry in clicks.values() for points in entry.values())
    if args.progress == "json":
        files = {name: str(args.out / name) for name in (CLICKS, SHEET)}
        reporter.send("result", path=str(args.out), files=files, figures={"photos": len(clicks), "clicks": count})
        return
    reporter.progress(1.0)
    reporter.close()
    print(place)
    print(f"{count} clicks on {len(clicks)} photos: {args.out / CLICKS}; look at {args.out / SHEET} first.")


def check_earlier(folder: Path) -> None:
    """Check that a folder holds no clicks that suggested ones would take the place of.

    Raises:
        BadInput: it does, it is a file, or what it holds cannot be read.
    """
    check_no_file(folder)
    path, known = folder / CLICKS, made_automatically(folder)
    if not path.is_file() or (not known and (folder / SHEET).is_file()):  # an earlier version kept no record
        return
    found = digest(read_clicks(path))
    if found and found not in known:
        raise BadInput(f"'{path}' holds clicks that 'mgf suggest-clicks' did not make; give --out another folder.")


def suggest_for_one(
    scene: Scene, config: Config, point: Sequence[float] | None, reporter: Reporter
) -> tuple[Clicks, str]:
    """Return clicks on the building at a point, in the crop box, or the largest one.

    Args:
        scene: its photos and sparse points.
        config: crop box and coordinates.
        point: x, y, z in the scene frame.
        reporter: for progress and warnings.

    Returns:
        The clicks as ``prompts.json`` holds them, and one sentence about the building.

    Raises:
        BadInput: there is none, or too few photos or points show it.
    """
    options = config.algorithm(PlanOptions)
    georeference, metre = place_scene(scene, config, reporter.warning)
    points = local_points(scene, georeference)
    polygons = [outline.polygon for outline in find_outlines(points, metre, options.outlines)]
    wanted = _wanted_outline(config, point, georeference, polygons, metre, options.point_reach)
    others = [p for p in polygons if p.intersection(wanted).area < 0.3 * min(p.area, wanted.area)]
    shapes = np.empty(1 + len(others), object)
    shapes[:] = [wanted, *others]
    hulls = make_hulls([str(k) for k in range(len(shapes))], shapes, points, metre, options.hulls)
    if hulls[0].state != READY:
        raise BadInput(f"No clicks can be suggested there: {hulls[0].reason}")
    town = HullScene.draw(scene, georeference, metre, points, hulls, options.views)
    choice = choose_photos(town, 0, len(scene.views), options.views)
    clicks = suggest_clicks(town, 0, choice, options.clicks)
    if len(clicks) < MIN_BUILDING_PHOTOS:
        raise BadInput(f"Only {len(clicks)} photos show spots that surely are on the building; click it by hand.")
    middle = shapely.centroid(wanted)
    at = georeference.scene(np.array([middle.x, middle.y, (hulls[0].low + hulls[0].high) / 2]))
    size = f"{wanted.area / metre**2:.0f} m2, {(hulls[0].high - hulls[0].low) / metre:.1f} m high"
    return clicks, f"Building at {', '.join(f'{v:.2f}' for v in at)} (scene): {size}"


def _wanted_outline(
    config: Config,
    point: Sequence[float] | None,
    georeference: Georeference,
    polygons: list[shapely.Geometry],
    metre: float,
    reach: float,
) -> shapely.Geometry:
    """Return the outline of the building that is meant."""
    box = parse_crop_box(config.crop_box)
    if box is not None:
        cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        back = np.linalg.inv(box.to_cube)
        corners = georeference.local(cube @ back[:3, :3].T + back[:3, 3])
        return shapely.MultiPoint(corners[:, :2]).convex_hull
    if not polygons:
        raise BadInput(
            "Nothing in the sparse points stands on the ground like a building; give --crop-box, or click it by hand."
        )
    if point is None:
        return polygons[0]  # the largest
    place = georeference.local(np.array(point, float))
    spot = shapely.Point(place[:2])
    nearest = min(polygons, key=lambda polygon: float(polygon.distance(spot)))
    if nearest.distance(spot) > reach * metre:
        raise BadInput(
            f"The point lies {nearest.distance(spot) / metre:.0f} m from the nearest building that was found; give one "
            "in the coordinates of the scene, on the building."
        )
    return nearest


def draw_clicks(scene: Scene, clicks: Clicks, path: Path) -> None:
    """Draw the clicked photos side by side, green on the building and red beside it."""
    index = {view.name: k for k, view in enumerate(scene.views)}
    tiles = []
    for name, entry in clicks.items():
        view = scene.views[index[name]]
        size = _TILE / view.width
        picture = cv2.resize(scene.photo(index[name]), (_TILE, round(view.height * size)), interpolation=cv2.INTER_AREA)
        picture = np.ascontiguousarray(picture[..., ::-1])
        for kind, color in (("positive", _GREEN), ("negative", _RED)):
            spots = from_original(view, np.array(entry[kind], float).reshape(-1, 2)) * size
            for u, v in spots.astype(int).tolist():
                cv2.circle(picture, (u, v), 7, (255, 255, 255), -1)
                cv2.circle(picture, (u, v), 5, color, -1)
        tiles.append(picture)
    height = max(tile.shape[0] for tile in tiles)
    columns = min(3, len(tiles))
    tiles = [cv2.copyMakeBorder(t, 0, height - len(t), 0, 0, cv2.BORDER_CONSTANT, value=(255,) * 3) for t in tiles]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)]
    write_picture(path, np.asarray(np.vstack(rows)[..., ::-1], np.uint8))
