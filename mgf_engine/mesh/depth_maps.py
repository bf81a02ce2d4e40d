# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the depth maps of all views: render the field, match patches between photos, smooth, and weigh each pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from mgf_engine.files.spill import Spill
from mgf_engine.mesh.depth_smoothing import smooth_depth
from mgf_engine.mesh.fusion_options import FusionOptions, TsdfOptions
from mgf_engine.mesh.photometric import Matched, RenderedSurface, match_surface, without_match
from mgf_engine.mesh.prior import PriorOptions, RenderedPrior, choose_depths, combine_surfaces
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.raster.api import Camera, render
from mgf_engine.raster.device import each_view
from mgf_engine.raster.points import INSIDE, NEAR

CPU = torch.device("cpu")
FAR = 1e6  # depth of pixels that show no surface
RIM_WEIGHT = 0.1  # factor on the weight of pixels next to a depth jump, where depths are unreliable
LEAST_COSINE = 0.1  # of the viewing angle: the weight of depths seen at a flatter angle falls no further
BYTES_PER_PIXEL = 150  # memory of a depth map while it is matched and smoothed (measured)

Progress = Callable[[float], None]


@dataclass(frozen=True)
class DepthMap:
    """Depth map of a view; only pixels inside the mask and one pixel around are stored.

    Attributes:
        view: camera, normalised frame.
        mask: as :func:`mgf_engine.mesh.hull.silhouette_mask` makes it, uint8 [H, W].
        rows: offset of each row, int64 [H]: pixel (x, y) is ``pixels[rows[y] + x]``.
        pixels: depth, slope (distance along the normal per unit of depth), weight and correlation, float32 [P, 4].
    """

    view: View
    mask: NDArray[np.uint8]
    rows: NDArray[np.int64]
    pixels: NDArray[np.float32]


@dataclass(frozen=True)
class ViewSurfaces:
    """Functions that render the views; each is called once per view.

    Attributes:
        show: number of a view -> the surface rendered from it.
        device: of the rendering.
        prior: number of a view -> the starting surface rendered from it; None if that is not used.
    """

    show: Callable[[int], RenderedSurface]
    device: torch.device = CPU
    prior: Callable[[int], RenderedPrior] | None = None


@dataclass(frozen=True)
class _MatchTask:
    """Mask of a view, and the surface and prior rendered from the view (first) and its neighbours."""

    mask: NDArray[np.uint8]
    surfaces: list[RenderedSurface]
    prior: list[RenderedPrior]


def make_depth_maps(
    shown: ViewSurfaces,
    masks: Sequence[NDArray[np.uint8]],
    neighbours: Sequence[Sequence[int]] = (),
    options: FusionOptions = FusionOptions(),
    progress: Progress = lambda share: None,
    spill: Spill | None = None,
) -> list[DepthMap]:
    """Render the depth maps of all views, match them with neighbouring photos, and smooth them.

    Args:
        shown: renders the views.
        masks: for each view uint8 [H, W] from :func:`mgf_engine.mesh.hull.silhouette_mask`.
        neighbours: for each view, the numbers of the views it is matched with; empty for no matching.
        options: of the matching, the smoothing and the fusion.
        progress: called with the share of the views that are done.
        spill: stores the pixels on disk if memory is short; None keeps them in memory.

    Returns:
        A depth map for each view.
    """
    near = [list(neighbours[number]) if neighbours else [] for number in range(len(masks))]
    order = visiting_order(near)
    asked = _views_with_neighbours(shown, masks, near, order, options.prior)
    each = BYTES_PER_PIXEL * max((mask.size for mask in masks), default=0)
    maps: dict[int, DepthMap] = {}
    for number, found in zip(
        order, parallel_map(lambda view: _match(view, options), asked, bytes_each=each), strict=True
    ):
        progress(len(maps) / len(masks))
        maps[number] = found if spill is None else replace(found, pixels=spill.keep(found.pixels))
    return [maps[number] for number in range(len(masks))]


def visiting_order(near: Sequence[Sequence[int]]) -> list[int]:
    """Order the views so that few renderings are in memory: next is the one with the fewest unrendered neighbours.

    Args:
        near: for each view, the numbers of the views it is matched with.
    """
    users: list[list[int]] = [[] for _ in near]
    for number, others in enumerate(near):
        for k in {number, *others}:
            users[k].append(number)
    missing = np.array([len({number, *others}) for number, others in enumerate(near)], np.int64)
    drawn, order = np.zeros(len(near), bool), list[int]()
    for _ in near:
        number = int(missing.argmin())
        order.append(number)
        for k in {number, *near[number]}:
            if not drawn[k]:
                drawn[k] = True
                missing[users[k]] -= 1
        missing[number] = np.iinfo(np.int64).max // 2  # done: never the minimum, even after further decrements
    return order


def _views_with_neighbours(
    shown: ViewSurfaces,
    masks: Sequence[NDArray[np.uint8]],
    near: Sequence[list[int]],
    order: Sequence[int],
    options: PriorOptions,
) -> Iterator[_MatchTask]:
    """Yield each view with its neighbours; renderings are freed as soon as no later view needs them.

    Args:
        shown: renders the views.
        masks: for each view uint8 [H, W].
        near: for each view, the numbers of the views it is matched with.
        order: of the views.
        options: of the choice between field and prior.
    """
    wanted = [(number, *near[number]) for number in order]
    in_order = [k for numbers in wanted for k in numbers]
    left = np.bincount(in_order, minlength=len(masks))
    drawn = each_view(shown.show, list(dict.fromkeys(in_order)), shown.device)
    surfaces: dict[int, RenderedSurface] = {}
    before: dict[int, RenderedPrior] = {}  # the prior, rendered from the same views
    for numbers in wanted:
        for k in numbers:
            if k not in surfaces:
                surfaces[k] = next(drawn)
                if shown.prior is not None:
                    before[k] = shown.prior(k)
                    surfaces[k] = combine_surfaces(surfaces[k], before[k], options)
        yield _MatchTask(masks[numbers[0]], [surfaces[k] for k in numbers], [before[k] for k in numbers if k in before])
        for k in numbers:
            left[k] -= 1
            if left[k] == 0:
                del surfaces[k]
                before.pop(k, None)


