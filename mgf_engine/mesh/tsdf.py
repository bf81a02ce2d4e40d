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

from mgf_engine.mesh.depth_smoothing import SmoothingOptions, smooth_depth
from mgf_engine.mesh.hull import outside_hull
from mgf_engine.mesh.isosurface import FREE, INVALID, SOLID
from mgf_engine.mesh.photometric import WIDE, Matched, Search, Surface, match_surface, unmatched
from mgf_engine.mesh.prior import Prior, decided, joined
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.native.library import parallel
from mgf_engine.native.parallel import parallel_map
from mgf_engine.raster.api import Camera, render
from mgf_engine.raster.camera import pose_and_intrinsics
from mgf_engine.raster.device import each_view
from mgf_engine.raster.points import INSIDE, NEAR

BAND_PIXELS = 2.0  # half width of the band, in pixels at the depth of the surface
JUMP = 0.01  # share of the depth that neighbouring pixels of one surface differ at most
MIXED = 0.01  # mean and median depth that differ by a larger share belong to several surfaces
MIN_ALPHA = 0.5  # pixels that the field covers less show no surface,
THROUGH, THROUGH_WEIGHT = 0.2, 0.25  # and less than this let the view through, with this share of the usual weight
CPU = torch.device("cpu")
FAR = 1e6  # depth of what lies behind everything
UNMATCHED = 0.2  # weight of a depth that only the field vouches for, beside one that photos agree on
LEAST_SLOPE = 0.1  # distance along the normal per unit of depth, of surfaces that a view sees from the side

CONFIRMED = 0.5  # of the band: a surface of the mesh further from what the views show is made up
ENOUGH_VIEWS = 3  # photos that must show a spot for full confidence
OUTVOTED = 3  # times the square of the views that call a point free: as many that cover it closely outvote them
CHUNK = 1 << 16  # points that are asked at a time, which bounds the memory
ENOUGH = 50  # triangulated points from which the level is calibrated

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
class Photos:
    """What matching needs of the photos.

    Attributes:
        grey: number of a view -> uint8 [H, W], brightness.
        neighbours: per view the numbers of those to match it with.
        smoothing: of the matched depths, as :class:`TsdfField` takes it.
    """

    grey: Callable[[int], NDArray[np.uint8]]
    neighbours: Sequence[Sequence[int]]
    smoothing: float = 0.0


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
        search: how far, and in which steps.
        band: half width of the band in which distances are known, in pixels.
        device: where ``show`` draws.
        prior: number of a view -> what it shows of a surface known before, and how sure that is [H, W].
        hull: whether what several masks call background is free, whatever the depths say.
        smoothing: weight of the depths' second differences (:class:`SmoothingOptions`); 0 leaves them as matched.
    """

    def __init__(
        self,
        show: Callable[[int], Surface],
        masks: Sequence[NDArray[np.uint8]],
        neighbours: Sequence[Sequence[int]] = (),
        search: Search = WIDE,
        band: float = BAND_PIXELS,
        progress: Progress = lambda share: None,
        device: torch.device = CPU,
        prior: Callable[[int], tuple[Surface, NDArray[np.float32]]] | None = None,
        hull: bool = True,
        smoothing: float = 0.0,
    ) -> None:
        self.offset, self.band, self.hull = 0.0, band, hull
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
                            surfaces[k] = joined(surfaces[k], *before[k])
                yield _Asked(mask, [surfaces[k] for k in wanted], [before[k] for k in wanted if k in before])
                for k in wanted:
                    left[k] -= 1
                    if left[k] == 0:
                        del surfaces[k]
                        before.pop(k, None)

        def matched(asked: _Asked) -> DepthMap:
            surface, *others = asked.surfaces
            found = match_surface(surface, others, search) if others else unmatched(surface)
            if asked.prior:
                (known, sure), *rest = asked.prior
                surface, found = decided(surface, known, sure, found, [other for other, _ in rest], search)
            if smoothing > 0:
                depth = smooth_depth(surface.depth, found, SmoothingOptions(strength=smoothing))
                found = replace(found, depth=depth)
            return depth_map(surface, asked.mask, found)

        self.maps: list[DepthMap] = []
        for m in parallel_map(matched, needed()):
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
            result[sample["behind"] >= OUTVOTED * sample["judging"] ** 2] = -np.inf
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
        self.offset = float(np.median(near)) if len(near) >= ENOUGH else 0.0
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
            enough = np.minimum(sample["near"] / ENOUGH_VIEWS, 1.0)
            confidence = enough * (0.5 + 0.5 * np.clip(alike, 0, 1))
            shown = (sample["weight"] > 0) & (np.abs(_distance(sample) - self.offset) < CONFIRMED)
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
            parallel("mgf_integrate_depths", len(part), part, views, len(views), NEAR, JUMP, sample)
            return answer(sample)

        starts = range(0, len(points), CHUNK)
        for start, result in zip(starts, parallel_map(one, starts), strict=True):
            progress(min(start + CHUNK, len(points)) / len(points))
            yield result

    def _view_struct(self, m: DepthMap) -> tuple[Any, ...]:
        """A depth map as ``native/csrc/mesh/fuse.c`` takes it (struct TrustedView)."""
        arrays = m.mask.ctypes.data, m.pixels.ctypes.data, m.rows.ctypes.data
        return (*pose_and_intrinsics(m.view), *arrays, m.view.height, m.view.width, self.band / m.view.fx, LEAST_SLOPE)


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
) -> TsdfField:
    """The field's own surface as the cameras that judge see it, normalised frame.

    Args:
        photos: where given, the depths are first moved to where the photos look most alike.
        prior: a surface known before the field, used with ``photos`` only.
        hull: as :class:`TsdfField` takes it.
    """

    def show(number: int) -> Surface:
        return render_surface(gaussians, views[number], photos.grey(number) if photos else None)

    def known(number: int) -> tuple[Surface, NDArray[np.float32]]:
        assert prior is not None and photos is not None
        return prior.seen_from(views[number], photos.grey(number))

    return TsdfField(
        show, masks, photos.neighbours if photos else (), progress=progress, device=gaussians.positions.device,
        prior=known if prior is not None and photos is not None else None, hull=hull,
        smoothing=photos.smoothing if photos else 0.0,
    )  # fmt: skip


def render_surface(gaussians: Gaussians, view: View, grey: NDArray[np.uint8] | None = None) -> Surface:
    """What the field shows in a view, where it covers the pixel at all, with the photo's brightness beside it."""
    with torch.no_grad():
        seen = render(gaussians, Camera.from_view(view), sh_degree=0).cpu()
    assert seen.median is not None and seen.normal is not None
    alpha = seen.alpha.numpy()
    depth = _surface_depth(seen.median.numpy(), seen.depth.numpy() / np.maximum(alpha, 1e-6))
    normal = seen.normal.numpy() / np.maximum(np.linalg.norm(seen.normal.numpy(), axis=0), 1e-6)
    depth = np.where((alpha >= MIN_ALPHA) & (depth > NEAR), depth, 0.0).astype(np.float32)
    grey = np.zeros(depth.shape, np.uint8) if grey is None else grey
    return Surface(view, grey, depth, np.ascontiguousarray(normal.transpose(1, 2, 0)), alpha < THROUGH)


