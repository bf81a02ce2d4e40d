# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets: what each changes from the defaults of the options."""

from __future__ import annotations

from typing import Any

#: What each preset changes from the defaults; options the user gives win over both.
PRESETS: dict[str, dict[str, Any]] = {
    "quick": {"passes": 0, "max_photos": 60, "holdout_every": 0},
    "draft": {"passes": 13, "max_photos": 60, "holdout_every": 0, "densify_every": 75},
    "standard": {},
    "fine": {"max_gaussians": 400_000, "resolution": 1500, "sh_degree": 3, "refine_rounds": 2},
    # What sections 3 and 4.1 of the paper print, and nothing of ours;
    # tests/options/test_paper_preset.py names the places.
    # Where the paper prints nothing, GOF, which it builds on, and 3DGS, which that builds on: degree of the harmonics,
    # 3D filter, growth and pruning, the share of the run from which the geometry terms act, step sizes, first
    # Gaussians.
    "paper": {
        "iterations": 7000,
        "resolution": 750,
        "even_exposure": False,
        "second_level": "on",
        "voters": "roots",
        "vote_tolerance": 0.0,
        "vote_dilation": 0,
        "mask_margin": 0.0,
        "start": "sparse",
        "sh_degree": 3,
        "coarse_to_fine": False,
        "random_background": False,
        "multilevel_loss": True,
        "boundary_loss": True,
        "geometry_from": 0.5,
        "geometry_every": 1,
        "background_lambda": 0.0,
        "densify_from": 0.0167,
        "densify_until": 0.5,
        "densify_every": 100,
        "densify_by": "absolute_gradient",
        "training_votes": False,
        "prune_opacity": 0.05,
        "screening_dilation": 0,
        "visual_hull": False,
        "surface": "opacity",
        "match_photos": False,
        "depth_smoothing": 0.0,
        "refine_rounds": 0,
        "calibrate_level": False,
        "merge_flat": False,
        "drop_unseen": False,
        "face_votes": False,
        "fill_holes": False,
        "span_dents": False,
        "smoothing": 0,
        "flatten": False,
        "openings": False,
        "face_error": 0.0,
        "min_component": 0.0,
        "texture": False,
        "gradient_densification.reset_every": 3000,
        "schedule.sh_degree_steps": 7,
        "initialisation.flatness": 1.0,
        "initialisation.opacity": 0.1,
        "learning_rates.by_extent": True,
        "learning_rates.positions": 1.6e-4,
        "learning_rates.positions_final": 1.6e-6,
        "learning_rates.log_scales": 5e-3,
        "learning_rates.rotations": 1e-3,
        "learning_rates.sh_constant": 2.5e-3,
        "learning_rates.sh_rest": 1.25e-4,
        "learning_rates.decay_to": 1.0,
        "votes.few": 0,
        "opacity.every_view": True,
        "pose_adjustment.adjust": False,
        "propagation.retry_below": 0.0,
        "propagation.disagree_above": 1.0,
        "propagation.finish": False,
    },
}


#: What a preset is, where the values that it sets would say little.
PRESET_HELP = {"paper": "The method exactly as in the paper, for comparison"}
