# SPDX-License-Identifier: GPL-3.0-or-later
"""``--preset paper`` is what the paper prints: every option is accounted for, with the place it is printed at."""

from __future__ import annotations

import json

import pytest

from mgf_engine.field.gradient_density import GradientDensityOptions
from mgf_engine.masks.propagation.propagate import PropagationOptions
from mgf_engine.options.algorithm_table import ALGORITHMS
from mgf_engine.options.algorithms import algorithm_default, is_algorithm_option
from mgf_engine.options.config import Config, as_dict, make_config, option_fields
from mgf_engine.options.presets import PRESETS
from mgf_engine.scene.adjust import AdjustOptions

#: Option -> value and where the paper prints it.
PRINTED = {
    "resolution": (750, "4.1.1: all tested images were downsampled to 750 x 500"),
    "use_masks": (True, "3.1: masks of the building; eq. 3, 14, 18 and 22 need them"),
    "masked_images": (True, "3.2.1, eq. 14: rays of the non-mask region are left out"),
    "masked_points": (True, "3.1.2, eq. 3; 3.2: masked points are the input of training"),
    "segmenter": ("auto", "3.1.2: EfficientSAM, where its weights are; a line says so where they are not"),
    "second_level": ("on", "3.1.2: a second-level mask with windows, doors, walls"),
    "voters": ("roots", "eq. 3 and 22: the masks of the root images"),
    "strict_vote": (False, "eq. 3 and 22: every root mask; a photo that does not show the point has no vote"),
    "vote_tolerance": (0.0, "eq. 3 and 22: for all j, so none may be against"),
    "vote_dilation": (0, "eq. 3: inside the mask"),
    "iterations": (7000, "4.3: 7,000 training iterations"),
    "start": ("sparse", "3.2: masked points"),
    "multilevel_loss": (True, "eq. 18-19"),
    "boundary_loss": (True, "eq. 17"),
    "l1_weight": (0.8, "eq. 16-18, alpha; the number is of 3DGS, which the loss is from"),
    "ssim_weight": (0.2, "eq. 16-18, beta; the number is of 3DGS"),
    "boundary_weight": (10.0, "eq. 12: w_edge is set as 10"),
    "multilevel_lambda": (0.5, "eq. 20, lambda 1"),
    "boundary_lambda": (0.5, "eq. 20, lambda 2"),
    "distortion_lambda": (100.0, "eq. 20, lambda 3"),
    "normal_lambda": (0.05, "eq. 20, lambda 4"),
    "screening": (True, "3.3.1, eq. 21-22"),
    "screening_dilation": (0, "eq. 22: within the masked regions"),
    "surface": ("opacity", "eq. 23-25"),
    "opacity_level": (0.5, "eq. 26"),
    "level_steps": (8, "3.3.1: binary search for the level set; the number of steps is of GOF"),
}
#: Option -> value where the paper prints none and names what it builds on.
OF_ITS_BASE = {
    "sh_degree": (3, "3DGS"),
    "geometry_from": (0.5, "GOF: from 15,000 of 30,000 iterations"),
    "densify_from": (0.0167, "3DGS: from 500 of 30,000 iterations"),
    "densify_until": (0.5, "3DGS: until 15,000 of 30,000"),
    "densify_every": (100, "3DGS"),
    "densify_by": (
        "absolute_gradient",
        "GOF: adds the lengths of the pixels' gradients, 3DGS the gradients",
    ),
    "prune_opacity": (0.05, "GOF: densify_and_prune is called with 0.05, where 3DGS has 0.005"),
    "filter_3d": (True, "GOF: the 3D filter of Mip-Splatting, in training and in the tetrahedra"),
}
#: What is ours, and how it is switched off.
OURS = {
    "max_photos": 0, "even_exposure": False, "mask_margin": 0.0, "coarse_to_fine": False,
    "random_background": False, "geometry_every": 1, "background_lambda": 0.0, "training_votes": False,
    "visual_hull": False, "match_photos": False, "refine_rounds": 0, "depth_smoothing": 0.0,
    "calibrate_level": False, "merge_flat": False,
    "drop_unseen": False, "face_votes": False, "fill_holes": False, "span_dents": False, "smoothing": 0,
    "flatten": False, "openings": False, "face_error": 0.0, "min_component": 0.0, "close_bottom": False,
    "crop_box": "", "texture": False,
}  # fmt: skip
#: Options of algorithms that run always otherwise, and what they are where the paper has no such step.
ALGORITHMS_OFF = {
    "votes.few": 0,  # eq. 3 and 22 tolerate no vote against a point
    "opacity.every_view": True,  # eq. 25: the minimum among all views
    "pose_adjustment.adjust": False,  # 3.1.1 takes the cameras of structure from motion as they are
    "propagation.retry_below": 0.0,  # 3.1.2 prompts EfficientSAM once per photo
    "propagation.disagree_above": 1.0,
    "propagation.finish": False,  # eq. 1 and 3.1.2: the mask is what the segmenter returns
}
#: Options of algorithms that differ from ours, and what 3DGS prints (section 5 and its appendix of step sizes).
ALGORITHMS_OF_ITS_BASE = {
    "gradient_densification.reset_every": 3000,  # opacities, every 3,000 iterations
    "schedule.sh_degree_steps": 7,  # a degree every 1,000 iterations
    "initialisation.flatness": 1.0,  # isotropic
    "initialisation.opacity": 0.1,
    "learning_rates.by_extent": True,
    "learning_rates.positions": 1.6e-4,
    "learning_rates.positions_final": 1.6e-6,
    "learning_rates.log_scales": 5e-3,
    "learning_rates.rotations": 1e-3,
    "learning_rates.sh_constant": 2.5e-3,
    "learning_rates.sh_rest": 1.25e-4,  # a twentieth of the constant one's
    "learning_rates.decay_to": 1.0,  # the rate of the positions alone falls
}
#: What 3DGS prints and we have everywhere or as a default that only the paper's setting uses.
ALGORITHMS_AS_PRINTED = {
    "gradient_densification.threshold": 2e-4,
    "gradient_densification.clone_below": 0.01,
    "gradient_densification.split_shrink": 1.6,
    "gradient_densification.largest": 0.1,
    "gradient_densification.reset_opacity": 0.01,
    "learning_rates.opacity_logits": 5e-2,
}
#: Algorithms up to the mesh that act under the preset, and what they are there.
ACTING = {
    # 3.1.1, and checks of what is given
    "structure_from_motion": "COLMAP", "scene_checks": "check", "photo_quality": "check",
    # 3.1.2: from clicks on some photos to a mask of each; without EfficientSAM's weights the built-in segmenter
    **dict.fromkeys(
        (
            "random_walker", "superpixels", "appearance", "sky", "mask_drawing", "building_extent", "ground_plan",
            "superstructures", "point_visibility", "floaters", "silhouettes", "densify_points", "stereo",
            "coarse_stereo", "neighbour_views", "gravity", "ground_plane", "point_features", "overhangs",
            "point_surface",
        ),
        "what clicks say of all photos and points",
    ),
    "propagation": "root and child masks", "parts": "second level", "votes": "eq. 3 and 22",
    **dict.fromkeys(
        (
            "prompt_outliers", "prompt_evidence", "prompt_agreement", "transient_prompts", "mask_flags", "low_texture",
            "building_size", "mask_coverage", "mask_hull", "cross_view",
        ),
        "check",
    ),
    # 3.2
    "start_points": "masked points", "initialisation": "first Gaussians", "targets": "eq. 12, 14 and 19",
    "schedule": "eq. 20", "filter_3d": "GOF", "densification": "first and last round of the growth",
    "gradient_densification": "3DGS, GOF", "learning_rates": "3DGS",
    # 3.3
    "tetrahedra": "GOF", "opacity": "eq. 23-25", "extraction": "all steps",
    "vertex_colors": "colours alone", "mesh_parts": "names of faces alone",
}  # fmt: skip
#: Algorithms up to the mesh that do not act, and the option by which the preset sees to it.
IDLE = {
    "pose_adjustment": "pose_adjustment.adjust", "exposure": "even_exposure",
    **dict.fromkeys(
        (
            "sky_holes", "ground_homography", "mirrored_ground", "mirrored_sky", "ignored_surface", "far_background",
            "thin_structures", "homogeneous_regions", "foreground_leaves", "sky_silhouette",
            "silhouette_hull",
        ),
        "propagation.finish",
    ),
    **dict.fromkeys(
        (
            "start_views", "start_outside", "start_lines", "start_planes", "start_stereo", "start_aliased",
            "patch_match", "start_smoothing", "start_cut", "start_samples", "dense_points",
        ),
        "start",
    ),
    "photometric": "match_photos", "depth_smoothing": "match_photos", "prior": "start", "tsdf": "surface",
    "confidence_warning": "surface", "visual_hull": "visual_hull", "mesh_refinement": "refine_rounds",
    **dict.fromkeys(("planar", "relief", "patches", "plane_labels", "plane_extension", "plane_borders"), "flatten"),
    **dict.fromkeys(
        ("opening_walls", "opening_detection", "opening_edges", "opening_arches", "opening_cuts"), "openings"
    ),
    "planar_clustering": "merge_flat", "mask_votes": "face_votes", "low_confidence_fill": "span_dents",
    "unobserved_volumes": "drop_unseen", "component_filter": "drop_unseen", "mesh_border": "drop_unseen",
}  # fmt: skip
#: Options of the method's stages that decide nothing about it, or that the others leave idle.
NO_MATTER = {
    "weights", "passes", "holdout_every", "max_gaussians", "max_faces", "color_error",
}  # fmt: skip


