# SPDX-License-Identifier: GPL-3.0-or-later
"""The masks stage: clicks or masks in, label maps and masked points out."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from mgf_engine.config import Config
from mgf_engine.errors import BadInput
from mgf_engine.masks.contact import write_contact_sheet
from mgf_engine.masks.model import BUILDING, MaskSet, building
from mgf_engine.masks.points import vote
from mgf_engine.masks.prompts import read_prompts
from mgf_engine.masks.propagate import Propagation, propagate
from mgf_engine.masks.segmenters.base import Segmenter
from mgf_engine.masks.segmenters.grabcut import GrabCut
from mgf_engine.masks.store import save_masks
from mgf_engine.masks.supplied import read_supplied
from mgf_engine.messages import Reporter
from mgf_engine.scene.model import Scene


def build_masks(
    scene: Scene, prompts: Path | None, masks_folder: Path | None, folder: Path, config: Config, reporter: Reporter
) -> MaskSet:
    """Make the masks of a scene and write them to ``folder``.

    Args:
        prompts: the user's clicks; needed unless masks are given or switched off.
        masks_folder: the user's own masks, one PNG per photo; they win over clicks.
        folder: the job's ``masks`` folder.

    Raises:
        BadInput: no clicks, bad clicks or masks, or nothing left of the building.
    """
    started = time.perf_counter()
    clicked: set[int] = set()
    name = "none"
    if not config.use_masks:
        result = _everything(scene)
    elif masks_folder is not None:
        result, name = _supplied(scene, masks_folder, config, reporter), "supplied"
    elif prompts is not None:
        clicks = read_prompts(prompts, scene)
        segmenter = _choose_segmenter(config)
        clicked, name = set(clicks), segmenter.name
        result = propagate(scene, clicks, segmenter, config, reporter)
    else:
        raise BadInput("There are no clicks on the building; give --prompts FILE, or --masks FOLDER with your own masks.")
    _check(result, reporter, scene)
    seconds = (time.perf_counter() - started) / len(scene.views)
    save_masks(result.masks, scene, folder, result.reasons, {"segmenter": name, "seconds_per_photo": round(seconds, 3)})
    sheet = folder / "contact_sheet.jpg"
    write_contact_sheet(scene, result.masks, result.reasons, clicked, sheet)
    reporter.preview(str(sheet), "Masks")
    return result.masks


def _everything(scene: Scene) -> Propagation:
    """Masks off: every pixel and every point counts."""
    labels = tuple(np.full((v.height, v.width), BUILDING, np.uint8) for v in scene.views)
    count = len(scene.views)
    masks = MaskSet(labels, np.ones(count, bool), np.ones(count, np.float32), np.ones(len(scene.points), bool))
    return Propagation(masks, [""] * count)


def _supplied(scene: Scene, masks_folder: Path, config: Config, reporter: Reporter) -> Propagation:
    """The user's masks as they are; photos without one stay out of training."""
    given = read_supplied(masks_folder, scene)
    labels, reasons = [], []
    for view, mask in zip(scene.views, given, strict=True):
        labels.append(np.zeros((view.height, view.width), np.uint8) if mask is None else mask)
        reasons.append("no mask was given" if mask is None else "" if building(mask).any() else "the mask is empty")
    used = np.array([not r for r in reasons])
    rows = np.arange(len(scene.points))
    points = vote(scene.points, scene, labels, np.flatnonzero(used).tolist(), config, rows)
    return Propagation(MaskSet(tuple(labels), used, used.astype(np.float32), points), reasons)


def _choose_segmenter(config: Config) -> Segmenter:
    return GrabCut()


def _check(result: Propagation, reporter: Reporter, scene: Scene) -> None:
    masks = result.masks
    if not masks.used.any():
        raise BadInput("No photo got a usable mask; click more points on the building and beside it, in more photos.")
    if not masks.point_mask.any():
        raise BadInput("No sparse point lies on the building; check that clicks or masks belong to these photos.")
    flagged = [v.name for v, reason in zip(scene.views, result.reasons, strict=True) if reason]
    if flagged:
        names = ", ".join(flagged[:5]) + (", ..." if len(flagged) > 5 else "")
        reporter.warning(f"{len(flagged)} of {len(scene.views)} masks are weak and left out ({names}); see the contact sheet.")
