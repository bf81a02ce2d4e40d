# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruct the starting surface of a building from photos, cameras and masks: evidence, then a minimum cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene
from mgf_engine.start.block_cuts import cut_in_blocks
from mgf_engine.start.dense import find_stereo_points
from mgf_engine.start.evidence import gather_evidence
from mgf_engine.start.lines import find_lines
from mgf_engine.start.options import StartOptions
from mgf_engine.start.planes import fit_planes_to_lines
from mgf_engine.start.segments import find_segments
from mgf_engine.start.views import start_views
from mgf_engine.system.machine import cores, release_memory
from mgf_engine.system.timing import PartTimes

#: Parts of the work, in order, as progress messages name them.
PARTS = ("views", "dense", "lines", "planes", "cut")


@dataclass(frozen=True)
class StartSurface:
    """A closed surface in the normalised frame; surfaces of several blocks have hairline gaps between the blocks.

    Attributes:
        mesh: its triangles, outward; colours are 0.
        confidence: strength of the plane that each face lies on, 0..1, 0 for faces on none, float32 [F].
        dense: points by stereo, some beside the surface, [N, 3].
        seen: a view (of the scene) that saw each of these points, [N].
        pixel: size of a pixel at the building.
        planes: through edges in the photos, strongest first: unit normals, either side, and offsets with ``normal @ x +
            offset = 0``, [K, 4].
    """

    mesh: Mesh
    confidence: NDArray[np.float32]
    dense: NDArray[np.float64]
    seen: NDArray[np.int64]
    pixel: float
    planes: NDArray[np.float64]


def start_surface(
    scene: Scene,
    masks: MaskSet,
    indices: Sequence[int],
    reporter: Reporter,
    threads: int = 0,
    options: StartOptions = StartOptions(),  # frozen
    times: PartTimes | None = None,
    share: float = 0.0,
) -> StartSurface:
    """Reconstruct the starting surface of a building.

    Args:
        scene: photos, cameras and sparse points.
        masks: the building in each photo.
        indices: the views to use.
        reporter: asked whether to stop.
        threads: number of worker threads; 0 uses all cores.
        options: of all steps.
        times: records the duration of each part.
        share: of this work in its stage, for the progress bar; the current part is reported in any case.

    Raises:
        BadInput: too few edges and points for a surface, or masks without a place in common.
        Cancelled: the user asked to stop.
    """
    threads, times = threads or cores(), times or PartTimes()

    def begin(part: str) -> None:
        reporter.progress(share * PARTS.index(part) / len(PARTS), start=part)  # which asks whether to stop
        release_memory()  # what a step needed no longer

    begin("views")
    with times.part("views"):
        views = start_views(scene, masks, indices, options.views)
    begin("dense")
    with times.part("dense"):
        dense = find_stereo_points(views, masks, options.dense, options.smoothing, threads, reporter.check)
    begin("lines")
    with times.part("lines"):
        blur = options.segments.aliased_blur if dense.aliased else 0.0
        segments = find_segments(views, options.segments, threads, blur)
        reporter.check()
        lines = find_lines(segments)
    begin("planes")
    with times.part("planes"):
        planes = fit_planes_to_lines(lines, views.pixel, options.planes)
        evidence = gather_evidence(views, lines, planes, dense, options)
    begin("cut")
    at = share * PARTS.index("cut") / len(PARTS)
    with times.part("cut"):
        mesh, strength = cut_in_blocks(
            views, evidence, options.cut, reporter.check, lambda which: reporter.progress(at, block=which, start="cut")
        )
    if not len(mesh.faces):
        raise BadInput("Masks and photos give no starting surface; check the masks and the cameras.")
    first = np.array([views.indices[s[0]] for s in dense.seen], np.int64)
    strongest = planes.planes[np.argsort(-planes.strength, kind="stable")]
    return StartSurface(mesh, strength, dense.points, first, views.pixel, strongest)