@pytest.mark.parametrize("name", sorted({**PRINTED, **OF_ITS_BASE}))
def test_the_preset_has_the_printed_value(name: str) -> None:
    assert getattr(make_config({"preset": "paper"}), name) == {**PRINTED, **OF_ITS_BASE}[name][0]


@pytest.mark.parametrize("name", sorted(OURS))
def test_what_is_ours_is_off(name: str) -> None:
    assert getattr(make_config({"preset": "paper"}), name) == OURS[name]


def test_what_always_runs_otherwise_is_off() -> None:
    config = make_config({"preset": "paper"})
    changed = ALGORITHMS_OFF | ALGORITHMS_OF_ITS_BASE
    assert config.algorithms == changed
    assert {k for k in PRESETS["paper"] if is_algorithm_option(k)} == set(changed)
    assert all(algorithm_default(name) != value for name, value in changed.items())


@pytest.mark.parametrize("name", sorted(ALGORITHMS_AS_PRINTED))
def test_the_default_is_the_printed_value(name: str) -> None:
    assert algorithm_default(name) == ALGORITHMS_AS_PRINTED[name]


def test_what_is_off_can_be_switched_on_again_and_stays_so_in_the_job_file() -> None:
    config = make_config({"preset": "paper", "propagation.finish": True})
    assert config.algorithm(PropagationOptions).finish and not config.algorithm(AdjustOptions).adjust
    assert make_config(json.loads(json.dumps(as_dict(config)))) == config


