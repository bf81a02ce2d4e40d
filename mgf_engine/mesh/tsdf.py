# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface as the mean of what the rendered depths of all views say, instead of eq. 25.

Every view's depth is rendered once and moved to where its photo and its neighbours' look most alike. At a point,
each view that is not covered says how far in front of its surface the point lies, clipped to a narrow band; the sign
of the weighted mean tells solid from free. One view cannot dig a hole or leave a bubble on its own, as it can where
the minimum over views decides, and asking costs a look-up per view instead of an integral.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from mgf_engine.algorithms import parameter
from mgf_engine.mesh.depth_smoothing import SmoothingOptions, smooth_depth
from mgf_engine.mesh.hull import outside_hull
from mgf_engine.mesh.isosurface import FREE, INVALID, SOLID
from mgf_engine.mesh.photometric import Matched, MatchOptions, Surface, match_surface, without_match
from mgf_engine.mesh.prior import Prior, PriorOptions, choose_depths, combine_surfaces
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.native.library import parallel
from mgf_engine.native.parallel import parallel_map
from mgf_engine.raster.api import Camera, render
from mgf_engine.raster.camera import pose_and_intrinsics
from mgf_engine.raster.device import each_view
from mgf_engine.raster.points import INSIDE, NEAR

CPU = torch.device("cpu")
FAR = 1e6  # depth of what lies behind everything
BYTES_PER_PIXEL = 150  # of a depth map while it is matched and smoothed (measured)
CHUNK = 1 << 16  # points that are asked at a time, which bounds the memory

T = TypeVar("T")
Progress = Callable[[float], None]
_SAMPLE = [
    ("weight", "<f4"),
    ("sum", "<f4"),
    ("likeness", "<f4"),
    *((name, "<i4") for name in ("covered", "outside", "seen", "near", "judging", "behind")),
]
_VIEW = [("pose", "<f8", 12), ("intrinsics", "<f8", 4)] + [
    (name, kind)
    for names, kind in (("labels map rows height width", "<i8"), ("band least_slope", "<f8"))
    for name in names.split()
]


@dataclass(frozen=True)
class TsdfOptions:
    """Options of the fusion of depth maps."""

    band: float = parameter(
        2.0, "Half width of the band in which distances are known, at the depth of the surface", "px"
    )
    jump: float = parameter(0.01, "Difference of neighbouring depths of one surface, as a share of the depth", low=1e-6)
    mixed: float = parameter(
        0.01, "Difference of mean and median depth beyond which a pixel shows several surfaces, as a share of the depth"
    )
    min_alpha: float = parameter(0.5, "Minimum opacity of a pixel that shows a surface", high=1)
    through: float = parameter(0.2, "Opacity below which a view looks past the field", high=1)
    through_weight: float = parameter(0.25, "Weight of such a pixel, as a share of the median weight")
    unmatched: float = parameter(0.2, "Weight of a depth without a match; a matched depth weighs 1")
    least_slope: float = parameter(
        0.1, "Minimum distance along the normal per unit of depth, for surfaces seen from the side", low=1e-6
    )
    confirmed: float = parameter(
        0.5, "Distance from the views' surface beyond which the mesh is unconfirmed, as a share of the band", high=1
    )
    full_views: int = parameter(3, "Number of photos that must show a place for full confidence", low=1)
    outvoted: int = parameter(
        3,
        "Views with a surface just before a point that outvote those that see it free, per square of their number",
    )
    calibration_points: int = parameter(50, "Minimum number of sparse points that calibrate the level", low=1)


@dataclass(frozen=True)
class FusionOptions:
    """All options of depth maps and their fusion; ``smoothing`` None leaves depths as matched."""

    tsdf: TsdfOptions = TsdfOptions()
    match: MatchOptions = MatchOptions()
    prior: PriorOptions = PriorOptions()
    smoothing: SmoothingOptions | None = None


@dataclass(frozen=True)
class Photos:
    """What matching needs of the photos.

    Attributes:
        grey: number of a view -> uint8 [H, W], brightness.
        neighbours: per view the numbers of those to match it with.
    """

    grey: Callable[[int], NDArray[np.uint8]]
    neighbours: Sequence[Sequence[int]]


@dataclass(frozen=True)
class DepthMap:
    """A view's surface where its mask says INSIDE, and one pixel around: a building fills less than half of its photos.

    Attributes:
        mask: uint8 [H, W].
        rows: int64 [H]; pixel (x, y) is ``pixels[rows[y] + x]``.
        pixels: [P, 4] depth, slope (distance along the normal per unit of depth), weight, likeness.
    """

    view: View
    mask: NDArray[np.uint8]
    rows: NDArray[np.int64]
    pixels: NDArray[np.float32]


