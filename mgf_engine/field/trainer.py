# SPDX-License-Identifier: GPL-3.0-or-later
"""The training loop: each iteration renders a view, computes the loss (eq. 20) and takes a step; with densification."""

from __future__ import annotations

import logging
import math
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from mgf_engine.errors import BadInput
from mgf_engine.field.checkpoint import Checkpoint, read_checkpoint, write_checkpoint, write_field
from mgf_engine.field.density import DensificationOptions, budget_at, densify_and_prune
from mgf_engine.field.filter3d import FilterOptions, update_filter
from mgf_engine.field.gradient_density import (
    GradientDensityOptions,
    mask_share,
    refine_by_gradient,
    reset_opacities,
    scene_extent,
)
from mgf_engine.field.losses import LossOptions, LossTerms, total_loss
from mgf_engine.field.optimiser import Optimiser
from mgf_engine.field.schedule import (
    LearningRates,
    ScheduleOptions,
    covers_all_views,
    geometry_at,
    lr_scale_of,
    rates_at,
    reduction_at,
    sh_degree_at,
    view_order,
    work_at,
)
from mgf_engine.field.start import start_field
from mgf_engine.field.targets import Target, TargetOptions, make_target
from mgf_engine.masks.points import VoteOptions, choose_voters, vote
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import Config
from mgf_engine.raster.api import Rendering, RenderStats, render
from mgf_engine.raster.device import capacity_state, choose_device, lost_renderings, restore_capacity
from mgf_engine.system.machine import cores

log = logging.getLogger("mgf")
CHECKPOINT = "training.npz"
_PREVIEW_SECONDS = 15.0
_CURVE_POINTS = 200


def train(
    scene: Scene, masks: MaskSet, config: Config, folder: Path, reporter: Reporter
) -> tuple[Gaussians, dict[str, Any]]:
    """Train the field of a building.

    Args:
        scene: photos, cameras and sparse points.
        masks: the building in each photo.
        config: of the job.
        folder: where checkpoints go; training resumes from the one it finds.
        reporter: for progress, warnings and the request to cancel.

    Returns:
        The field in the normalised frame and the figures for the report.

    Raises:
        BadInput: no photo is left to train on, or too few points lie on the building.
        Cancelled: asked to stop; a checkpoint was written first.
    """
    return _Trainer(scene, masks, config, folder, reporter).run()


