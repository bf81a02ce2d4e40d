# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the masks stage: from clicks or given masks to label maps and the sparse points on the building."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.masks.contact_sheet import write_contact_sheet
from mgf_engine.masks.elements import add_elements
from mgf_engine.masks.geometry.visual_hull import MaskHullOptions, hull_cells
from mgf_engine.masks.image_ops import dilate_square
from mgf_engine.masks.map_photos import map_photos
from mgf_engine.masks.part_options import PartOptions
from mgf_engine.masks.parts import Part, match_elements
from mgf_engine.masks.points import VoteOptions, choose_voters, vote
from mgf_engine.masks.prompts import Prompts, PromptsFile, no_clicks, read_prompts
from mgf_engine.masks.propagation.propagate import Propagation, propagate
from mgf_engine.masks.propagation.propagation_options import PropagationOptions
from mgf_engine.masks.segmenters.base import Segmenter
from mgf_engine.masks.segmenters.efficientsam import EfficientSam
from mgf_engine.masks.segmenters.messages import describe_segmenter
from mgf_engine.masks.segmenters.random_walker import MaskDrawingOptions, RandomWalker
from mgf_engine.masks.store import save_masks
from mgf_engine.masks.user_masks import read_user_masks
from mgf_engine.masks.validation.building_size import BuildingSizeOptions, small_building_warning
from mgf_engine.masks.validation.cross_view_consistency import CrossViewOptions, find_contradicted_masks
from mgf_engine.masks.validation.low_texture import LowTextureOptions, low_texture_share, low_texture_warning
from mgf_engine.masks.validation.mask_coverage import CoverageOptions, describe_misfits, mark_ignored, measure_coverage
from mgf_engine.masks.validation.mask_flags import describe_flags, measure_consistency
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import BACKGROUND, BUILDING, MaskSet, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import plain_opencv
from mgf_engine.options.config import Config
from mgf_engine.system.machine import cores
from mgf_engine.weights import default_folder, find_weights, missing_text

log = logging.getLogger("mgf")


@plain_opencv()
def build_masks(
    scene: Scene,
    prompts: Path | PromptsFile | None,
    masks_folder: Path | None,
    folder: Path,
    config: Config,
    reporter: Reporter,
) -> MaskSet:
    """Make the masks of a scene and write them to ``folder``; photos are processed in parallel, one thread each.

    Args:
        scene: photos, cameras and sparse points.
        prompts: the user's clicks; needed unless masks are given or switched off.
        masks_folder: the user's own masks, one PNG per photo; they take precedence over clicks.
        folder: the job's ``masks`` folder.
        config: of the job.
        reporter: for progress, warnings and the request to cancel.

    Raises:
        BadInput: no clicks, unusable clicks or masks, or an empty result.
    """
    started, threads = time.perf_counter(), config.threads or cores()
    result, clicks, segmenter = _first_level(scene, prompts, masks_folder, folder, config, reporter)
    _check(scene, result, config)
    masks, parts = result.masks, list[Part]()
    if segmenter is not None and config.wants_elements(any(photo.parts for photo in clicks.values())):
        masks, parts = _second_level(scene, masks, clicks, segmenter, threads, reporter, config.algorithm(PartOptions))
    figures: dict[str, Any] = {
        "segmenter": segmenter.name if segmenter else "none",
        "seconds_per_photo": round((time.perf_counter() - started) / len(scene.views), 3),
        "consistency": round(result.consistency, 4),
        "warnings": result.warnings,
    }
    save_masks(masks, scene, folder, result.reasons, figures, parts, threads)
    sheet = folder / "contact_sheet.jpg"
    write_contact_sheet(scene, masks, result.reasons, set(clicks), sheet, threads)
    reporter.preview(str(sheet), "Masks")
    _warn(result, scene, reporter)
    _check_clicks(clicks, masks, config.algorithm(PropagationOptions).click_slip)
    if config.use_masks:
        _warn_of_building(scene, masks, config, reporter)
    return masks


def _first_level(
    scene: Scene,
    prompts: Path | PromptsFile | None,
    masks_folder: Path | None,
    folder: Path,
    config: Config,
    reporter: Reporter,
) -> tuple[Propagation, Prompts, Segmenter | None]:
    """Make the masks of the whole building from the user's masks or from clicks; full masks with ``use_masks`` off.

    Returns:
        The masks, and the clicks and segmenter that they were made with (None without clicks).
    """
    if not config.use_masks:
        return _all_building(scene), {}, None
    if masks_folder is not None:
        return _user_masks(scene, masks_folder, config), {}, None
    if prompts is None:
        raise no_clicks()
    clicks = read_prompts(prompts, scene, reporter.warning)
    segmenter = choose_segmenter(config, folder, reporter.warning)
    reporter.send("segmenter", segmenter=segmenter.name, text=describe_segmenter(segmenter.name))
    return propagate(scene, clicks, segmenter, config, reporter), clicks, segmenter


def choose_segmenter(config: Config, folder: Path, warn: Callable[[str], None] = log.warning) -> Segmenter:
    """Make the segmenter of the option ``segmenter``; auto takes EfficientSAM if its weights are installed.

    Args:
        config: of the job: segmenter, weights, device, threads.
        folder: embeddings of photos are cached in its subfolder ``embeddings``.
        warn: called with one sentence when a GPU provider fails and the CPU goes on.

    Raises:
        BadInput: EfficientSAM is asked for and its weights are missing or damaged.
    """
    drawing = config.algorithm(MaskDrawingOptions)
    if config.segmenter == "random_walker":
        return RandomWalker(drawing)
    where = Path(config.weights) if config.weights else default_folder()
    weights = find_weights(where)
    if weights is None:
        if config.segmenter == "efficientsam":
            raise BadInput(missing_text(where))
        return RandomWalker(drawing)
    threads = config.threads or cores()
    gpu = config.device != "cpu"
    return EfficientSam(weights[1], weights[2], folder / "embeddings", threads, gpu, warn, drawing)


