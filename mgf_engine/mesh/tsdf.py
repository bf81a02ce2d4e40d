# SPDX-License-Identifier: GPL-3.0-or-later
"""Fuse the depth maps of all views into a truncated signed distance (TSDF, Curless and Levoy 1996), instead of eq. 25.

The depth map of each view is rendered once and refined by patch matching. The signed distance of a point is the
weighted mean over all views that do not see it occluded, truncated to a narrow band. A single wrong view cannot make a
hole or a bubble, as it can with the minimum over views of eq. 25; and a point costs a look-up per view instead of an
integral.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.spill import Spill
from mgf_engine.mesh.depth_maps import DepthMap, Progress, ViewSurfaces, make_depth_maps, render_surface
from mgf_engine.mesh.fusion_options import FusionOptions, TsdfOptions
from mgf_engine.mesh.hull import outside_hull
from mgf_engine.mesh.isosurface import FREE, INVALID, SOLID
from mgf_engine.mesh.photometric import RenderedSurface
from mgf_engine.mesh.prior import Prior, RenderedPrior
from mgf_engine.mesh.trusted_views import Photos
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.scene import View
from mgf_engine.native.buffers import release_buffers
from mgf_engine.native.library import parallel
from mgf_engine.native.parallel import parallel_map
from mgf_engine.raster.camera import pose_and_intrinsics
from mgf_engine.raster.points import NEAR

CHUNK = 1 << 16  # number of points that are sampled at a time, which limits the memory

T = TypeVar("T")
_SAMPLE = [
    ("weight", "<f4"),
    ("sum", "<f4"),
    ("correlation", "<f4"),
    *((name, "<i4") for name in ("covered", "outside", "seen", "near", "fused", "behind")),
]
_VIEW = [("pose", "<f8", 12), ("intrinsics", "<f8", 4)] + [
    (name, kind)
    for names, kind in (("labels map rows height width", "<i8"), ("band least_slope", "<f8"))
    for name in names.split()
]


class TsdfField:
    """Truncated signed distance of a surface, fused from the depth maps of all views.

    Args:
        maps: from :func:`mgf_engine.mesh.depth_maps.make_depth_maps`.
        options: of the fusion and of the visual hull, outside of which all is free.
        spill: stores the pixels of the maps on disk; None if they are in memory.
    """

    def __init__(self, maps: list[DepthMap], options: TsdfOptions = TsdfOptions(), spill: Spill | None = None) -> None:
        self.maps, self.options, self.spill = maps, options, spill
        self.offset, self.band = 0.0, options.band

    def classify(self, points: NDArray[np.float64], progress: Progress = lambda share: None) -> NDArray[np.uint8]:
        """Classify points [N, 3] as FREE, SOLID or INVALID (no view sees them), uint8 [N]."""
        signed = self.signed(points, progress)
        return np.where(np.isnan(signed), INVALID, np.where(signed > 0, FREE, SOLID)).astype(np.uint8)

    def signed(self, points: NDArray[np.float64], progress: Progress = lambda share: None) -> NDArray[np.float32]:
        """Compute the signed distance of points [N, 3] for :func:`mgf_engine.mesh.isosurface.find_level`, float32 [N].

        Positive in front of the surface, in half bands between -1 and 1; plus or minus infinity where the visual hull
        or the votes of views decide; NaN where no view sees the point.
        """

        def signed_of(sample: NDArray[np.void]) -> NDArray[np.float32]:
            result = _distance(sample) - self.offset
            result[sample["behind"] >= self.options.outvoted * sample["fused"] ** 2] = -np.inf
            unknown = sample["weight"] == 0
            result[unknown] = np.where(sample["covered"][unknown] > 0, -np.inf, np.nan)
            if self.options.hull.carve:
                result[outside_hull(sample["outside"], sample["seen"], self.options.hull)] = np.inf
            return np.asarray(result, np.float32)

        return _concatenate(self._sample(points, signed_of, progress), np.float32)

    def calibrate(self, points: NDArray[np.float64]) -> float:
        """Set the level to the median distance of triangulated surface points [N, 3]; return it, in pixels.

        Rendered depths tend to lie a fraction of a pixel behind the surface, since the near side of a Gaussian hides
        its centre.
        """

        def near_level(sample: NDArray[np.void]) -> NDArray[np.float32]:
            known = (sample["weight"] > 0) & ~outside_hull(sample["outside"], sample["seen"], self.options.hull)
            distance = _distance(sample)[known]
            return distance[np.abs(distance) < 0.9]

        near = _concatenate(self._sample(points, near_level), np.float32)
        self.offset = float(np.median(near)) if len(near) >= self.options.calibration_points else 0.0
        return self.offset * self.band

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Compute the signed distance of points [N, 3], -1..1 in half bands, positive in front, float32 [N].

        NaN where no view sees the point. Unlike :meth:`signed`, without visual hull and votes.
        """

        def off(sample: NDArray[np.void]) -> NDArray[np.float32]:
            return np.where(sample["weight"] > 0, _distance(sample) - self.offset, np.nan).astype(np.float32)

        return _concatenate(self._sample(points, off), np.float32)

    def observations(self, points: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        """Count the views that show a surface at points [N, 3], and rate its confidence.

        Returns:
            ``confirmed``: whether a view shows a surface there, bool [N]. ``views``: number of such views, uint8 [N].
            ``confidence``: 0..1, float32 [N]; 0.5 if three photos show it, 1 if their patches also correlate, 0 if
            none does (the surface only closes a gap).
        """

        def rate(sample: NDArray[np.void]) -> tuple[NDArray[Any], ...]:
            alike = sample["correlation"] / np.maximum(sample["near"], 1)
            enough = np.minimum(sample["near"] / self.options.full_views, 1.0)
            confidence = enough * (0.5 + 0.5 * np.clip(alike, 0, 1))
            shown = (sample["weight"] > 0) & (np.abs(_distance(sample) - self.offset) < self.options.confirmed)
            return shown, np.minimum(sample["near"], 255).astype(np.uint8), confidence.astype(np.float32)

        found = list(self._sample(points, rate))
        kinds = {"confirmed": np.bool_, "views": np.uint8, "confidence": np.float32}
        return {name: _concatenate((f[k] for f in found), kind) for k, (name, kind) in enumerate(kinds.items())}

    def _sample(
        self,
        points: NDArray[np.float64],
        evaluate: Callable[[NDArray[np.void]], T],
        progress: Progress = lambda share: None,
    ) -> Iterator[T]:
        """Integrate all views at points [N, 3], and yield ``evaluate(samples)`` for each CHUNK of points.

        Samples are struct TsdfSample of ``native/csrc/mesh/tsdf.c``.
        """
        views = np.array([self._view_struct(m) for m in self.maps], _VIEW)

        def one(start: int) -> T:
            part = np.ascontiguousarray(points[start : start + CHUNK], dtype=np.float32)
            sample = np.zeros(len(part), _SAMPLE)
            parallel("mgf_integrate_depths", len(part), part, views, len(views), NEAR, self.options.jump, sample)
            return evaluate(sample)

        starts = range(0, len(points), CHUNK)
        for start, result in zip(starts, parallel_map(one, starts), strict=True):
            progress(min(start + CHUNK, len(points)) / len(points))
            if self.spill is not None:
                self.spill.release()
            yield result

    def _view_struct(self, m: DepthMap) -> tuple[Any, ...]:
        """Return a depth map as struct TrustedView of ``native/csrc/mesh/tsdf.c``."""
        arrays = m.mask.ctypes.data, m.pixels.ctypes.data, m.rows.ctypes.data
        numbers = m.view.height, m.view.width, self.band / m.view.fx, self.options.least_slope
        return (*pose_and_intrinsics(m.view), *arrays, *numbers)


def _concatenate(chunks: Iterable[NDArray[Any]], kind: type[np.generic]) -> NDArray[Any]:
    return np.concatenate([np.zeros(0, kind), *chunks])


def _distance(sample: NDArray[np.void]) -> NDArray[np.float32]:
    """Return the mean signed distance, -1..1 in half bands, positive in front of the surface; 0 without a depth."""
    distance: NDArray[np.float32] = sample["sum"] / np.maximum(sample["weight"], 1e-30)
    return distance


def fuse_gaussians(
    gaussians: Gaussians,
    views: Sequence[View],
    masks: Sequence[NDArray[np.uint8]],
    photos: Photos | None = None,
    progress: Progress = lambda share: None,
    prior: Prior | None = None,
    options: FusionOptions = FusionOptions(),
) -> TsdfField:
    """Render the depth maps of a field, match and smooth them, and fuse them into a signed distance.

    Args:
        gaussians: the field, normalised frame.
        views: cameras of the trusted photos.
        masks: for each view uint8 [H, W] from :func:`mgf_engine.mesh.hull.silhouette_mask`.
        photos: photos and neighbours for patch matching; None for no matching.
        progress: called with the share that is done.
        prior: the starting surface, used with ``photos`` only.
        options: of the matching, the smoothing and the fusion.
    """

    def show(number: int) -> RenderedSurface:
        return render_surface(gaussians, views[number], photos.grey(number) if photos else None, options.tsdf)

    def known(number: int) -> RenderedPrior:
        assert prior is not None and photos is not None
        return prior.seen_from(views[number], photos.grey(number))

    spill = Spill()
    shown = ViewSurfaces(show, gaussians.positions.device, known if prior is not None and photos is not None else None)
    maps = make_depth_maps(shown, masks, photos.neighbours if photos else (), options, progress, spill)
    release_buffers()  # nothing is rendered from here on
    return TsdfField(maps, options.tsdf, spill)