class _Trainer:
    def __init__(self, scene: Scene, masks: MaskSet, config: Config, folder: Path, reporter: Reporter) -> None:
        self.scene, self.masks, self.config, self.folder, self.reporter = scene, masks, config, folder, reporter
        folder.mkdir(parents=True, exist_ok=True)
        self.views = training_views(scene, masks)
        self.votes = config.algorithm(VoteOptions)
        self.voters = choose_voters(scene, self.views, masks.clicked, self.votes)
        self.total = config.run_length(len(self.views))
        self.extent = scene_extent([scene.views[i] for i in self.views])
        self.rates = config.algorithm(LearningRates).for_extent(self.extent)
        self.schedule = config.algorithm(ScheduleOptions)
        self.densification, self.losses = config.algorithm(DensificationOptions), config.algorithm(LossOptions)
        self.target_options = config.algorithm(TargetOptions)
        self.gradients = config.algorithm(GradientDensityOptions)
        share_matters = config.densify_by != "error" and config.masked_images
        self.covered = mask_share([masks.labels[i] for i in self.views]) if share_matters else 1.0
        self.lr_scale = lr_scale_of(self.total, Config().run_length(len(self.views)), self.rates)
        self.longest_side = max(max(v.width, v.height) for v in scene.views)
        self.targets: dict[int, Target | None] = {}
        self.factor = 0
        self.device = choose_device(config.device).device
        self.seconds: dict[str, float] = defaultdict(float)
        self.checkpoint_path = folder / CHECKPOINT
        found = read_checkpoint(self.checkpoint_path)
        if found is None:
            if self.checkpoint_path.exists():
                reporter.warning("The checkpoint of the field is damaged; training starts over.")
            field = start_field(scene, masks, self.views, config, folder, reporter)
            self._update_filter(field)
            figures = {"start_gaussians": len(field), "curve": [], "seconds": {}}
            found = Checkpoint(Optimiser(field), RenderStats.zeros(len(field)), 0, figures)
        self.optimiser, self.stats = found.optimiser.to(self.device), found.stats.to(self.device)
        self.iteration, self.figures = found.iteration, found.figures
        restore_capacity(self.device, self.figures.get("tile_list_capacity"))
        self.seconds.update(self.figures["seconds"])

    def run(self) -> tuple[Gaussians, dict[str, Any]]:
        config = self.config
        saved = shown = time.monotonic()
        order: list[int] = []
        while self.iteration < self.total:
            share = self.iteration / self.total
            self._set_level(reduction_at(share, self.longest_side, self.schedule))
            epoch, place = divmod(self.iteration, len(self.views))
            if place == 0 or not order:
                order = view_order(len(self.views), epoch, config.seed)
            target = self._target(self.views[order[place]])
            if target is not None:
                rendering, terms = self._step(target, share)
                self._record(target, rendering, terms)
            self.iteration += 1
            if self.iteration % self.densification.densify_every == 0:
                self._refine(share)
            self._reset_opacities(share)
            now = time.monotonic()
            if now - saved > config.checkpoint_seconds or self.reporter.cancelled:
                self._save()
                saved = now
            if target is not None and now - shown > _PREVIEW_SECONDS:
                self._preview(target, rendering)
                shown = now
            self._report(share)
        field = self.optimiser.field.to(torch.device("cpu"))
        self._save()  # a stop between here and the end of the stage costs no training
        write_field(field, self.folder / "field.npz")
        return field, self._final_figures()

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - started

    def _set_level(self, factor: int) -> None:
        if factor != self.factor:
            self.factor, self.targets = factor, {}

    def _target(self, view: int) -> Target | None:
        if view not in self.targets:
            with self._timed("targets"):
                photo, labels = self.scene.photo(view), self.masks.labels[view]
                target = make_target(photo, labels, self.scene.views[view], self.factor, self.target_options)
                self.targets[view] = None if target is None else target.to(self.device)
        return self.targets[view]

    def _step(self, target: Target, share: float) -> tuple[Rendering, LossTerms]:
        config = self.config
        geometry = geometry_at(self.iteration, share, self.schedule)
        generator = torch.Generator().manual_seed(config.seed * 7_919 + self.iteration)
        backdrop = torch.rand(3, generator=generator) if config.random_background else torch.zeros(3)
        error_map = torch.zeros(target.camera.height, target.camera.width, device=self.device)
        with self._timed("render"):
            rendering = render(
                self.optimiser.leaves(), target.camera, sh_degree=sh_degree_at(share, self.schedule),
                tile_mask=target.tile_mask, stats=self.stats, error_map=error_map,
                outputs="all" if geometry else "basic", wait=False,
            )  # fmt: skip
        with self._timed("losses"):
            terms = total_loss(rendering, target, self.losses, backdrop, geometry, error_map)
        with self._timed("backward"):
            terms.total.backward()
        with self._timed("optimiser"):
            rates, of_constant = rates_at(share, self.lr_scale, self.rates), self.rates.sh_rest / self.rates.sh_constant
            self.optimiser.step(rates, rendering.visible, of_constant)
        return rendering, terms

    def _refine(self, share: float) -> None:
        options, field = self.densification, self.optimiser.field
        with self._timed("density"):
            keep = torch.ones(len(field), dtype=torch.bool, device=self.device)
            voting = self.config.use_masks and options.use_votes
            if voting and self.iteration // options.densify_every % options.vote_every == 0:
                keep = self._mask_vote(field)
            grow = options.densify_from <= share < options.densify_until
            if self.config.densify_by == "error":
                self._refine_by_error(keep, share, grow)
            elif grow:
                generator = torch.Generator().manual_seed(self.config.seed * 7_919 + self.iteration)
                refine_by_gradient(
                    self.optimiser, self.stats, keep, self.extent, self.covered, generator, self.gradients
                )
            if len(self.optimiser.field) == 0:
                raise BadInput("All Gaussians were pruned: none explains the masks; check the masks and the cameras.")
            self._update_filter(self.optimiser.field)
            self.stats = RenderStats.zeros(len(self.optimiser.field), self.device)

    def _reset_opacities(self, share: float) -> None:
        every, until = self.gradients.reset_every, self.densification.densify_until
        if self.config.densify_by != "error" and every and self.iteration % every == 0 and share < until:
            reset_opacities(self.optimiser, self.gradients.reset_opacity)

    def _refine_by_error(self, keep: torch.Tensor, share: float, grow: bool) -> None:
        options = self.densification
        budget = budget_at(share, self.figures["start_gaussians"], options)
        first = self.iteration - options.densify_every
        complete = covers_all_views(first, self.iteration, len(self.views), self.config.seed)
        densify_and_prune(self.optimiser, self.stats, keep, budget, grow, options, prune_unseen=complete)

    def _update_filter(self, field: Gaussians) -> None:
        if not self.config.filter_3d:
            field.filter_3d = torch.zeros_like(field.filter_3d)
            return
        views = [self.scene.views[i] for i in self.views]
        update_filter(field, views, self.config.threads or cores(), self.config.algorithm(FilterOptions))

    def _mask_vote(self, field: Gaussians) -> torch.Tensor:
        points = field.positions.detach().double().cpu().numpy()
        keep = vote(points, self.scene, self.masks, self.voters, self.votes, threads=self.config.threads)
        return torch.from_numpy(keep).to(self.device)

    def _record(self, target: Target, rendering: Rendering, terms: LossTerms) -> None:
        interval = max(1, self.total // _CURVE_POINTS)
        if self.iteration % interval:
            return
        with torch.no_grad():
            pixels = target.pixels()
            difference = (target.crop(rendering.color).cpu() - pixels.photo) * pixels.inside
            mse = float((difference**2).sum() / (3 * pixels.inside.sum()))
        self.figures["curve"].append({
            "iteration": self.iteration,
            "psnr": round(-10 * math.log10(max(mse, 1e-10)), 3),
            "loss": round(float(terms.total.detach()), 5),
            "gaussians": len(self.optimiser.field),
            "seconds": round(sum(self.seconds.values()), 2),
        })  # fmt: skip

    def _report(self, share: float) -> None:
        curve = self.figures["curve"][-5:]
        psnr = float(np.mean([p["psnr"] for p in curve])) if curve else 0.0
        elapsed = sum(self.seconds.values())
        work = work_at(self.iteration / self.total, self.longest_side, self.schedule)
        left = elapsed * (1 / work - 1) if share > 0.01 else None
        self.reporter.progress(
            self.iteration / self.total, left, iteration=self.iteration,
            gaussians=len(self.optimiser.field), psnr=round(psnr, 2),
        )  # fmt: skip

    def _save(self) -> None:
        self.figures |= {"seconds": dict(self.seconds), "tile_list_capacity": capacity_state(self.device)}
        write_checkpoint(Checkpoint(self.optimiser, self.stats, self.iteration, self.figures), self.checkpoint_path)

    def _preview(self, target: Target, rendering: Rendering) -> None:
        path = self.folder / "preview.jpg"
        color = target.crop(rendering.color).detach().clamp(0, 1).cpu().numpy().transpose(1, 2, 0)
        side_by_side = np.concatenate([target.pixels().photo.numpy().transpose(1, 2, 0), color], 1)
        picture = (side_by_side[:, :, ::-1] * 255).astype(np.uint8)
        path.write_bytes(cv2.imencode(".jpg", picture)[1].tobytes())
        self.reporter.preview(str(path), f"Iteration {self.iteration}: photo and render")

    def _final_figures(self) -> dict[str, Any]:
        seconds = {name: round(value, 2) for name, value in self.seconds.items()}
        lost = lost_renderings(self.device)
        if lost:
            log.info("field: %d iterations changed nothing, since their tile lists had too little capacity", lost)
        return {
            "gaussians": len(self.optimiser.field),
            "iterations": self.iteration,
            "start_gaussians": self.figures["start_gaussians"],
            "curve": self.figures["curve"],
            "seconds_per_part": seconds,
        }


def training_views(scene: Scene, masks: MaskSet) -> list[int]:
    """Return views with a mask worth training on that are not held out.

    Raises:
        BadInput: none is left.
    """
    held_out = set(scene.held_out)
    views = [i for i in range(len(scene.views)) if masks.used[i] and i not in held_out]
    if not views:
        raise BadInput("No photo has a usable mask; add clicks on the building or give masks with --masks.")
    return views