def _match(asked: _MatchTask, options: FusionOptions) -> DepthMap:
    """Match the depth of one view with its neighbours, choose between field and prior, and smooth it."""
    surface, *others = asked.surfaces
    found = match_surface(surface, others, options.match) if others else without_match(surface)
    if asked.prior:
        known, *rest = asked.prior
        surface, found = choose_depths(
            surface, known, found, [other.surface for other in rest], options.match, options=options.prior
        )
    if options.smoothing.strength > 0:
        found = replace(found, depth=smooth_depth(surface.depth, found, options.smoothing))
    return depth_map(surface, asked.mask, found, options.tsdf)


def render_surface(
    gaussians: Gaussians, view: View, grey: NDArray[np.uint8] | None = None, options: TsdfOptions = TsdfOptions()
) -> RenderedSurface:
    """Render depth and normals of the field from a view.

    Args:
        gaussians: normalised frame.
        view: camera of the photo.
        grey: the photo in grey levels, uint8 [H, W]; needed for matching only.
        options: minimum opacity of a surface.
    """
    with torch.no_grad():
        seen = render(gaussians, Camera.from_view(view), sh_degree=0).cpu()
    assert seen.median is not None and seen.normal is not None
    alpha = seen.alpha.numpy()
    depth = _surface_depth(seen.median.numpy(), seen.depth.numpy() / np.maximum(alpha, 1e-6), options.mixed)
    normal = seen.normal.numpy() / np.maximum(np.linalg.norm(seen.normal.numpy(), axis=0), 1e-6)
    depth = np.where((alpha >= options.min_alpha) & (depth > NEAR), depth, 0.0).astype(np.float32)
    grey = np.zeros(depth.shape, np.uint8) if grey is None else grey
    return RenderedSurface(
        view, grey, depth, np.ascontiguousarray(normal.transpose(1, 2, 0)), alpha < options.free_space_alpha
    )


def depth_map(
    surface: RenderedSurface, mask: NDArray[np.uint8], matched: Matched, options: TsdfOptions = TsdfOptions()
) -> DepthMap:
    """Make the depth map for the fusion: matched depths with a weight for each pixel.

    The weight falls with the viewing angle, with the squared depth, next to depth jumps, and without a match.

    Args:
        surface: as rendered from the view.
        mask: from :func:`mgf_engine.mesh.hull.silhouette_mask`, uint8 [H, W].
        matched: depth and its reliability, from the matching.
        options: weights of pixels with and without a match.
    """
    view, normal, depth = surface.view, surface.normal, matched.depth
    unmatched = options.unmatched if matched.unmatched_weight is None else matched.unmatched_weight
    u, v = view.pixel_rays()
    slope = np.clip(
        -(normal[..., 0] * u[None] + normal[..., 1] * v[:, None] + normal[..., 2]), options.least_slope, None
    )
    cosine = np.clip(slope / np.sqrt(1 + u[None] ** 2 + v[:, None] ** 2), LEAST_COSINE, 1.0)
    weight = cosine**2 / np.maximum(depth, 1e-6) ** 2
    at_jumps = np.where(_beside_jumps(depth, options.jump), RIM_WEIGHT, 1.0)
    weight *= at_jumps * np.where(matched.correlation > 0, 1.0, unmatched)
    shown = depth > 0
    weight = np.where(shown, weight, 0.0)
    if shown.any():  # pixels that see past the field: the whole ray is free space
        weight[surface.free_space] = options.free_space_weight * np.median(weight[shown])
    depth, slope = np.where(surface.free_space, FAR, depth), np.where(surface.free_space, 1.0, slope)
    rows, kept = _spans(mask == INSIDE)
    return DepthMap(
        view, mask, rows, np.stack([a[kept] for a in (depth, slope, weight, matched.correlation)], -1, dtype=np.float32)
    )


def _spans(inside: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Mark, in each row, the span from the first to the last pixel that is inside or next to an inside one.

    Returns:
        The offset of each row in the list of marked pixels, int64 [H]; and the marked pixels, bool [H, W].
    """
    width = inside.shape[1]
    full = inside.any(1)
    first = np.where(full, inside.argmax(1) - 1, width)
    last = np.where(full, width - inside[:, ::-1].argmax(1), -1)
    first = np.maximum(minimum_filter1d(first, 3, mode="nearest"), 0)
    last = np.minimum(maximum_filter1d(last, 3, mode="nearest"), width - 1)
    length = np.maximum(last - first + 1, 0)
    columns = np.arange(width)
    kept = (columns >= first[:, None]) & (columns <= last[:, None])
    return (np.cumsum(length) - length - first).astype(np.int64), kept


def _surface_depth(median: NDArray[np.float32], mean: NDArray[np.float32], mixed: float) -> NDArray[np.float32]:
    """Return the mean depth, which is smooth, where it agrees with the median; else the median, which mixes nothing."""
    return np.where(np.abs(mean - median) < mixed * median, mean, median)


def _beside_jumps(depth: NDArray[np.float32], jump: float) -> NDArray[np.bool_]:
    """Find the pixels next to a depth discontinuity, where depth is unreliable."""
    kernel = np.ones((3, 3), np.uint8)  # from corner to corner depth may change by three jumps
    spread: NDArray[np.bool_] = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > 3 * jump * depth
    return spread
