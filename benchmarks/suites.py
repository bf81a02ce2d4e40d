# SPDX-License-Identifier: GPL-3.0-or-later
"""The suites of measurements as data: which scenes, which variants, which seeds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from benchmarks.catalogue import SCENES, SURFACES
from mgf_engine import __version__
from mgf_engine.errors import BadInput
from mgf_engine.options.config import RUN_LENGTH, Config
from mgf_engine.options.presets import PRESETS

Options = dict[str, Any]

#: Raise when the way runs are scored changes, so that earlier results are not mixed with new ones.
SCORING_VERSION = 4


@dataclass(frozen=True)
class Run:
    """One reconstruction to measure.

    Attributes:
        variant: what is different about it, as shown in tables.
        scene: name in :data:`benchmarks.catalogue.SCENES`, or a folder with COLMAP model and prompts.
        options: engine options, name -> value.
        masks: ``prompts`` (clicks, as a user works), ``true`` (the generator's masks, without a second level) or ``true
            elements`` (these with the generator's elements as their second level).
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
_NO_LOSSES: Options = {"multilevel_loss": False, "boundary_loss": False}
#: The paper's tables 5 and 6: what is changed, one thing at a time, in its own letters.
ABLATION: dict[str, Options] = {
    "(e) full": {},
    "(a) no masked images": {"masked_images": False},
    "(b) no masked points": {"masked_points": False},
    "(c) no mask and boundary losses": _NO_LOSSES,
    "(d) no screening": {"screening": False},
}
#: What goes beside it: further votes of the masks apart, and masks that are true.
MASK_PARTS: dict[str, Options] = {
    "no votes during training": {"training_votes": False},
    "no votes on faces": {"face_votes": False},
    "no second level": {"second_level": "off"},  # so that the building is the only mask of eq. 19
}
#: What the paper's setting gains by parts of ours, one at a time. The last three change the mesh stage alone; the last
#: compares eq. 23-25 with fused depths, each at the level of the sparse points.
PARTS_OF_OURS: dict[str, Options] = {
    "started on our surface": {"start": "surface"},
    "background beside the building kept empty": {"background_lambda": 0.02},
    "level of the sparse points": {"calibrate_level": True},
    "fused depths": {"surface": "fused"},
    "fused depths at the level of the sparse points": {"surface": "fused", "calibrate_level": True},
}
#: Other readings of 7,000 iterations than a whole run, whose schedule keeps the shares of 30,000: densification that
#: never stops, and the first 7,000 of 30,000, in which the terms from 15,000 on never act.
SCHEDULES: dict[str, Options] = {
    "densification throughout": {"densify_until": 1.0},
    "beginning of a run 30/7 as long": {
        "densify_from": 0.0714, "densify_until": 1.0, "geometry_from": 1.0, "learning_rates.positions_final": 5.46e-5,
    },
}  # fmt: skip
#: Ours as the ablation starts from it, with the paper's losses on, so that (c) can take them away.
OURS: Options = {"preset": "standard", **_LOSSES}
#: Suites of the tables 5 and 6 -> group of their runs and setting that they start from; None for the paper's.
ABLATED: dict[str, tuple[str, Options | None]] = {"ablation": ("paper", None), "ablation-ours": ("ours", OURS)}
_STEPS_OFF: Options = {"match_photos": False, "refine_rounds": 0}
#: What eq. 25 costs or gains by itself: either surface at the level that sparse points calibrate.
EQUAL_TERMS: dict[str, Options] = {
    "opacity, photo steps off": {"surface": "opacity", **_STEPS_OFF},
    "fused, photo steps off": {"surface": "fused", **_STEPS_OFF},
    "opacity, photo steps on": {"surface": "opacity"},
    "fused, photo steps on": {"surface": "fused"},
}
#: Iterations after which the field is meshed; 0 is the start alone.
TRAINED = (0, 100, 500, 1000, 3000, 7000)
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
    "preset": "paper", "use_masks": False, "masked_points": False, "screening": False, "second_level": "off",
    **_NO_LOSSES,
}  # fmt: skip
#: Our engine set up the way the methods the paper compares with work, without photo steps. 3DGS makes no mesh; its
#: Gaussians are meshed like those of GOF.
LIKE: dict[str, Options] = {
    "GOF-like": _UNMASKED,
    "2DGS-like": {
        **_UNMASKED, "filter_3d": False, "geometry_from": 0.23, "distortion_lambda": 1000.0, "surface": "fused",
        "densify_by": "gradient",
    },
    "3DGS-like": {
        **_UNMASKED, "filter_3d": False, "prune_opacity": 0.005, "distortion_lambda": 0.0, "normal_lambda": 0.0,
        "densify_by": "gradient",
    },
}  # fmt: skip
#: Training iterations of the paper's method and of the longer runs that it compares with.
PRINTED, LONGER = 7000, 30_000
NAMED = ("steel_frame_hall", "brick_ensemble")
#: Groups whose settings are no steps of one quantity begin so; charts do not join their points.
SETTINGS_APART = ("ablation", "paper", "ours")
SUITES: dict[str, str] = {
    "smoke": "one short run on a tiny scene, for continuous integration",
    "equal-terms": "opacity and fused surface, each without and with photo steps",
    "training": "what training is worth: the start alone, then more and more iterations",
    "ablation": "tables 5 and 6: (a) to (f) from the paper's setting; parts of ours, true masks, schedules",
    "ablation-ours": "tables 5 and 6 from our setting: (a) to (f), the votes apart and true masks",
    "switches": "every switch of ours, one at a time",
    "resolution": "figure 8: 375, 750 and 1500 pixels",
    "peers": "tables 1 to 4: our engine set up like 3DGS, 2DGS and GOF, masks off, and any external tool",
    "surfaces": "hard materials: every preset and any external tool; accuracy by scene and by material",
    "pareto": "speed against accuracy",
}


@dataclass(frozen=True)
class SuiteSettings:
    """What a suite is measured on and with.

    Attributes:
        scenes: instead of the suite's own.
        seeds: runs per variant.
        base: options given to every run of the engine; a variant's own win.
        masks, poses: of every run, see :class:`Run`; a variant's own masks win.
        commands: external tools, name -> command (suites ``peers``, ``surfaces`` and ``pareto``).
        only: keep the variants whose name contains one of these.
        paper_iterations: of the paper's setting and of what is set up like its peers; their longer runs keep the ratio.
    """

    scenes: Sequence[str] = ()
    seeds: int = 1
    base: Options = field(default_factory=dict)
    masks: str = "prompts"
    poses: str = "sfm"
    commands: dict[str, str] = field(default_factory=dict)
    only: Sequence[str] = ()
    paper_iterations: int = PRINTED


def suite_runs(suite: str, settings: SuiteSettings = SuiteSettings()) -> list[Run]:
    """Return the runs of a suite: each scene with each variant and seed.

    Raises:
        BadInput: the suite does not exist, or nothing is left of it.
    """
    if suite not in SUITES:
        raise BadInput(f"There is no suite '{suite}'; take one of {', '.join(SUITES)}.")
    only, masks = settings.only, settings.masks
    chosen = [run for run in _variants(suite, settings) if not only or any(word in run.variant for word in only)]
    if not chosen:
        raise BadInput(f"No variant of suite '{suite}' has one of these names: {', '.join(only)}.")
    names = settings.scenes or {"smoke": ("smoke",), "surfaces": tuple(SURFACES)}.get(suite, NAMED)
    return [
        replace(run, scene=scene, seed=seed, masks=masks if run.masks == "prompts" else run.masks, poses=settings.poses)
        for scene in names
        for run in chosen
        for seed in range(settings.seeds)
    ]


def _variants(suite: str, settings: SuiteSettings) -> list[Run]:
    """Return the variants of a suite, without a scene, with the options that all runs are given."""
    base = dict(settings.base)
    if suite == "resolution":
        base.pop("resolution", None)  # which the suite changes
    if suite == "smoke":
        small = {"preset": "draft", "iterations": 200, "max_gaussians": 8000}
        return [Run("smoke", "", {**small, **base})]
    return [
        run if run.command else replace(run, options={**base, **run.options})
        for run in _own_variants(suite, base, settings.commands, settings.paper_iterations)
    ]


def paper_setting(count: int = PRINTED) -> Options:
    """Return the paper's setting, trained for so many iterations."""
    return {"preset": "paper"} if count == PRINTED else {"preset": "paper", "iterations": count}


def peers(count: int = PRINTED) -> dict[str, Options]:
    """The paper's setting, ours, and ours set up like the methods the paper compares with; with sparse and dense start.

    Args:
        count: iterations of the shorter runs; the longer ones keep the paper's ratio.
    """
    settings: dict[str, Options] = {"ours, paper": paper_setting(count), "ours, standard": {"preset": "standard"}}
    for length in (count, round(count * LONGER / PRINTED)):
        settings |= {
            f"{name}, {length} iterations, sparse start": {**like, "iterations": length} for name, like in LIKE.items()
        }
    for name, like in LIKE.items():
        settings[f"{name}, {count} iterations, dense start"] = {**like, "iterations": count, "start": "dense"}
    return settings


def half_of(runs: list[Run], held_out: bool) -> list[Run]:
    """Return the runs of the catalogue's scenes that may be tuned on, or of those that are held out.

    Raises:
        BadInput: there is none.
    """
    mine = [run for run in runs if run.scene in SCENES and SCENES[run.scene].held_out == held_out]
    if not mine:
        raise BadInput("None of the scenes is in this half; leave out --half, or take scenes of the suite surfaces.")
    return mine


def _own_variants(suite: str, base: Options, commands: dict[str, str], count: int) -> list[Run]:
    paper = paper_setting(count)
    tools = [Run(name, "", command=command, group=name) for name, command in commands.items()]
    if suite in ABLATED:
        name, start = ABLATED[suite]
        return _ablation(name, {**(start or paper), **base})
    if suite == "switches":
        return [Run(name, "", options, group="switches") for name, options in {"standard": {}, **SWITCHES}.items()]
    if suite == "equal-terms":
        return [Run(name, "", options, group=name.split(",")[0]) for name, options in EQUAL_TERMS.items()]
    if suite == "training":
        return [_trained(count, steps) for count in TRAINED for steps in ("off", "on")]
    if suite == "resolution":
        settings = {"paper's setting": paper, "standard": {"preset": "standard"}}
        own = Config().resolution
        return [Run(f"{name}, {n} px", "", setting if n == own else {**setting, "resolution": n}, group=name)
                for name, setting in settings.items() for n in (375, 750, 1500)]  # fmt: skip
    if suite == "peers":
        return [*(Run(name, "", options, group=name) for name, options in peers(count).items()), *tools]
    presets: dict[str, Options] = {**{name: {"preset": name} for name in PRESETS}, "paper": paper}
    groups = dict.fromkeys(PRESETS, "presets") | {"paper": "paper's setting"}
    runs = [Run(f"preset {name}", "", options, group=groups[name]) for name, options in presets.items()]
    if suite == "surfaces":
        return runs + tools
    for length in (500, 1000, 2000, 3000, 7000):
        runs.append(Run(f"{length} iterations", "", {"iterations": length}, group="iterations"))
    for budget in (10_000, 20_000, 40_000, 80_000, 160_000):
        runs.append(Run(f"{budget // 1000}k Gaussians", "", {"max_gaussians": budget}, group="Gaussians"))
    missing = {name: options for name, options in ABLATION.items() if options}
    group = "ablation of it: " + ", ".join(missing)
    runs += [Run(name, "", {**paper, **options}, group=group) for name, options in missing.items()]
    return [*runs, Run("GOF-like", "", {**LIKE["GOF-like"], "iterations": count}, group="GOF-like"), *tools]


def _ablation(name: str, start: Options) -> list[Run]:
    """Tables 5 and 6 from one setting."""
    count = int(start.get("iterations", PRINTED if name == "paper" else Config().run_length(RUN_LENGTH["most"])))
    longer: Options = {"iterations": round(count * LONGER / PRINTED)}
    table = {**ABLATION, "(f) 30/7 of the iterations": longer, **MASK_PARTS}
    if name == "paper":  # which has no such votes
        del table["no votes during training"], table["no votes on faces"]
        table |= PARTS_OF_OURS | SCHEDULES
    runs = [Run(f"{name}: {what}", "", {**start, **options}, group=name) for what, options in table.items()]
    kinds = {"true": "true masks, no second level", "true elements": "true masks and true elements"}
    return runs + [Run(f"{name}: {what}", "", start, masks=masks, group=name) for masks, what in kinds.items()]


def _trained(count: int, steps: str) -> Run:
    options: Options = {"iterations": count} if count else {"iterations": 0, "passes": 0}
    name = f"{count} iterations" if count else "start alone"
    photo_steps = {} if steps == "on" else _STEPS_OFF
    return Run(f"{name}, photo steps {steps}", "", {**options, **photo_steps}, group=f"photo steps {steps}")
