# SPDX-License-Identifier: GPL-3.0-or-later
"""Extract the raw surface: the level set, from points by tetrahedra and field, that further steps clean and refine."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry import clean
from mgf_engine.mesh.level_set import Reporting, extract_level_set
from mgf_engine.mesh.opacity import OpacityField
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.planar_clustering import merge_flat, nearest_pixels
from mgf_engine.mesh.prior import Prior
from mgf_engine.mesh.surface_field import calibrate_level, select_near_box, surface_field
from mgf_engine.mesh.tetra_blocks import TetraBlocks, divide, tetrahedra_begun
from mgf_engine.mesh.tetrahedra import TetraPoints, beside_surface, tetra_points
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.mesh.tsdf import TsdfField
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.crop import CropBox
from mgf_engine.start.surface import StartSurface
from mgf_engine.system import release_memory
from mgf_engine.timing import PartTimes

#: Shares of the stage, for the progress bar, when the tetrahedra begin and when the raw surface is done.
_TETRAHEDRA, RAW_SURFACE_DONE = 0.22, 0.5


@dataclass(frozen=True)
class SurfaceInputs:
    """What the raw surface is made from beside the field: ``start`` is the starting surface where it counts."""

    scene: Scene
    masks: MaskSet
    trusted: TrustedViews
    start: StartSurface | None
    box: CropBox | None


def raw_surface(
    kept: Gaussians, given: SurfaceInputs, options: ExtractionOptions, reporter: Reporter, times: PartTimes
) -> tuple[Mesh, OpacityField | TsdfField]:
    """Extract the level set, and the field that it is of; points and tetrahedra, the largest arrays, are gone then.

    Args:
        kept: the screened field.
        given: photos, masks and what is known of the surface.
        options: of the extraction.
        reporter: for progress, warnings and the request to cancel.
        times: records the time of each step.
    """
    with timed_part(times, "points"):
        blocks = divide(span_points(kept, given.box, given.start, options), options.blocks)
    prior = None if given.start is None else Prior(given.start.mesh, given.start.sure)
    with tetrahedra_begun(blocks) as made:
        with timed_part(times, "depth maps"):
            field = surface_field(kept, given.trusted, options, reporter, prior)
            calibrate_level(field, given.scene, given.masks, options)
        mesh = extract_level_set(
            blocks, lambda number: made(number, reporter.check), field, options.level_steps,
            _reporting(blocks, reporter, times), lambda part: _thin_flat(part, blocks, given.trusted.views, options),
        )  # fmt: skip
    if options.blocks > 1 and options.merge_flat:
        mesh = _thin_seams(clean.weld(mesh), blocks, given.trusted.views, options)
    return mesh, field


def _thin_flat(mesh: Mesh, blocks: TetraBlocks, views: Sequence[View], options: ExtractionOptions) -> Mesh:
    """Merge the vertices of a block's mesh in flat areas, where that is wanted; those that others share stay."""
    return merge_flat(mesh, views, options.clustering, blocks.on_border) if options.merge_flat else mesh


def _thin_seams(mesh: Mesh, blocks: TetraBlocks, views: Sequence[View], options: ExtractionOptions) -> Mesh:
    """Merge the vertices of the joined mesh on the borders; a second round for all others would coarsen them."""
    if len(blocks.members) < 2:  # all points are in one block
        return merge_flat(mesh, views, options.clustering)
    reach = max(options.clustering.cells)

    def away(points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return ~blocks.near_border(points, reach * nearest_pixels(points, views))

    return merge_flat(mesh, views, options.clustering, away)


@contextlib.contextmanager
def timed_part(times: PartTimes, name: str) -> Iterator[None]:
    """Time the body of a ``with`` statement as a part of the stage, and release memory after it."""
    with times.part(name):
        yield
        release_memory()


def span_points(
    gaussians: Gaussians, box: CropBox | None, start: StartSurface | None, options: ExtractionOptions
) -> TetraPoints:
    """Span the points of the tetrahedra by Gaussians, in and near the crop box, and beside the starting surface.

    Args:
        gaussians: the screened field.
        box: crop box; None for no limit.
        start: the starting surface where it counts.
        options: of the tetrahedra, and how far around the box Gaussians count.
    """
    near = gaussians if box is None else select_near_box(gaussians, box, options.beside_box)
    spanned = tetra_points(near, options.tetrahedra)
    return spanned if start is None else beside_surface(spanned, start.mesh, start.pixel, box, options.tetrahedra)


def _reporting(blocks: TetraBlocks, reporter: Reporter, times: PartTimes) -> Reporting:
    """Have the extraction of the level set report which block it is at, and its share of the stage."""
    count = len(blocks.members)

    def began(number: int) -> None:
        reporter.progress(_TETRAHEDRA, points=len(blocks.members[number]), block=f"{number + 1} of {count}")

    return Reporting(
        lambda share: reporter.progress(_TETRAHEDRA + (RAW_SURFACE_DONE - _TETRAHEDRA) * share), began, times
    )
