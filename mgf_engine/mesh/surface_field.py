# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the field that tells solid from free: the opacity of the Gaussians (eq. 25), or their fused depth maps."""

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

_RENDERED = 0.15  # share of the stage in which depth maps are made

log = logging.getLogger("mgf")


def calibrate_level(field: OpacityField | TsdfField, scene: Scene, masks: MaskSet, options: ExtractionOptions) -> None:
    """Set the level of the surface so that it runs through the most reliable sparse points, where that is wanted.

    Args:
        field: whose level is set.
        scene: photos, cameras and sparse points.
        masks: which tell the points on the building.
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
) -> OpacityField | TsdfField:
    """Make the field that tells solid from free, as the option ``surface`` says.

    The depth maps of a fused surface are made for an opacity surface, too, where anything asks what the views show.

    Args:
        gaussians: the screened field.
        trusted: photos and masks.
        options: of the extraction.
        reporter: for progress, warnings and the request to cancel.
        prior: a surface known before the field.
    """
    gaussians = gaussians.to(choose_device(options.device).device)
    fused = None
    if options.surface == "fused" or options.match_photos or options.drop_unseen or options.span_dents:
        fused = fuse_gaussians(
            gaussians, trusted.views, trusted.verdicts, trusted.photos,
            lambda share: reporter.progress(_RENDERED * share), prior, options.fusion,
        )  # fmt: skip
        if options.surface == "fused":
            return fused
    return OpacityField(gaussians, trusted.views, trusted.verdicts, options.opacity, fused)


def select_near_box(gaussians: Gaussians, box: CropBox, beside: float) -> Gaussians:
    """Select the Gaussians in the crop box and up to a share ``beside`` of its size around it.

    They span the tetrahedra and carry the surface to where it is cut. The field keeps all others: without them a view
    of the far side would see through their places and call the inside of the building free.

    Raises:
        BadInput: none is there.
    """
    near = box.contains(gaussians.positions.detach().double().numpy(), beside)
    if not near.any():
        raise BadInput("No Gaussian lies in the crop box; enlarge it or move it over the building.")
    return gaussians.select(torch.from_numpy(near))
