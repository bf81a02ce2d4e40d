# SPDX-License-Identifier: GPL-3.0-or-later
"""Add points by stereo where structure from motion found none, such as on flat roofs and plain walls.

The masks interpolate the building's surface between sparse points. Without any points on a roof, its pixels seem to
show the ground behind it. Stereo matching of neighbouring photos finds such surfaces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.image_ops import dilate_square, disc
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.scene.coarse_stereo import CoarseStereoOptions, match_reduced, on_aliased_texture
from mgf_engine.scene.depths import Depths, Matching, match_photos
from mgf_engine.scene.neighbours import MatchingPoints
from mgf_engine.scene.stereo import StereoOptions

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class DensifyOptions:
    """Options of the points added for the masks."""

    neighbours: int = parameter(3, "Number of photos that each photo is matched with", low=1)
    longest_side: int = parameter(375, "Longest side of the photos that are matched", "px", low=64)
    reach: float = parameter(
        0.05, "Distance from all points beyond which a pixel is bare, as a share of the longer side", high=1
    )
    cell: float = parameter(
        0.025, "Side of the cells that get one point at most, as a share of the longer side", low=0.001, high=1
    )
    window: int = parameter(6, "Half width of the window that must be matched without a step in depth", "px")
    matched: float = parameter(0.8, "Share of that window that must be matched", high=1)
    step: float = parameter(0.04, "Relative change of depth that is a step")
    confirmed: int = parameter(3, "Number of photos that must see a point", low=1)
    reduced_window: int = parameter(3, "Such half width in photos that are reduced since fine textures alias", "px")
    reduced_matched: float = parameter(0.5, "Share of that window that must be matched", high=1)
    reduced_step: float = parameter(0.08, "Relative change of depth that is a step there")

    stereo: StereoOptions = StereoOptions()
    coarse: CoarseStereoOptions = CoarseStereoOptions()


def densify_points(
    scene: Scene,
    clicks: Mapping[int, NDArray[np.floating]],
    leafy: Callable[[int], NDArray[np.bool_]],
    threads: int,
    check: Callable[[], None],
    options: DensifyOptions = DensifyOptions(),
) -> Scene:
    """Return the scene with points added where it has none; their tracks are the photos that confirm them.

    If no two photos agree at clicks on texture, reduced photos are matched as well: this resolves moiré, but not mirror
    images, for which the reduced photos are not used.

    Args:
        scene: normalised frame.
        clicks: on the building, px [N, 2], by view index.
        leafy: view -> bool [h, w] of any size: leaves and grass, which are never flat nor the building.
        threads: photos that are worked on at a time.
        check: called between photos; may raise to cancel.
        options: grid, matching and agreement of the new points.

    Returns:
        A scene whose first points are those of ``scene``; their observations come first, too.
    """
    matching = Matching(options.neighbours, options.longest_side, options.stereo)
    depths = match_photos(_all_points(scene), None, matching, threads, check)
    full = _with_points(scene, depths, leafy, check, options)
    if _aliased_clicks(scene, depths, clicks, options.coarse) < options.coarse.least_clicks:
        return full
    depths = match_reduced(_all_points(full), None, matching, options.coarse, threads, check)
    if _aliased_clicks(scene, depths, clicks, options.coarse) > options.coarse.most_clicks:
        return full
    options = replace(
        options, window=options.reduced_window, matched=options.reduced_matched, step=options.reduced_step
    )
    return _with_points(full, depths, leafy, check, options)


def _all_points(scene: Scene) -> MatchingPoints:
    """Return all views and all sparse points of a scene."""
    return MatchingPoints(scene, np.ones(len(scene.points), bool), range(len(scene.views)))


def _aliased_clicks(
    scene: Scene, depths: Depths, clicks: Mapping[int, NDArray[np.floating]], options: CoarseStereoOptions
) -> float:
    """Return the share of the clicks that lie on texture which no two photos agree about; 0 without clicks."""
    found = [np.zeros(0, bool)]
    for index, places in clicks.items():
        view = scene.views[index]
        if len(places):
            found.append(on_aliased_texture(depths, index, places / (view.width, view.height), options))
    aliased = np.concatenate(found)
    return float(aliased.mean()) if len(aliased) else 0.0


def _with_points(
    scene: Scene,
    depths: Depths,
    leafy: Callable[[int], NDArray[np.bool_]],
    check: Callable[[], None],
    options: DensifyOptions,
) -> Scene:
    """Return the scene with points of depth maps where it has none, see :func:`densify_points`."""
    views = range(len(scene.views))
    bare = {
        i: ~_near_known_points(scene, i, depths, options) & ~_near_mask(leafy(i), depths.photos[i].grey.shape, options)
        for i in views
    }
    found: list[tuple[NDArray[np.float64], NDArray[np.uint8], Flags]] = []
    for index in depths.maps:
        check()
        points, colors = _choose_points(index, depths, bare[index], options)
        seen = _views_showing(points, index, depths, len(views))
        enough = seen.sum(1) >= options.confirmed
        points, colors, seen = points[enough], colors[enough], seen[enough]
        for other in np.flatnonzero(seen.any(0)).tolist():
            bare[other] &= ~_near_new_points(scene, other, points[seen[:, other]], bare[other].shape, options)
        found.append((points, colors, seen))
    return _append_points(scene, *(np.concatenate(parts) for parts in zip(*found, strict=True))) if found else scene


def _choose_points(
    index: int, depths: Depths, bare: Flags, options: DensifyOptions
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return at most one point [N, 3] for each cell of a photo's bare pixels [h, w], with its grey as colour [N, 3]."""
    pixels, points = depths.points(index, bare & _smoothly_matched(depths.maps[index], options))
    side = _cell(bare.shape, options)
    cell = pixels // side @ np.array([bare.shape[1], 1])
    aside = np.abs(pixels % side - side / 2).sum(1)
    order = np.lexsort((aside, cell))
    chosen = order[np.unique(cell[order], return_index=True)[1]]
    grey = depths.photos[index].grey[tuple(pixels[chosen].T)]
    return points[chosen], np.stack([grey] * 3, 1)