def _all_building(scene: Scene) -> Propagation:
    """Make full masks, with every pixel and every point on the building, for ``use_masks`` off."""
    labels = tuple(np.full((v.height, v.width), BUILDING, np.uint8) for v in scene.views)
    count = len(scene.views)
    masks = MaskSet(labels, np.ones(count, bool), np.ones(count, np.float32), np.ones(len(scene.points), bool))
    return Propagation(masks, [""] * count, [], 1.0)


def _user_masks(scene: Scene, masks_folder: Path, config: Config) -> Propagation:
    """Read and check the user's masks; photos without a mask are not used in training."""
    given = read_user_masks(masks_folder, scene)
    labels, reasons = [], []
    for view, mask in zip(scene.views, given, strict=True):
        labels.append(np.zeros((view.height, view.width), np.uint8) if mask is None else mask)
        reasons.append("no mask was given" if mask is None else "" if building(mask).any() else "the mask is empty")
    used = np.array([not r for r in reasons])
    cross_view, votes = config.algorithm(CrossViewOptions), config.algorithm(VoteOptions)
    for index, agreement in find_contradicted_masks(scene, labels, used, votes.dilation, cross_view).items():
        reasons[index] = f"other photos' masks contradict it (agreement {agreement:.0%})"
        used[index] = False
    fit = measure_coverage(scene, labels, used, config.algorithm(CoverageOptions))
    labels = mark_ignored(scene, labels, fit)
    rows = np.arange(len(scene.points))
    voters = choose_voters(scene, np.flatnonzero(used).tolist(), (), votes)
    points = vote(scene.points, scene, labels, voters, votes, rows, config.threads)
    masks = MaskSet(tuple(labels), used, used.astype(np.float32), points)
    return Propagation(masks, reasons, describe_misfits(scene, fit), measure_consistency(scene, masks, votes.dilation))


def _second_level(
    scene: Scene,
    masks: MaskSet,
    clicks: Prompts,
    segmenter: Segmenter,
    threads: int,
    reporter: Reporter,
    options: PartOptions,
) -> tuple[MaskSet, list[Part]]:
    """Segment elements of the building in each photo, add them to the label maps, and match them across photos.

    Args:
        scene: photos, cameras and sparse points.
        masks: of the first level.
        clicks: by view index; clicks on parts name elements.
        segmenter: EfficientSAM segments the elements; with any other they are segmented by colour.
        threads: number of worker threads.
        reporter: for the request to cancel.
        options: of elements and parts.
    """
    sam = segmenter if isinstance(segmenter, EfficientSam) else None
    labels, names = [], []

    def elements(index: int) -> tuple[NDArray[np.uint8], dict[int, str]]:
        parts = clicks[index].parts if index in clicks else {}
        return add_elements(masks.labels[index], scene.photo(index), parts, sam, options)

    for _, (with_elements, named) in map_photos(scene, elements, range(len(masks.labels)), threads):
        labels.append(with_elements)
        names.append(named)
        reporter.check()
    return replace(masks, labels=tuple(labels)), match_elements(scene, labels, names, options)


def _check(scene: Scene, result: Propagation, config: Config) -> None:
    """Check that a field can be started from the masks.

    Raises:
        BadInput: no mask is used; or no sparse point lies on the building, and the start needs some or the visual hull
            of the masks is empty.
    """
    if not result.masks.used.any():
        raise BadInput("No photo got a usable mask; click more points on the building and beside it, in more photos.")
    if result.masks.point_mask.any():
        return
    if config.start == "surface" and config.use_masks:
        used = np.flatnonzero(result.masks.used).tolist()
        hull_cells(scene, result.masks, used, config.algorithm(MaskHullOptions))
    else:
        raise BadInput(
            "No sparse point lies on the building, and this start needs some: choose start=surface, or check that "
            "clicks or masks belong to these photos."
        )


def _check_clicks(clicks: Prompts, masks: MaskSet, slip: int) -> None:
    """Check that the masks contain the clicks, before minutes of training on something else.

    Raises:
        BadInput: most clicks on the building lie outside the masks of their photos.
    """
    held, count = 0, 0
    for index, photo in clicks.items():
        taken = dilate_square(masks.labels[index] != BACKGROUND, slip)
        held += int(taken[pixel_at(taken.shape, photo.positive)].sum())
        count += len(photo.positive)
    if 2 * held < count:
        raise BadInput(
            f"The masks miss {count - held} of the {count} clicks on the building. Check the contact sheet, "
            "then add clicks on the building and beside it in more photos."
        )


def _warn(result: Propagation, scene: Scene, reporter: Reporter) -> None:
    """Warn of masks that are left out, and of what else was noticed on the way."""
    for text in result.warnings:
        reporter.warning(text)
    for text in describe_flags([view.name for view in scene.views], result.reasons):
        reporter.warning(text)


def _warn_of_building(scene: Scene, masks: MaskSet, config: Config, reporter: Reporter) -> None:
    """Warn where the building is small in the working photos, or much of it has no texture."""
    small = small_building_warning(scene, masks, config.algorithm(BuildingSizeOptions))
    if small is not None:
        reporter.warning(small)
    textures = config.algorithm(LowTextureOptions)
    plain = low_texture_share(scene, masks, textures)
    if plain > textures.warn_above:
        reporter.warning(low_texture_warning(plain))