class TsdfField:
    """Signed distance of a surface, fused from the depth maps of all views.

    Args:
        show: number of a view -> the surface it shows; asked once for each while it is needed.
        masks: per view uint8 [H, W] as :func:`mgf_engine.mesh.hull.judging_mask` makes them.
        neighbours: per view the numbers of those to move its depths with to where their photos look most alike.
        options: of the matching, the smoothing and the fusion.
        device: where ``show`` draws.
        prior: number of a view -> what it shows of a surface known before, and how sure that is [H, W].
        hull: whether what several masks call background is free, whatever the depths say.
    """

    def __init__(
        self,
        show: Callable[[int], Surface],
        masks: Sequence[NDArray[np.uint8]],
        neighbours: Sequence[Sequence[int]] = (),
        options: FusionOptions = FusionOptions(),
        progress: Progress = lambda share: None,
        device: torch.device = CPU,
        prior: Callable[[int], tuple[Surface, NDArray[np.float32]]] | None = None,
        hull: bool = True,
    ) -> None:
        self.offset, self.options, self.hull = 0.0, options.tsdf, hull
        self.band = self.options.band
        near = [list(neighbours[number]) if neighbours else [] for number in range(len(masks))]
        left = np.bincount([k for number in range(len(masks)) for k in (number, *near[number])], minlength=len(masks))
        surfaces: dict[int, Surface] = {}  # only those that a view still to come is matched with
        before: dict[int, tuple[Surface, NDArray[np.float32]]] = {}  # and what they show of the prior
        first_needed = list(dict.fromkeys(k for number in range(len(masks)) for k in (number, *near[number])))
        shown = each_view(show, first_needed, device)

        def needed() -> Iterator[_Asked]:
            for number, mask in enumerate(masks):
                wanted = number, *near[number]
                for k in wanted:
                    if k not in surfaces:
                        surfaces[k] = next(shown)
                        if prior is not None:
                            before[k] = prior(k)
                            surfaces[k] = combine_surfaces(surfaces[k], *before[k], options.prior)
                yield _Asked(mask, [surfaces[k] for k in wanted], [before[k] for k in wanted if k in before])
                for k in wanted:
                    left[k] -= 1
                    if left[k] == 0:
                        del surfaces[k]
                        before.pop(k, None)

        def matched(asked: _Asked) -> DepthMap:
            surface, *others = asked.surfaces
            found = match_surface(surface, others, options.match) if others else without_match(surface)
            if asked.prior:
                (known, sure), *rest = asked.prior
                surface, found = choose_depths(
                    surface, known, sure, found, [other for other, _ in rest], options.match, options=options.prior
                )
            if options.smoothing is not None:
                found = replace(found, depth=smooth_depth(surface.depth, found, options.smoothing))
            return depth_map(surface, asked.mask, found, options.tsdf)

        self.maps: list[DepthMap] = []
        for m in parallel_map(matched, needed(), bytes_each=BYTES_PER_PIXEL * max((m.size for m in masks), default=0)):
            progress(len(self.maps) / len(masks))
            self.maps.append(m)

    def classify(self, points: NDArray[np.float64], progress: Progress = lambda share: None) -> NDArray[np.uint8]:
        """FREE, SOLID or INVALID for each point [N, 3], uint8 [N]."""

        signed = self.signed(points, progress)
        return np.where(np.isnan(signed), INVALID, np.where(signed > 0, FREE, SOLID)).astype(np.uint8)

    def signed(self, points: NDArray[np.float64], progress: Progress = lambda share: None) -> NDArray[np.float32]:
        """How far points [N, 3] lie in front of the surface, [N], as :func:`isosurface.find_level` wants it.

        In half bands between -1 and 1; plus or minus infinity where masks or the votes of views decide, NaN where no
        view knows.
        """

        def verdict(sample: NDArray[np.void]) -> NDArray[np.float32]:
            result = _distance(sample) - self.offset
            result[sample["behind"] >= self.options.outvoted * sample["judging"] ** 2] = -np.inf
            unknown = sample["weight"] == 0
            result[unknown] = np.where(sample["covered"][unknown] > 0, -np.inf, np.nan)
            if self.hull:
                result[outside_hull(sample["outside"], sample["seen"])] = np.inf
            return np.asarray(result, np.float32)

        return _joined(self._ask(points, verdict, progress), np.float32)

    def calibrate(self, points: NDArray[np.float64]) -> float:
        """Put the level where triangulated points of the surface [N, 3] lie (median); returns it, in pixels.

        Gaussians are trained to look right, and light stops on their near side: their centres, and so the rendered
        depths, tend to lie a fraction of a pixel behind the surface.
        """

        def near_level(sample: NDArray[np.void]) -> NDArray[np.float32]:
            known = (sample["weight"] > 0) & ~outside_hull(sample["outside"], sample["seen"])
            distance = _distance(sample)[known]
            return distance[np.abs(distance) < 0.9]

        near = _joined(self._ask(points, near_level), np.float32)
        self.offset = float(np.median(near)) if len(near) >= self.options.calibration_points else 0.0
        return self.offset * self.band

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """How far points [N, 3] lie in front of the surface, in half bands, -1..1, [N]; NaN where no view knows."""

        def off(sample: NDArray[np.void]) -> NDArray[np.float32]:
            return np.where(sample["weight"] > 0, _distance(sample) - self.offset, np.nan).astype(np.float32)

        return _joined(self._ask(points, off), np.float32)

    def known(self, points: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        """What the views show near points [N, 3] of a surface.

        Returns:
            ``confirmed``: whether at least one view really shows a surface there, bool [N]. ``views``: how many do,
            uint8 [N]. ``confidence``: how far to trust it, 0..1, float32 [N]: three photos that show it are worth 0.5,
            three whose patches look alike there 1; 0 is made up to close a gap.
        """

        def trust(sample: NDArray[np.void]) -> tuple[NDArray[Any], ...]:
            alike = sample["likeness"] / np.maximum(sample["near"], 1)
            enough = np.minimum(sample["near"] / self.options.full_views, 1.0)
            confidence = enough * (0.5 + 0.5 * np.clip(alike, 0, 1))
            shown = (sample["weight"] > 0) & (np.abs(_distance(sample) - self.offset) < self.options.confirmed)
            return shown, np.minimum(sample["near"], 255).astype(np.uint8), confidence.astype(np.float32)

        found = list(self._ask(points, trust))
        kinds = {"confirmed": np.bool_, "views": np.uint8, "confidence": np.float32}
        return {name: _joined((f[k] for f in found), kind) for k, (name, kind) in enumerate(kinds.items())}

    def _ask(
        self,
        points: NDArray[np.float64],
        answer: Callable[[NDArray[np.void]], T],
        progress: Progress = lambda share: None,
    ) -> Iterator[T]:
        """``answer`` to what all views tell of each point (struct TsdfSample in ``native/csrc/mesh/fuse.c``), CHUNK
        points at a time."""
        views = np.array([self._view_struct(m) for m in self.maps], _VIEW)

        def one(start: int) -> T:
            part = np.ascontiguousarray(points[start : start + CHUNK], dtype=np.float32)
            sample = np.zeros(len(part), _SAMPLE)
            parallel("mgf_integrate_depths", len(part), part, views, len(views), NEAR, self.options.jump, sample)
            return answer(sample)

        starts = range(0, len(points), CHUNK)
        for start, result in zip(starts, parallel_map(one, starts), strict=True):
            progress(min(start + CHUNK, len(points)) / len(points))
            yield result

    def _view_struct(self, m: DepthMap) -> tuple[Any, ...]:
        """A depth map as ``native/csrc/mesh/fuse.c`` takes it (struct TrustedView)."""
        arrays = m.mask.ctypes.data, m.pixels.ctypes.data, m.rows.ctypes.data
        numbers = m.view.height, m.view.width, self.band / m.view.fx, self.options.least_slope
        return (*pose_and_intrinsics(m.view), *arrays, *numbers)


@dataclass(frozen=True)
class _Asked:
    """A view's mask, what it and its neighbours show, and what they show of the prior with how sure that is."""

    mask: NDArray[np.uint8]
    surfaces: list[Surface]
    prior: list[tuple[Surface, NDArray[np.float32]]]


def _joined(chunks: Iterable[NDArray[Any]], kind: type[np.generic]) -> NDArray[Any]:
    return np.concatenate([np.zeros(0, kind), *chunks])


def _distance(sample: NDArray[np.void]) -> NDArray[np.float32]:
    """Mean signed distance in half bands, -1..1, positive in front of the surface; 0 where no view says anything."""
    distance: NDArray[np.float32] = sample["sum"] / np.maximum(sample["weight"], 1e-30)
    return distance


def fuse_gaussians(
    gaussians: Gaussians,
    views: Sequence[View],
    masks: Sequence[NDArray[np.uint8]],
    photos: Photos | None = None,
    progress: Progress = lambda share: None,
    prior: Prior | None = None,
    hull: bool = True,
    options: FusionOptions = FusionOptions(),
) -> TsdfField:
    """The field's own surface as the cameras that judge see it, normalised frame.

    Args:
        photos: where given, the depths are first moved to where the photos look most alike.
        prior: a surface known before the field, used with ``photos`` only.
        hull: as :class:`TsdfField` takes it.
        options: of the matching, the smoothing and the fusion.
    """

    def show(number: int) -> Surface:
        return render_surface(gaussians, views[number], photos.grey(number) if photos else None, options.tsdf)

    def known(number: int) -> tuple[Surface, NDArray[np.float32]]:
        assert prior is not None and photos is not None
        return prior.seen_from(views[number], photos.grey(number))

    return TsdfField(
        show, masks, photos.neighbours if photos else (), options, progress, gaussians.positions.device,
        known if prior is not None and photos is not None else None, hull,
    )  # fmt: skip


def render_surface(
    gaussians: Gaussians, view: View, grey: NDArray[np.uint8] | None = None, options: TsdfOptions = TsdfOptions()
) -> Surface:
    """What the field shows in a view, where it covers the pixel at all, with the photo's brightness beside it."""
    with torch.no_grad():
        seen = render(gaussians, Camera.from_view(view), sh_degree=0).cpu()
    assert seen.median is not None and seen.normal is not None
    alpha = seen.alpha.numpy()
    depth = _surface_depth(seen.median.numpy(), seen.depth.numpy() / np.maximum(alpha, 1e-6), options.mixed)
    normal = seen.normal.numpy() / np.maximum(np.linalg.norm(seen.normal.numpy(), axis=0), 1e-6)
    depth = np.where((alpha >= options.min_alpha) & (depth > NEAR), depth, 0.0).astype(np.float32)
    grey = np.zeros(depth.shape, np.uint8) if grey is None else grey
    return Surface(view, grey, depth, np.ascontiguousarray(normal.transpose(1, 2, 0)), alpha < options.through)


def depth_map(
    surface: Surface, mask: NDArray[np.uint8], matched: Matched, options: TsdfOptions = TsdfOptions()
) -> DepthMap:
    """A rendered surface as the fusion asks for it, with its matched depth and how far each pixel may be trusted."""
    view, normal, depth = surface.view, surface.normal, matched.depth
    trust = options.unmatched if matched.trust is None else matched.trust
    u = (np.arange(view.width) + 0.5 - view.cx) / view.fx
    v = (np.arange(view.height) + 0.5 - view.cy) / view.fy
    slope = np.clip(
        -(normal[..., 0] * u[None] + normal[..., 1] * v[:, None] + normal[..., 2]), options.least_slope, None
    )
    weight = np.clip(slope / np.sqrt(1 + u[None] ** 2 + v[:, None] ** 2), 0.1, 1.0) ** 2 / np.maximum(depth, 1e-6) ** 2
    weight *= np.where(_rim(depth, options.jump), 0.1, 1.0) * np.where(matched.likeness > 0, 1.0, trust)
    shown = depth > 0
    weight = np.where(shown, weight, 0.0)
    if shown.any():  # where the view looks past everything, all along the ray is free
        weight[surface.through] = options.through_weight * np.median(weight[shown])
    depth, slope = np.where(surface.through, FAR, depth), np.where(surface.through, 1.0, slope)
    rows, kept = _spans(mask == INSIDE)
    return DepthMap(
        view, mask, rows, np.stack([a[kept] for a in (depth, slope, weight, matched.likeness)], -1, dtype=np.float32)
    )


def _spans(inside: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """In each row the pixels from the first to the last that is inside or beside one that is.

    Returns:
        Where pixel 0 of each row would lie in a list of those pixels, int64 [H]; and which they are, bool [H, W].
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
    """The mean depth, which is smooth, where it tells of the same surface as the median, which never mixes two."""
    return np.where(np.abs(mean - median) < mixed * median, mean, median)


def _rim(depth: NDArray[np.float32], jump: float) -> NDArray[np.bool_]:
    """Pixels next to a jump in depth, where the surface seen is uncertain."""
    kernel = np.ones((3, 3), np.uint8)
    spread: NDArray[np.bool_] = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > 3 * jump * depth
    return spread