def _cell(shape: tuple[int, ...], options: DensifyOptions) -> int:
    """Return the side of a cell of a reduced photo, px."""
    return max(2, round(options.cell * max(shape)))


def _views_showing(points: NDArray[np.float64], index: int, depths: Depths, count: int) -> Flags:
    """Find which of ``count`` views show points [N, 3] of one view: it, its neighbours, and theirs; bool [N, count]."""
    result = np.zeros((len(points), count), bool)
    beside = depths.neighbours[index]
    for other in {k for i in beside for k in (i, *depths.neighbours[i])} - {index}:
        result[:, other] = depths.confirms(other, points)
    result[:, index] = True
    return result


def _smoothly_matched(depth: NDArray[np.float32], options: DensifyOptions) -> Flags:
    """Find pixels [h, w] around which nearly all are matched, without a depth discontinuity."""
    window = np.ones((2 * options.window + 1,) * 2, np.uint8)
    matched = cv2.blur((depth > 0).astype(np.float32), window.shape) > options.matched
    around = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(np.where(depth > 0, depth, np.inf), around), cv2.dilate(depth, around)
    step = cv2.dilate((far / np.float32(1 + options.step) > near).astype(np.uint8), window) > 0
    return np.asarray(matched & ~step, bool)


def _near_known_points(scene: Scene, index: int, depths: Depths, options: DensifyOptions) -> Flags:
    """Find pixels [h, w] of a reduced photo that have a sparse point near by, be it one that only others observed."""
    view, shape = scene.views[index], depths.photos[index].grey.shape
    radius = round(options.reach * max(shape))
    places = np.concatenate(
        [scene.track_uv[scene.observations(index)], view.project(scene.points[depths.confirms(index, scene.points)])[0]]
    )
    return _draw_at(places / (view.width, view.height), shape, disc(radius))


def _near_mask(mask: Flags, shape: tuple[int, ...], options: DensifyOptions) -> Flags:
    """Return pixels [h, w] of a reduced photo on a mask of any size or beside it."""
    small = cv2.resize(mask.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST)
    return dilate_square(small > 0, options.window)


def _near_new_points(
    scene: Scene, index: int, points: NDArray[np.float64], shape: tuple[int, ...], options: DensifyOptions
) -> Flags:
    """Return pixels [h, w] of a reduced photo that new points stand for."""
    view = scene.views[index]
    window = np.ones((2 * _cell(shape, options) - 1,) * 2, np.uint8)
    return _draw_at(view.project(points)[0] / (view.width, view.height), shape, window)


def _draw_at(places: NDArray[np.floating], shape: tuple[int, ...], kernel: NDArray[np.uint8]) -> Flags:
    """Return the kernel at places [N, 2] (x, y as shares of the photo), bool [h, w]."""
    height, width = shape
    result = np.zeros((height, width), np.uint8)
    result[pixel_at(shape, places * (width, height))] = 1
    return np.asarray(cv2.dilate(result, kernel) > 0, bool)


def _append_points(scene: Scene, points: NDArray[np.float64], colors: NDArray[np.uint8], seen: Flags) -> Scene:
    """Return the scene with points [N, 3] more, and which views see each, [N, V]."""
    owner, view = np.nonzero(seen)
    uv = np.zeros((len(owner), 2))
    for index in np.unique(view):
        here, by = view == index, scene.views[index]
        uv[here] = np.clip(by.project(points[owner[here]])[0], 0, (by.width - 0.01, by.height - 0.01))
    counts = np.cumsum(seen.sum(1))
    return replace(
        scene,
        points=np.concatenate([scene.points, points]),
        colors=np.concatenate([scene.colors, colors]),
        errors=np.concatenate([scene.errors, np.zeros(len(points), np.float32)]),
        track_start=np.concatenate([scene.track_start, scene.track_start[-1] + counts]).astype(np.int64),
        track_view=np.concatenate([scene.track_view, view]).astype(np.int32),
        track_uv=np.concatenate([scene.track_uv, uv]).astype(np.float32),
    )
