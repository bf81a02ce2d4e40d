# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-directional screening (eq. 21-22): only Gaussians whose centres the masks call building make the mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from mgf_engine.config import job_option
from mgf_engine.errors import BadInput
from mgf_engine.masks.points import VoteOptions, choose_voters, vote
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene


@dataclass(frozen=True)
class ScreeningOptions:
    """Options of the screening."""

    screening: bool = job_option("screening")
    use_masks: bool = job_option("use_masks")
    dilation: int = job_option("screening_dilation")
    threads: int = job_option("threads")
    votes: VoteOptions = VoteOptions()


def voting_views(scene: Scene, masks: MaskSet) -> list[int]:
    """Choose the views with a trusted mask that are not held out; all with a mask where none is left."""
    used = [int(i) for i in np.flatnonzero(masks.used)]
    held_out = set(scene.held_out)
    return [i for i in used if i not in held_out] or used


def screen(
    gaussians: Gaussians, scene: Scene, masks: MaskSet, options: ScreeningOptions = ScreeningOptions()
) -> Gaussians:
    """Select the Gaussians that pass the vote of eq. 3 (all of them where the screening or the masks are off).

    Args:
        gaussians: normalised frame.
        scene: cameras of the photos.
        masks: their label maps.
        options: whether and how strictly to vote.

    Raises:
        BadInput: the field is empty, or the masks vote against every Gaussian.
    """
    if len(gaussians) == 0:
        raise BadInput("The field has no Gaussians, so there is nothing to mesh; train the field again.")
    keep = finite(gaussians)
    if options.screening and options.use_masks:
        centres = gaussians.positions.detach().double().numpy()
        # Sparse points may stand a few pixels beside a mask drawn for them; what is trained there hides the outline.
        votes = replace(options.votes, dilation=options.dilation)
        voters = choose_voters(scene, voting_views(scene, masks), masks.clicked, votes)
        keep &= vote(centres, scene, masks, voters, votes, threads=options.threads)
    if not keep.any():
        raise BadInput(
            "The masks vote against every Gaussian of the field; check the clicks and the masks, or turn screening off."
        )
    return gaussians.select(torch.from_numpy(keep))


def finite(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Find the Gaussians whose parameters of shape and place are all finite, bool [N]."""
    parts = (gaussians.positions, gaussians.log_scales, gaussians.rotations, gaussians.opacity_logits[:, None])
    good: NDArray[np.bool_] = torch.isfinite(torch.cat(parts, 1)).all(1).numpy()
    return good
