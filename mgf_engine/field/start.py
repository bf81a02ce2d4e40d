# SPDX-License-Identifier: GPL-3.0-or-later
"""Place the first Gaussians: on the starting surface, on dense points by stereo, or on sparse points alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.errors import BadInput
from mgf_engine.field.dense import DensePointOptions, dense_points
from mgf_engine.field.initialise import InitialisationOptions, initial_field
from mgf_engine.geometry.block_store import clear_blocks
from mgf_engine.geometry.morton import along_curve
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import Config, job_option
from mgf_engine.start.options import start_options
from mgf_engine.start.samples import SampleOptions, Samples, sample_surface
from mgf_engine.start.store import FILE, write_start
from mgf_engine.start.surface import StartSurface, start_surface


@dataclass(frozen=True)
class StartPointOptions:
    """Options of the points that Gaussians start from."""

    share: float = parameter(0.5, "Share of max_gaussians that may be starting points", high=1)
    spacing: float = parameter(2.0, "Minimum distance of samples on the starting surface", "px", low=0.1)
    offset: float = parameter(
        4.0, "Distance from the starting surface beyond which a point by stereo is a starting point of its own", "px"
    )
    max_gaussians: int = job_option("max_gaussians")
    masked_points: bool = job_option("masked_points")
    seed: int = job_option("seed")
    samples: SampleOptions = SampleOptions()

    @property
    def limit(self) -> int:
        """Maximum number of points on a surface."""
        return int(self.share * self.max_gaussians)


class _Points(NamedTuple):
    """Points [N, 3], colours uint8 [N, 3], a camera centre that sees each [N, 3], normals [N, 3], NaN where unknown."""

    points: NDArray[np.float64]
    colors: NDArray[np.uint8]
    towards: NDArray[np.float64]
    normals: NDArray[np.float64]


def start_field(
    scene: Scene, masks: MaskSet, views: list[int], config: Config, folder: Path, reporter: Reporter
) -> Gaussians:
    """Make the first Gaussians, as the option ``start`` says.

    Args:
        scene: photos, cameras and sparse points.
        masks: the building in each photo.
        views: indices of the training views.
        config: of the job.
        folder: where the starting surface is left for the mesh stage.
        reporter: for warnings and the request to cancel.

    Raises:
        BadInput: too few points lie on the building.
        Cancelled: the user asked to stop.
    """
    parts = []
    options = config.algorithm(StartPointOptions)
    (folder / FILE).unlink(missing_ok=True)
    if config.start == "surface" and config.use_masks:
        try:
            share = 1.0 if config.passes == config.iterations == 0 else 0.0  # without training it is the whole stage
            surface = start_surface(scene, masks, views, reporter, config.threads, start_options(config), share=share)
            write_start(surface, folder / FILE)
            clear_blocks()
            parts = _on_surface(surface, scene, views, options)
            reporter.check()
        except BadInput as error:
            reporter.warning(f"No starting surface could be made; training starts from points. {error}")
    if not parts:
        parts = [_sparse(scene, masks, options)]
        if config.start != "sparse":
            dense = config.algorithm(DensePointOptions)
            points, colors, towards = dense_points(scene, masks, views, options.limit, reporter, config.threads, dense)
            parts.append(_Points(points, colors, towards, np.full(points.shape, np.nan)))
    points, colors, towards, normals = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = along_curve(points)  # what one tile shows lies close together in memory
    return initial_field(
        points[order], colors[order], towards[order], normals[order], config.algorithm(InitialisationOptions)
    )


def _on_surface(surface: StartSurface, scene: Scene, views: list[int], options: StartPointOptions) -> list[_Points]:
    """Sample the starting surface, and add the points by stereo that lie beside it.

    Args:
        surface: to sample.
        scene: photos and cameras.
        views: the photos that show what is sampled.
        options: number and distance of the points.

    Raises:
        BadInput: no photo shows the surface.
    """
    spacing, limit = options.spacing * surface.pixel, options.limit
    samples = sample_surface(surface.mesh, scene, views, limit, spacing, options.seed, options.samples)
    if len(samples.points) < 4:
        raise BadInput("No photo shows the surface that edges and planes make.")
    found = [_Points(samples.points, samples.colors, samples.points + samples.normals, samples.normals)]
    if len(surface.dense):
        beside = _beside_samples(surface, samples, options.offset)[: max(0, limit - len(samples.points))]
        found.append(_stereo_points(surface, scene, beside))
    return found


def _beside_samples(surface: StartSurface, samples: Samples, offset: float) -> NDArray[np.int64]:
    """Find the surface's points by stereo that lie more than ``offset`` px from it; returns their numbers."""
    away, nearest = cKDTree(samples.points).query(surface.dense)
    off = np.abs(((surface.dense - samples.points[nearest]) * samples.normals[nearest]).sum(1))
    reach = offset * surface.pixel
    return np.flatnonzero((off > reach) | (away > 2 * max(samples.spacing, reach)))


def _stereo_points(surface: StartSurface, scene: Scene, rows: NDArray[np.int64]) -> _Points:
    """Return points by stereo of a surface, by their numbers [N], with the colours of photos that saw them."""
    seen, points = surface.seen[rows], surface.dense[rows]
    centres = np.stack([view.centre for view in scene.views])
    colors = np.zeros((len(points), 3), np.uint8)
    for i in np.unique(seen):
        mine, view = np.flatnonzero(seen == i), scene.views[i]
        colors[mine] = scene.photo(i)[pixel_at((view.height, view.width), view.project(points[mine])[0])]
    return _Points(points, colors, centres[seen], np.full(points.shape, np.nan))


def _sparse(scene: Scene, masks: MaskSet, options: StartPointOptions) -> _Points:
    """Choose the masked points P', or all points (ablation b), at most as many as there may be Gaussians."""
    index = np.flatnonzero(masks.point_mask if options.masked_points else np.ones(len(scene.points), bool))
    if len(index) > options.max_gaussians:
        generator = np.random.default_rng(options.seed)
        index = np.sort(generator.choice(index, options.max_gaussians, replace=False))
    centres = np.stack([view.centre for view in scene.views])
    first = np.minimum(scene.track_start[index], max(len(scene.track_view) - 1, 0))
    towards = centres[scene.track_view[first]] if len(index) else np.zeros((0, 3))
    return _Points(scene.points[index], scene.colors[index], towards, np.full((len(index), 3), np.nan))