@pytest.mark.parametrize(("iterations", "every"), [(7000, 100), (1500, 21), (30_000, 100), (10, 1)])
def test_a_shorter_run_has_as_many_rounds_and_opacities_have_time_to_recover(iterations: int, every: int) -> None:
    config = make_config({"preset": "paper", "iterations": iterations})
    assert (config.densify_every, config.algorithm(GradientDensityOptions).reset_every) == (every, 3000)


def test_a_given_interval_of_densification_wins_over_the_scaled_one() -> None:
    assert make_config({"preset": "paper", "iterations": 1500, "densify_every": 70}).densify_every == 70
    assert make_config({"preset": "draft", "iterations": 1500}).densify_every == 75  # which trains by photos


def test_every_option_of_the_method_is_accounted_for() -> None:
    """A new option of masks, field or mesh has to say whether the paper prints it: add it to one of the tables."""
    known = [set(PRINTED), set(OF_ITS_BASE), set(OURS), NO_MATTER]
    names = {f.name for f in option_fields() if f.metadata["section"] in ("masks", "field", "mesh")}
    assert sum(len(table) for table in known) == len(set().union(*known))
    assert names - set().union(*known) == set() and set().union(*known) <= {f.name for f in option_fields()}
    assert not set(PRESETS["paper"]) & NO_MATTER


def test_every_algorithm_up_to_the_mesh_is_accounted_for() -> None:
    """A new algorithm has to say whether it acts under the preset: add it to one of the tables."""
    names = {a.section for a in ALGORITHMS if a.stage in ("scene", "masks", "field", "mesh")}
    assert names == set(ACTING) | set(IDLE) and not set(ACTING) & set(IDLE)


@pytest.mark.parametrize("option", sorted(set(IDLE.values())))
def test_the_preset_switches_off_what_does_not_act(option: str) -> None:
    default = algorithm_default(option) if is_algorithm_option(option) else getattr(Config(), option)
    assert PRESETS["paper"][option] != default
