# SPDX-License-Identifier: GPL-3.0-or-later
"""The suites of measurements as data: which scenes, which variants, which seeds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from mgf_engine import __version__
from mgf_engine.bench.catalogue import SCENES, SURFACES
from mgf_engine.config import PRESETS, RUN_LENGTH, Config
from mgf_engine.errors import BadInput

Options = dict[str, Any]

#: Raise when the way runs are scored changes, so that earlier results are not mixed with new ones.
SCORING_VERSION = 4


@dataclass(frozen=True)
class Run:
    """One reconstruction to measure.

    Attributes:
        variant: what is different about it, as shown in tables.
        scene: name in :data:`mgf_engine.bench.catalogue.SCENES`, or a folder with COLMAP model and prompts.
        options: engine options, name -> value.
        masks: ``prompts`` (clicks, as a user works), ``true`` (the generator's masks) or ``none``.
        poses: ``sfm`` (structure from motion) or ``true`` (the generator's cameras).
        command: of an external tool, with ``{images}``, ``{scene}``, ``{mesh}`` and ``{work}``; empty runs the engine.
        group: curve of the charts it belongs to.
    """

    variant: str
    scene: str
    options: Options = field(default_factory=dict)
    seed: int = 0
    masks: str = "prompts"
    poses: str = "sfm"
    command: str = ""
    group: str = ""

    def key(self, label: str = "") -> str:
        """Hash of everything that decides the result: the run, the engine's version and a free label."""
        data = {**asdict(self), "engine": __version__, "scoring": SCORING_VERSION, "label": label}
        for name in ("variant", "group"):
            del data[name]
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:12]


_LOSSES: Options = {"multilevel_loss": True, "boundary_loss": True}
#: The paper's table 5 and 6: what is switched off, in its own letters.
ABLATION: dict[str, Options] = {
    "full": _LOSSES,  # the paper's (e); (f) trains 30/7 times as long
    "(a) no masked images": {**_LOSSES, "use_masks": False},
    "(b) no masked points": {**_LOSSES, "masked_points": False},
    "(c) no mask and boundary losses": {},  # what the figures made our default
    "(d) no screening": {**_LOSSES, "screening": False},
}
#: Our own switches, one at a time.
SWITCHES: dict[str, Options] = {
    "multi-level loss": {"multilevel_loss": True},
    "boundary loss": {"boundary_loss": True},
    "sparse start": {"start": "sparse"},
    "no coarse-to-fine": {"coarse_to_fine": False},
    "no distortion term": {"distortion_lambda": 0.0},
    "no normal term": {"normal_lambda": 0.0},
    "geometric terms from the start": {"geometry_from": 0.0},
    "background not emptied": {"background_lambda": 0.0},
    "no densification": {"densify_from": 1.0, "densify_until": 1.0},
    "surface by minimum opacity": {"surface": "opacity"},
    "surface by minimum opacity, level 0.65": {"surface": "opacity", "opacity_level": 0.65},
    "surface not smoothed": {"smoothing": 0},
}
_UNMASKED: Options = {
    "use_masks": False, "masked_points": False, "multilevel_loss": False, "boundary_loss": False, "screening": False,
    "second_level": "off", "background_lambda": 0.0, "start": "sparse", "coarse_to_fine": False,
}  # fmt: skip
#: Our engine set up the way the methods the paper compares with work.
PEERS: dict[str, Options] = {
    "masked (ours)": {},
    "GOF-like, whole picture": {**_UNMASKED, "geometry_from": 0.5},
    "2DGS-like, whole picture": {**_UNMASKED, "geometry_from": 0.23, "distortion_lambda": 1000.0},
    "3DGS-like, whole picture": {**_UNMASKED, "distortion_lambda": 0.0, "normal_lambda": 0.0},
}
NAMED = ("dortmund", "zeche")
SUITES: dict[str, str] = {
    "smoke": "one short run on a tiny scene, for continuous integration",
    "ablation": "the paper's ablations (a) to (f) and every further switch",
    "resolution": "375, 750 and 1500 pixels",
    "peers": "our engine set up like 3DGS, 2DGS and GOF, masks off, and any external tool",
    "surfaces": "hard materials: every preset and any external tool; accuracy by scene and by material",
    "pareto": "presets and budgets, and GOF-like beside them: accuracy against time, Gaussians and faces",
}


def suite_runs(
    suite: str, scenes: Sequence[str] = (), seeds: int = 1, base: Options | None = None, masks: str = "prompts",
    poses: str = "sfm", commands: dict[str, str] | None = None, only: Sequence[str] = (),
) -> list[Run]:  # fmt: skip
    """The runs of a suite.

    Args:
        scenes: instead of the suite's own.
        seeds: runs per variant.
        base: options given to every run; a variant's own win.
        commands: external tools, name -> command (suites ``peers`` and ``surfaces``).
        only: keep the variants whose name contains one of these.

    Raises:
        BadInput: the suite does not exist, or nothing is left of it.
    """
    if suite not in SUITES:
        raise BadInput(f"There is no suite '{suite}'; take one of {', '.join(SUITES)}.")
    base = dict(base or {})
    if suite == "smoke":
        small = {"preset": "draft", "iterations": 200, "max_gaussians": 8000}
        variants = [Run("smoke", "", {**small, **base})]
    else:
        variants = [replace(run, options={**base, **run.options}) for run in _variants(suite, base, commands or {})]
    chosen = [run for run in variants if not only or any(word in run.variant for word in only)]
    if not chosen:
        raise BadInput(f"No variant of suite '{suite}' has one of these names: {', '.join(only)}.")
    names = scenes or {"smoke": ("smoke",), "surfaces": tuple(SURFACES)}.get(suite, NAMED)
    return [
        replace(run, scene=scene, seed=seed, masks=masks, poses=poses)
        for scene in names
        for run in chosen
        for seed in range(seeds)
    ]


def half_of(runs: list[Run], held_out: bool) -> list[Run]:
    """The runs of the catalogue's scenes that may be tuned on, or of those that are held out.

    Raises:
        BadInput: there is none.
    """
    mine = [run for run in runs if run.scene in SCENES and SCENES[run.scene].held_out == held_out]
    if not mine:
        raise BadInput("None of the scenes is in this half; leave out --half, or take scenes of the suite surfaces.")
    return mine


def _variants(suite: str, base: Options, commands: dict[str, str]) -> list[Run]:
    tools = [Run(name, "", command=command, group=name) for name, command in commands.items()]
    if suite == "ablation":
        longer = round(int(base.get("iterations", Config().run_length(RUN_LENGTH["most"]))) * 30 / 7)
        table = {**ABLATION, "(f) 30/7 of the iterations": {**_LOSSES, "iterations": longer}, **SWITCHES}
        return [Run(name, "", options, group="ablation") for name, options in table.items()]
    if suite == "resolution":
        return [Run(f"{n} px", "", {"resolution": n}, group="resolution") for n in (375, 750, 1500)]
    if suite == "peers":
        return [*(Run(name, "", options, group=name) for name, options in PEERS.items()), *tools]
    runs = [Run(f"preset {name}", "", {"preset": name}, group="presets") for name in PRESETS]
    if suite == "surfaces":
        return runs + tools
    for count in (500, 1000, 2000, 3000, 7000):
        runs.append(Run(f"{count} iterations", "", {"iterations": count}, group="iterations"))
    for budget in (10_000, 20_000, 40_000, 80_000, 160_000):
        runs.append(Run(f"{budget // 1000}k Gaussians", "", {"max_gaussians": budget}, group="Gaussians"))
    masks_off = "GOF-like, whole picture"
    return [*runs, Run(masks_off, "", PEERS[masks_off], group=masks_off)]
