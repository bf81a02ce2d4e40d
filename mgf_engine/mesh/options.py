# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the mesh extraction: those of the stage, and those of all its steps."""

from __future__ import annotations

from dataclasses import dataclass

from mgf_engine.masks.geometry.visual_hull import MaskHullOptions
from mgf_engine.mesh.border_smoothing import MeshBorderOptions
from mgf_engine.mesh.colors import ColorOptions
from mgf_engine.mesh.component_filter import ComponentFilterOptions
from mgf_engine.mesh.extend_planes import PlaneExtensionOptions
from mgf_engine.mesh.fusion_options import FusionOptions
from mgf_engine.mesh.low_confidence_fill import LowConfidenceFillOptions
from mgf_engine.mesh.mask_votes import MaskVoteOptions
from mgf_engine.mesh.opacity import OpacityOptions
from mgf_engine.mesh.photo_consistency import PatchOptions
from mgf_engine.mesh.planar_clustering import PlanarClusteringOptions
from mgf_engine.mesh.planar_options import PlanarOptions
from mgf_engine.mesh.refine import RefinementOptions
from mgf_engine.mesh.relief import ReliefOptions
from mgf_engine.mesh.screening import ScreeningOptions
from mgf_engine.mesh.tetrahedra import TetrahedraOptions
from mgf_engine.mesh.unobserved_volumes import UnobservedVolumeOptions
from mgf_engine.mesh.wall_openings import MeshOpeningOptions
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.scene.gravity import GravityOptions
from mgf_engine.scene.neighbours import NeighbourOptions


@dataclass(frozen=True)
class ExtractionOptions:
    """All options of the mesh extraction: those that several steps share, options of the job, and of each step."""

    calibration_error: float = parameter(
        1.0, "Maximum reprojection error of a sparse point for calibration of the level", "px"
    )
    calibration_track: int = parameter(
        3, "Minimum number of photos that observed a sparse point for calibration", low=1
    )
    neighbours: int = parameter(4, "Number of photos that each photo's depths are matched with", low=1)
    opacity_reach: float = parameter(2.0, "Maximum distance that an opacity surface moves to the matched depths", "px")
    made_up: float = parameter(
        0.005, "Maximum area of a patch that no photo shows, as a share of the mesh's area", high=1
    )
    beside_box: float = parameter(
        0.1, "Margin of the crop box within which Gaussians span the surface, as a share of its size"
    )
    small_hole: int = parameter(60, "Length of the rim below which a hole is closed", "ground px")

    device: str = job_option("device")
    use_masks: bool = job_option("use_masks")
    blocks: int = job_option("blocks")
    crop_box: str = job_option("crop_box")
    dilation: int = job_option("screening_dilation")
    surface: str = job_option("surface")
    match_photos: bool = job_option("match_photos")
    refine_rounds: int = job_option("refine_rounds")
    calibrate_level: bool = job_option("calibrate_level")
    level_steps: int = job_option("level_steps")
    merge_flat: bool = job_option("merge_flat")
    drop_unseen: bool = job_option("drop_unseen")
    face_votes: bool = job_option("face_votes")
    fill_holes: bool = job_option("fill_holes")
    span_dents: bool = job_option("span_dents")
    smoothing: int = job_option("smoothing")
    flatten: bool = job_option("flatten")
    openings: bool = job_option("openings")
    face_error: float = job_option("face_error")
    color_error: float = job_option("color_error")
    max_faces: int = job_option("max_faces")
    min_component: float = job_option("min_component")
    close_bottom: bool = job_option("close_bottom")

    mask_hull: MaskHullOptions = MaskHullOptions()
    matching: NeighbourOptions = NeighbourOptions()
    screening: ScreeningOptions = ScreeningOptions()
    tetrahedra: TetrahedraOptions = TetrahedraOptions()
    fusion: FusionOptions = FusionOptions()
    opacity: OpacityOptions = OpacityOptions()
    clustering: PlanarClusteringOptions = PlanarClusteringOptions()
    volumes: UnobservedVolumeOptions = UnobservedVolumeOptions()
    votes: MaskVoteOptions = MaskVoteOptions()
    borders: MeshBorderOptions = MeshBorderOptions()
    components: ComponentFilterOptions = ComponentFilterOptions()
    refinement: RefinementOptions = RefinementOptions()
    planes: PlanarOptions = PlanarOptions()
    relief: ReliefOptions = ReliefOptions()
    patches: PatchOptions = PatchOptions()
    extension: PlaneExtensionOptions = PlaneExtensionOptions()
    gravity: GravityOptions = GravityOptions()
    wall_openings: MeshOpeningOptions = MeshOpeningOptions()
    colors: ColorOptions = ColorOptions()
    fill: LowConfidenceFillOptions = LowConfidenceFillOptions()
