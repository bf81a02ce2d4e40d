# SPDX-License-Identifier: GPL-3.0-or-later
"""Extract the raw surface from the screened Gaussians: points, tetrahedra, field, and the level set between them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry import clean
from mgf_engine.mesh.ground_pixels import nearest_pixels
from mgf_engine.mesh.level_set import Reporting, extract_level_set
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.planar_clustering import merge_flat
from mgf_engine.mesh.prior import Prior
from mgf_engine.mesh.surface_field import SurfaceField, calibrate_level, select_near_box, surface_field
from mgf_engine.mesh.tetra_blocks import TetraBlocks, divide_into_blocks, tetrahedra_in_background
from mgf_engine.mesh.tetrahedra import TetraPoints, add_surface_points, tetra_points
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.crop import CropBox
from mgf_engine.start.surface import StartSurface
from mgf_engine.system.machine import release_memory
from mgf_engine.system.timing import PartTimes

#: Progress of the stage (0..1) before the tetrahedra and after the raw surface.
_TETRAHEDRA, RAW_SURFACE_DONE = 0.22, 0.5


@dataclass(frozen=True)
class SurfaceInputs:
    """Inputs of the raw surface besides the Gaussians.

    Attributes:
        scene: photos, cameras and sparse points.
        masks: label maps of the photos.
        trusted: the photos whose masks are used.
        start: the starting surface; None if it is not used.
        box: crop box; None for no limit.
    """

    scene: Scene
    masks: MaskSet
    trusted: TrustedViews
    start: StartSurface | None
    box: CropBox | None


def raw_surface(
    kept: Gaussians, inputs: SurfaceInputs, options: ExtractionOptions, reporter: Reporter, times: PartTimes
) -> tuple[Mesh, SurfaceField]:
    """Extract the level set; points and tetrahedra, the largest arrays of the stage, are freed on return.

    Args:
        kept: the screened Gaussians.
        inputs: photos, masks, starting surface and crop box.
        options: of the extraction.
        reporter: for progress, warnings and the request to cancel.
        times: records the time of each step.

    Returns:
        The level set, and the field that it was extracted from.
    """
    with timed_part(times, "points"):
        blocks = divide_into_blocks(span_points(kept, inputs.box, inputs.start, options), options.blocks)
    prior = None if inputs.start is None else Prior(inputs.start.mesh, inputs.start.confidence)
    with tetrahedra_in_background(blocks) as made:
        with timed_part(times, "depth maps"):
            field = surface_field(kept, inputs.trusted, options, reporter, prior)
            calibrate_level(field, inputs.scene, inputs.masks, options)
        mesh = extract_level_set(
            blocks, lambda number: made(number, reporter.check), field, options.level_steps,
            _reporting(blocks, reporter, times), lambda part: _merge_flat(part, blocks, inputs.trusted.views, options),
        )  # fmt: skip
    if options.blocks > 1 and options.merge_flat:
        mesh = _merge_seams(clean.weld(mesh), blocks, inputs.trusted.views, options)
    return mesh, field


def _merge_flat(mesh: Mesh, blocks: TetraBlocks, views: Sequence[View], options: ExtractionOptions) -> Mesh:
    """Merge vertices in flat areas of a block's mesh, if ``merge_flat`` is on; keep those that other blocks share."""
    return merge_flat(mesh, views, options.clustering, blocks.on_border) if options.merge_flat else mesh


def _merge_seams(mesh: Mesh, blocks: TetraBlocks, views: Sequence[View], options: ExtractionOptions) -> Mesh:
    """Merge vertices in flat areas along the borders of the blocks; a second round elsewhere would coarsen the mesh."""
    if len(blocks.members) < 2:  # all points are in one block
        return merge_flat(mesh, views, options.clustering)
    reach = max(options.clustering.cells)

    def away(points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return ~blocks.near_border(points, reach * nearest_pixels(points, views))

    return merge_flat(mesh, views, options.clustering, away)


@contextlib.contextmanager
def timed_part(times: PartTimes, name: str) -> Iterator[None]:
    """Record the time of the body of a ``with`` statement as a part of the stage, and release memory after it."""
    with times.part(name):
        yield
        release_memory()


def span_points(
    gaussians: Gaussians, box: CropBox | None, start: StartSurface | None, options: ExtractionOptions
) -> TetraPoints:
    """Make the points of the tetrahedra from the Gaussians in and near the crop box and from the starting surface.

    Args:
        gaussians: the screened Gaussians.
        box: crop box; None for no limit.
        start: the starting surface; None if it is not used.
        options: of the tetrahedra, and the margin around the box.
    """
    near = gaussians if box is None else select_near_box(gaussians, box, options.beside_box)
    sites = tetra_points(near, options.tetrahedra)
    if start is None:
        return sites
    return add_surface_points(sites, start.mesh, start.pixel, box, options.beside_box, options.tetrahedra)


def _reporting(blocks: TetraBlocks, reporter: Reporter, times: PartTimes) -> Reporting:
    """Make the callbacks that report progress and the current block of the level set extraction."""
    count = len(blocks.members)

    def began(number: int) -> None:
        reporter.progress(_TETRAHEDRA, points=len(blocks.members[number]), block=f"{number + 1} of {count}")

    return Reporting(
        lambda share: reporter.progress(_TETRAHEDRA + (RAW_SURFACE_DONE - _TETRAHEDRA) * share), began, times
    )
