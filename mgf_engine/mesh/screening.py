# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-directional screening (eq. 21-22): only Gaussians whose centres the masks call building make the mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from mgf_engine.config import Config
from mgf_engine.errors import BadInput
from mgf_engine.masks.points import chosen_voters, vote
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene


def voting_views(scene: Scene, masks: MaskSet) -> list[int]:
    """Views whose masks may be trusted and that are not kept out for measuring; all with a mask when none is left."""
    used = [int(i) for i in np.flatnonzero(masks.used)]
    held_out = set(scene.held_out)
    return [i for i in used if i not in held_out] or used


def screen(gaussians: Gaussians, scene: Scene, masks: MaskSet, config: Config) -> Gaussians:
    """The Gaussians that pass the vote of eq. 3 (all of them when ``config.screening`` or the masks are off).

    Raises:
        BadInput: the field is empty, or the masks vote against every Gaussian.
    """
    if len(gaussians) == 0:
        raise BadInput("The field has no Gaussians, so there is nothing to mesh; train the field again.")
    keep = finite(gaussians)
    if config.screening and config.use_masks:
        centres = gaussians.positions.detach().double().numpy()
        # Sparse points may stand a few pixels beside a mask drawn for them; what is trained there hides the outline.
        narrow = replace(config, vote_dilation=config.screening_dilation)
        keep &= vote(centres, scene, masks, chosen_voters(scene, voting_views(scene, masks), config), narrow)
    if not keep.any():
        raise BadInput(
            "The masks vote against every Gaussian of the field; check the clicks and the masks, or turn screening off."
        )
    return gaussians.select(torch.from_numpy(keep))


def finite(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Gaussians whose every parameter of shape and place is a number, bool [N]."""
    parts = (gaussians.positions, gaussians.log_scales, gaussians.rotations, gaussians.opacity_logits[:, None])
    good: NDArray[np.bool_] = torch.isfinite(torch.cat(parts, 1)).all(1).numpy()
    return good