def depth_map(surface: Surface, mask: NDArray[np.uint8], matched: Matched) -> DepthMap:
    """A rendered surface as the fusion asks for it, with its matched depth and how far each pixel may be trusted."""
    view, normal, depth = surface.view, surface.normal, matched.depth
    trust = UNMATCHED if matched.trust is None else matched.trust
    u = (np.arange(view.width) + 0.5 - view.cx) / view.fx
    v = (np.arange(view.height) + 0.5 - view.cy) / view.fy
    slope = np.clip(-(normal[..., 0] * u[None] + normal[..., 1] * v[:, None] + normal[..., 2]), LEAST_SLOPE, None)
    weight = np.clip(slope / np.sqrt(1 + u[None] ** 2 + v[:, None] ** 2), 0.1, 1.0) ** 2 / np.maximum(depth, 1e-6) ** 2
    weight *= np.where(_rim(depth), 0.1, 1.0) * np.where(matched.likeness > 0, 1.0, trust)
    shown = depth > 0
    weight = np.where(shown, weight, 0.0)
    if shown.any():  # where the view looks past everything, all along the ray is free
        weight[surface.through] = THROUGH_WEIGHT * np.median(weight[shown])
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


def _surface_depth(median: NDArray[np.float32], mean: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean depth, which is smooth, where it tells of the same surface as the median, which never mixes two."""
    return np.where(np.abs(mean - median) < MIXED * median, mean, median)


def _rim(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels next to a jump in depth, where the surface seen is uncertain."""
    kernel = np.ones((3, 3), np.uint8)
    spread: NDArray[np.bool_] = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > 3 * JUMP * depth
    return spread
