# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-directional screening (eq. 21-22): select the Gaussians whose centres lie inside the masks."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.masks.points import ViewVotes, VoteOptions, Votes, choose_voters, count_votes, decide, votes_of_views
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import job_option
from mgf_engine.system.machine import cores

log = logging.getLogger("mgf")
#: Share of the Gaussians from which a photo that alone removes them is named. Where nothing stands in front of the
#: building, root masks had up to 0.05 on three scenes; where trees do, 0.25 to 0.54.
VETO = 0.1


@dataclass(frozen=True)
class ScreeningOptions:
    """Options of the screening."""

    screening: bool = job_option("screening")
    use_masks: bool = job_option("use_masks")
    dilation: int = job_option("screening_dilation")
    threads: int = job_option("threads")
    votes: VoteOptions = VoteOptions()


def voting_views(scene: Scene, masks: MaskSet) -> list[int]:
    """Return the numbers of views with a usable mask that are not held out; if there are none, all with a mask."""
    used = [int(i) for i in np.flatnonzero(masks.used)]
    held_out = set(scene.held_out)
    return [i for i in used if i not in held_out] or used


def screen(
    gaussians: Gaussians,
    scene: Scene,
    masks: MaskSet,
    options: ScreeningOptions = ScreeningOptions(),
    warn: Callable[[str], None] = log.warning,
) -> Gaussians:
    """Select the Gaussians that pass the vote of eq. 3 (all of them where the screening or the masks are off).

    Args:
        gaussians: normalised frame.
        scene: cameras of the photos.
        masks: their label maps.
        options: whether and how strictly to vote.
        warn: called with one sentence for a photo whose mask alone removes much, where one may.

    Raises:
        BadInput: the field is empty, or the masks vote against every Gaussian.
    """
    if len(gaussians) == 0:
        raise BadInput("The field has no Gaussians, so there is nothing to mesh; train the field again.")
    keep = finite(gaussians)
    if options.screening and options.use_masks:
        keep &= _vote(gaussians, scene, masks, options, warn)
    if not keep.any():
        raise BadInput(
            "The masks vote against every Gaussian of the field; check the clicks and the masks, or turn screening off."
        )
    return gaussians.select(torch.from_numpy(keep))


def _vote(
    gaussians: Gaussians, scene: Scene, masks: MaskSet, options: ScreeningOptions, warn: Callable[[str], None]
) -> NDArray[np.bool_]:
    """Return the Gaussians that the masks vote for, bool [N]; warn of photos whose veto alone removes much."""
    centres = gaussians.positions.detach().double().numpy()
    # Masks are dilated less here than for sparse points: Gaussians just outside would hide the building's outline.
    votes = replace(options.votes, dilation=options.dilation)
    voters = choose_voters(scene, voting_views(scene, masks), masks.clicked, votes)
    cast = votes_of_views(centres, scene, masks.labels, voters, votes.dilation, options.threads or cores())
    if votes.tolerance > 0 or votes.few > 0:  # no photo decides alone, so none needs to be kept for a warning
        return decide(count_votes(len(centres), cast), votes, len(voters))
    kept = list(cast)
    counted = count_votes(len(centres), kept)
    for view, share in zip(voters, vetoes(counted, kept), strict=True):
        if share > VETO:
            warn(veto_text(scene.views[view].name, share))
    return decide(counted, votes, len(voters))


def vetoes(votes: Votes, cast: Iterable[ViewVotes]) -> list[float]:
    """Compute what each photo alone removes where no vote against a point is tolerated (eq. 22).

    Args:
        votes: of all photos.
        cast: votes of each photo.

    Returns:
        For each photo the share of the points that stay without its vote.
    """
    stay = int(((votes.inside > 0) & (votes.outside == 0)).sum())
    alone = [int(((votes.outside[missed] == 1) & (votes.inside[missed] > 0)).sum()) for _, missed in cast]
    return [removed / max(1, removed + stay) for removed in alone]


def veto_text(name: str, share: float) -> str:
    """Return what to say of a photo whose mask alone removes much of the field."""
    return (
        f"The mask of '{name}' alone removes {share:.0%} of what all others leave (eq. 22); if something stands in "
        "front of the building there, take the clicks off this photo, or give masks in which it is 255."
    )


def finite(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Find the Gaussians whose position, scale, rotation and opacity are all finite, bool [N]."""
    parts = (gaussians.positions, gaussians.log_scales, gaussians.rotations, gaussians.opacity_logits[:, None])
    good: NDArray[np.bool_] = torch.isfinite(torch.cat(parts, 1)).all(1).numpy()
    return good
