# SPDX-License-Identifier: GPL-3.0-or-later
"""Check how completely given masks cover the building: holes, missing rims, included ground or neighbours.

A sparse point that is inside the masks of most photos belongs to the building; a mask with this point outside is
incomplete there. The pixels around it are ignored in training, and a warning says how many observations are wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.points import LabelMaps
from mgf_engine.model.masks import IGNORE, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class CoverageOptions:
    """Options of the check of given masks."""

    margin: float = parameter(1.5, "Distance to the outline from which an observation contradicts its mask", "px")
    photos: int = parameter(3, "Number of photos with a mask that must see a point", low=1)
    lacking: float = parameter(
        0.002, "Share of the building's observations outside their masks that a warning is given for", low=1e-06, high=1
    )
    excess: float = parameter(
        0.01, "Share of the surroundings' observations inside the masks that a warning is given for", low=1e-06, high=1
    )
    ignored: float = parameter(2.0, "Radius around a contradicting observation that is ignored", "px")


@dataclass(frozen=True)
class MaskCoverage:
    """Which observations contradict their own mask.

    Attributes:
        margin: signed distance to the outline of the mask, pixels, positive inside, [T]; NaN where no mask says.
        on_building, beside: bool [T], observations of points that most masks have inside, or outside.
    """

    margin: NDArray[np.float64]
    on_building: NDArray[np.bool_]
    beside: NDArray[np.bool_]
    options: CoverageOptions = CoverageOptions()

    @property
    def lacking(self) -> NDArray[np.bool_]:
        """Observations of the building that their mask leaves out, bool [T]."""
        return self.on_building & (self.margin < -self.options.margin)

    @property
    def excess(self) -> NDArray[np.bool_]:
        """Observations of the surroundings that their mask takes in, bool [T]."""
        return self.beside & (self.margin > self.options.margin)


def measure_coverage(
    scene: Scene, labels: LabelMaps, used: NDArray[np.bool_], options: CoverageOptions = CoverageOptions()
) -> MaskCoverage:
    """Compare the masks of the views ``used`` (bool [V]) at the points that they share.

    Args:
        scene: tracks of the sparse points.
        labels: label maps of all views, uint8 [H, W] each.
        used: views whose masks are compared, bool [V].
        options: margins and limits.
    """
    margin = np.full(len(scene.track_view), np.nan)
    for index in np.flatnonzero(used).tolist():
        here = scene.observations(index)
        y, x = pixel_at(labels[index].shape, scene.track_uv[here])
        margin[here] = np.where(labels[index][y, x] == IGNORE, np.nan, _signed(building(labels[index]))[y, x])
    known, owner = np.isfinite(margin), scene.track_point
    voters = np.bincount(owner[known], minlength=len(scene.points))
    inside = np.bincount(owner[known], margin[known] > 0, len(scene.points))
    decided = known & (voters[owner] >= options.photos)
    return MaskCoverage(margin, decided & (2 * inside > voters)[owner], decided & (2 * inside < voters)[owner], options)


def _signed(inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance of each pixel to the outline, positive inside."""
    mask = inside.astype(np.uint8)
    within, without = (cv2.distanceTransform(m, cv2.DIST_L2, 3) for m in (mask, 1 - mask))
    return np.asarray(np.where(inside, within, -without), np.float32)


def mark_ignored(scene: Scene, labels: LabelMaps, fit: MaskCoverage) -> list[NDArray[np.uint8]]:
    """Return the label maps with background set to ignored where observations show the building.

    These are the pixels around each observation that its mask leaves out, up to the distance of the mask, and whole
    holes with such observations and none of the surroundings.
    """
    result = list(labels)
    for index in np.unique(scene.track_view[fit.lacking]).tolist():
        here = scene.observations(index)
        lacking, beside = here[fit.lacking[here]], here[fit.beside[here]]
        background = ~building(result[index])
        disc = _holes(background, scene.track_uv[lacking], scene.track_uv[beside])
        for (x, y), margin in zip(np.floor(scene.track_uv[lacking]), fit.margin[lacking], strict=True):
            cv2.circle(disc, (int(x), int(y)), round(fit.options.ignored - margin), 1, -1)
        result[index] = np.where((disc > 0) & background, IGNORE, result[index]).astype(np.uint8)
    return result


def _holes(
    background: NDArray[np.bool_], lacking: NDArray[np.float32], beside: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """Return the pieces of background within the frame that hold observations ``lacking`` and none ``beside``, uint8
    [H, W]."""
    count, pieces = cv2.connectedComponents(background.astype(np.uint8), connectivity=4)
    pieces = np.asarray(pieces)
    hole = np.zeros(count, bool)
    hole[pieces[pixel_at(pieces.shape, lacking)]] = True
    hole[pieces[pixel_at(pieces.shape, beside)]] = False
    for edge in (pieces[0], pieces[-1], pieces[:, 0], pieces[:, -1]):
        hole[edge] = False
    hole[0] = False  # the building itself
    return hole[pieces].astype(np.uint8)


def describe_misfits(scene: Scene, fit: MaskCoverage) -> list[str]:
    """Return one warning if masks leave out much of the building or include its surroundings, else no warning.

    Only the greater fault is named: where much is wrong, the majority is, too, and each looks like the other.
    """
    lacking, excess = _share(fit.lacking, fit.on_building), _share(fit.excess, fit.beside)
    if max(lacking / fit.options.lacking, excess / fit.options.excess) <= 1:
        return []
    if lacking / fit.options.lacking > excess / fit.options.excess:
        return [
            f"The given masks cut off parts of the building or have holes: {lacking:.1%} of its visible points "
            f"lie outside (most in {_most(scene, fit.lacking)}). Enlarge the masks and fill their holes, or those "
            "parts will be missing from the mesh."
        ]
    return [
        f"The given masks include more than the building: {excess:.1%} of the visible points around it lie inside "
        f"(most in {_most(scene, fit.excess)}). Draw the masks tighter, or ground and neighbours will be part of "
        "the mesh."
    ]


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    return float(part.sum() / max(int(whole.sum()), 1))


def _most(scene: Scene, wrong: NDArray[np.bool_]) -> str:
    count = np.bincount(scene.track_view[wrong], minlength=len(scene.views))
    worst = [i for i in np.argsort(-count, kind="stable")[:3].tolist() if count[i]]
    return ", ".join(f"'{scene.views[i].name}'" for i in worst)
