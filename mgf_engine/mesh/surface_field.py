# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the field that classifies points as solid or free: fused depth maps, or opacity of the Gaussians (eq. 25)."""

from __future__ import annotations

import logging

import numpy as np
import torch

from mgf_engine.errors import BadInput
from mgf_engine.mesh.opacity import OpacityField
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.prior import Prior
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.mesh.tsdf import TsdfField, fuse_gaussians
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene
from mgf_engine.raster.device import choose_device
from mgf_engine.scene.crop import CropBox

_RENDERED = 0.15  # progress of the stage (0..1) when the depth maps are done

log = logging.getLogger("mgf")

#: What tells solid from free: both have ``classify``, ``signed``, ``calibrate`` and ``observations``.
SurfaceField = OpacityField | TsdfField


def calibrate_level(field: SurfaceField, scene: Scene, masks: MaskSet, options: ExtractionOptions) -> None:
    """Set the level of a field so that the surface runs through the most reliable sparse points (``calibrate_level``).

    Args:
        field: its level is set.
        scene: photos, cameras and sparse points.
        masks: select the points on the building.
        options: which points are reliable.
    """
    if not options.calibrate_level:
        return
    long_tracks = np.diff(scene.track_start) >= options.calibration_track
    sure = masks.point_mask & (scene.errors < options.calibration_error) & long_tracks
    level = field.calibrate(scene.points[sure])
    what = "px behind the depths" if isinstance(field, TsdfField) else "is their opacity"
    log.info("mesh: the surface runs through %d sparse points: %.2f %s", sure.sum(), level, what)


def surface_field(
    gaussians: Gaussians,
    trusted: TrustedViews,
    options: ExtractionOptions,
    reporter: Reporter,
    prior: Prior | None = None,
) -> SurfaceField:
    """Make the field of the option ``surface``.

    With ``surface=opacity``, depth maps are fused as well if a later step needs to know what the photos show.

    Args:
        gaussians: the screened field.
        trusted: photos and masks.
        options: of the extraction.
        reporter: for progress, warnings and the request to cancel.
        prior: the starting surface; None if it is not used.
    """
    gaussians = gaussians.to(choose_device(options.device).device)
    fused = None
    if options.surface == "fused" or options.match_photos or options.drop_unseen or options.span_dents:
        fused = fuse_gaussians(
            gaussians, trusted.views, trusted.silhouettes, trusted.photos,
            lambda share: reporter.progress(_RENDERED * share), prior, options.fusion,
        )  # fmt: skip
        if options.surface == "fused":
            return fused
    return OpacityField(gaussians, trusted.views, trusted.silhouettes, options.opacity, fused)


def select_near_box(gaussians: Gaussians, box: CropBox, beside: float) -> Gaussians:
    """Select the Gaussians in the crop box, enlarged by the share ``beside`` of its size.

    Only these span the tetrahedra. The field keeps all Gaussians: without them a view
    of the far side would see through their places and call the inside of the building free.

    Raises:
        BadInput: none is there.
    """
    near = box.contains(gaussians.positions.detach().double().numpy(), beside)
    if not near.any():
        raise BadInput("No Gaussian lies in the crop box; enlarge it or move it over the building.")
    return gaussians.select(torch.from_numpy(near))
