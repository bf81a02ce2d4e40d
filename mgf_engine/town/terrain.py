# SPDX-License-Identifier: GPL-3.0-or-later
"""The terrain of a town, ``python -m mgf_engine.town.terrain TOWN``: the ground between the buildings and under them.

Bare earth from the sparse points, on a coarse grid, with a texture from the photos where no building hides it. It is
one more rule of the Snakefile: ``TOWN/terrain`` holds ``terrain.ply`` (local frame), its texture, and ``terrain.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from mgf_engine.errors import EXIT_DONE, EXIT_FAULT, BadInput, explain
from mgf_engine.files.atomic import write_json
from mgf_engine.geometry.boxes import grid_points
from mgf_engine.geometry.mesh_files import write_ply, write_texture
from mgf_engine.georef.model import Georeference, read_georeference
from mgf_engine.jobs.job_folder import with_algorithms_of_job
from mgf_engine.mesh.colors import color_from_photos
from mgf_engine.model.masks import BACKGROUND, BUILDING, MaskSet, building
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.system.machine import cpu_seconds
from mgf_engine.town.find import OutlineOptions, height_over_ground
from mgf_engine.town.hulls import GONE, Hull
from mgf_engine.town.place import local_points, to_normalised
from mgf_engine.town.plan import SCENE
from mgf_engine.town.plan_files import read_plan
from mgf_engine.town.view_selection import BuildingViewOptions, draw_hulls

Array = NDArray[np.float64]
FOLDER, MESH, DONE, LOG = "terrain", "terrain.ply", "terrain.json", "log.txt"


@dataclass(frozen=True)
class TerrainOptions:
    """Options of the terrain."""

    cell: float = parameter(2.0, "Width of the cells of the grid", "m", low=0.01)
    most_cells: int = parameter(250, "Maximum number of cells along the longest side", low=2)
    above: float = parameter(0.8, "Height above the lowest points around up to which a point is ground", "m")
    eaves: float = parameter(0.7, "Distance that buildings reach beyond their footprints", "m")
    gap: int = parameter(3, "Number of cells without a point that the surface bridges, beside those under buildings")
    least_points: int = parameter(50, "Minimum number of points of the ground", low=4)
    texture_side: int = parameter(4096, "Maximum side of the texture", "px", low=16)
    outlines: OutlineOptions = OutlineOptions()
    views: BuildingViewOptions = BuildingViewOptions()


def make_terrain(town: Path) -> dict[str, Any]:
    """Make the terrain of a planned town, by the options that the town was planned with; returns figures.

    Raises:
        BadInput: the plan or the scene is gone, or too few points show the ground.
    """
    from mgf_engine.scene.store import read_saved_scene
    from mgf_engine.texture.texture_pipeline import make_texture

    began, cpu = time.perf_counter(), cpu_seconds()
    plan, georeference = read_plan(town), read_georeference(town)
    metre = float(plan["metre"])
    scene = read_saved_scene(town / SCENE / "scene")
    hulls = read_hulls(town, plan, georeference)
    points = local_points(scene, georeference)
    options = with_algorithms_of_job(town / SCENE, {}).algorithm(TerrainOptions)
    ground = ground_surface(points, [hull.polygon for hull in hulls], metre, options)
    folder = town / FOLDER
    folder.mkdir(exist_ok=True)
    warnings: list[str] = []
    masks = _ground_masks(scene, georeference, hulls, metre, options)
    seen = replace(ground, vertices=to_normalised(scene, georeference, ground.vertices))
    seen = color_from_photos(seen, scene.views, scene.photo, [building(labels) for labels in masks.labels])
    texture = make_texture(seen, scene, masks, options.texture_side, warnings.append)
    write_ply(
        replace(ground, colors=seen.colors), folder / MESH, comments=("terrain in the local frame of the town, z up",)
    )
    write_texture(texture, folder)
    return {
        "faces": len(ground.faces), "seconds": round(time.perf_counter() - began, 1),
        "cpu_seconds": round(cpu_seconds() - cpu, 1), "warnings": warnings,
    }  # fmt: skip


def read_hulls(town: Path, plan: dict[str, Any], georeference: Georeference) -> list[Hull]:
    """Read the hulls of what stands in a planned town, local frame."""
    offset = np.array(georeference.offset[:2])
    features = json.loads((town / "buildings.geojson").read_text(encoding="utf-8"))["features"]
    hulls = []
    for row, feature in zip(plan["buildings"], features, strict=True):
        shape = shapely.from_geojson(json.dumps(feature["geometry"]))
        polygon = shapely.transform(shape, lambda points: points - offset)
        top = row["ground"] + row["height"] * plan["metre"]
        if row["state"] != GONE:
            hulls.append(Hull(row["id"], polygon, row["ground"], top, row["points"], row["state"]))
    return hulls


def ground_surface(
    points: Array, footprints: list[shapely.Geometry], metre: float, options: TerrainOptions = TerrainOptions()
) -> Mesh:
    """Make the bare earth as triangles of a regular grid, without colours.

    Args:
        points: [P, 3] sparse points, local frame.
        footprints: shapely, local frame: points on them are no ground.
        metre: length of a metre there.
        options: of the grid.

    Raises:
        BadInput: too few points show the ground.
    """
    built = shapely.union_all([polygon.buffer(options.eaves * metre) for polygon in footprints])
    shapely.prepare(built)
    low = height_over_ground(points, metre, options.outlines) < options.above * metre
    ground = points[low & ~shapely.contains_xy(built, points[:, :2])]
    if len(ground) < options.least_points:
        raise BadInput(
            f"Only {len(ground)} points show the ground, and {options.least_points} are needed; run again with "
            "--no-terrain."
        )
    start = np.percentile(ground[:, :2], 0.5, axis=0)
    extent = np.percentile(ground[:, :2], 99.5, axis=0) - start
    cell = max(options.cell * metre, float(extent.max()) / options.most_cells)
    shape = tuple(np.ceil(extent / cell).astype(int) + 1)
    x, y = (start[k] + cell * np.arange(shape[k]) for k in range(2))
    place = grid_points(x, y)
    height, known = _heights(ground, start, cell, shape)
    kept = _extent(known, shapely.contains_xy(built, place).reshape(shape), options.gap)
    vertices = np.column_stack([place, height.ravel()])
    mesh = Mesh(vertices, _triangles(kept), np.zeros(vertices.shape, np.uint8))
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return mesh.gather(used, faces.reshape(-1, 3))


def _heights(ground: Array, start: Array, cell: float, shape: tuple[int, ...]) -> tuple[Array, NDArray[np.bool_]]:
    """Return height at each point of the grid [X, Y], and where points tell it."""
    at = np.rint((ground[:, :2] - start) / cell).astype(np.int64)
    inside = ((at >= 0) & (at < shape)).all(1)
    flat = np.ravel_multi_index(tuple(at[inside].T), shape)
    order = np.lexsort((ground[inside, 2], flat))
    cells, first, count = np.unique(flat[order], return_index=True, return_counts=True)
    middle = ground[inside, 2][order][first + (count - 1) // 2]  # the (lower) median
    spots = np.stack(np.unravel_index(cells, shape), 1)
    every = np.stack(np.unravel_index(np.arange(np.prod(shape)), shape), 1)
    height = np.full(len(every), np.nan)
    if len(spots) > 3 and np.ptp(spots, axis=0).min() > 0:
        height = LinearNDInterpolator(spots, middle)(every)
    bare = np.isnan(height)
    height[bare] = NearestNDInterpolator(spots, middle)(every[bare])
    known = np.zeros(shape, bool)
    known.ravel()[cells] = True
    smooth = ndimage.gaussian_filter(ndimage.median_filter(height.reshape(shape), 3, mode="nearest"), 0.7)
    return np.asarray(smooth), known


def _extent(known: NDArray[np.bool_], built: NDArray[np.bool_], gap: int) -> NDArray[np.bool_]:
    """Find where there is terrain: at points and buildings, and in small gaps between them; the largest piece of it."""
    near = np.pad(known | built, gap)
    if gap:
        near = ndimage.binary_closing(near, iterations=gap)[gap:-gap, gap:-gap]
    filled = ndimage.binary_opening(ndimage.binary_fill_holes(near), np.ones((3, 3)))  # no strips at the rim
    labels, count = ndimage.label(filled)
    if count > 1:
        filled = labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])
    return np.asarray(filled)


def _triangles(kept: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Two faces for each square of the grid [X, Y] whose corners are all kept; seen from above counter-clockwise."""
    number = np.arange(kept.size).reshape(kept.shape)
    square = kept[:-1, :-1] & kept[1:, :-1] & kept[:-1, 1:] & kept[1:, 1:]
    a, b, c, d = (part[square] for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def _ground_masks(
    scene: Scene, georeference: Georeference, hulls: list[Hull], metre: float, options: TerrainOptions
) -> MaskSet:
    """Return masks that show all but buildings, so that none is painted on the ground behind it."""
    count = len(scene.views)
    labels = [np.full((view.height, view.width), BUILDING, np.uint8) for view in scene.views]
    if hulls:
        wide = [replace(hull, polygon=hull.polygon.buffer(options.eaves * metre)) for hull in hulls]
        drawn = draw_hulls(scene, georeference, wide, metre, options.views)
        for k, view in enumerate(scene.views):
            hidden = (drawn.owner[k] >= 0).astype(np.uint8)
            labels[k][cv2.resize(hidden, (view.width, view.height), interpolation=cv2.INTER_NEAREST) > 0] = BACKGROUND
    sure = np.ones(count, np.float32)
    return MaskSet(tuple(labels), np.ones(count, bool), sure, np.ones(len(scene.points), bool))


def main() -> int:
    """Run the command of the Snakefile; returns the exit code."""
    from mgf_engine.native.library import set_threads

    parser = argparse.ArgumentParser()
    parser.add_argument("town", type=Path)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    cv2.setNumThreads(args.threads)
    set_threads(args.threads)
    try:
        figures = make_terrain(args.town)
    except (Exception, KeyboardInterrupt) as error:
        code, text = explain(error, again="run again", place=args.town)
        if code == EXIT_FAULT:
            traceback.print_exception(error)
        print(text, file=sys.stderr)
        return code
    write_json(args.town / FOLDER / DONE, figures)
    return EXIT_DONE


if __name__ == "__main__":
    sys.exit(main())
