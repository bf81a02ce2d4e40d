# SPDX-License-Identifier: GPL-3.0-or-later
"""Every option of a job, written once.

:class:`Config` feeds the command line, the job file, the panel in Blender (through ``mgf options``, a JSON
schema made from it) and the presets. Each field carries its section, one sentence of help and its limits.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from mgf_engine.costs import COSTS
from mgf_engine.errors import BadInput

SECTIONS = ("run", "scene", "masks", "field", "mesh", "deliver", "georef")
#: Fewer photos are trained on for as long as so many, and more are too. The surface is best after some tens of passes
#: over the photos; then the field goes on to explain what mirrors, and digs dents behind panes.
RUN_LENGTH = {"fewest": 20, "most": 60}


def option(
    default: Any,
    section: str,
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    unit: str = "",
    advanced: bool = True,
) -> Any:
    """A dataclass field with its section, help sentence and limits as metadata."""
    return field(
        default=default,
        metadata={
            "section": section, "help": help, "low": low, "high": high, "choices": choices, "unit": unit,
            "advanced": advanced,
        },
    )  # fmt: skip


@dataclass(frozen=True)
class Config:
    """All options of one job; see each field's help. Build with :func:`make_config`, which validates."""

    # fmt: off
    # run
    preset: str = option("standard", "run", "How much time to spend", choices=("quick", "draft", "standard", "fine", "paper"), advanced=False)
    device: str = option("auto", "run", "Where the field is trained", choices=("auto", "cpu", "cuda"), advanced=False)
    threads: int = option(0, "run", "Worker threads of the kernels; 0 takes every core", low=0, high=256)
    memory: float = option(0.0, "run", "Memory that the job may use; 0 takes three quarters of what is free at its start", low=0, high=100_000, unit="GB", advanced=False)
    seed: int = option(0, "run", "Seed of everything random; the same seed and thread count give the same mesh", low=0, high=2**31 - 1)
    checkpoint_seconds: float = option(60.0, "run", "Time between two checkpoints of the field", low=1, high=86400, unit="s")

    # scene
    resolution: int = option(750, "scene", "Longest side of the photos while working", low=64, high=8192, unit="px", advanced=False)
    max_photos: int = option(0, "scene", "Use at most so many photos: those with clicks, and what is spread out best beside them; 0 uses all", low=0, high=100_000)
    even_exposure: bool = option(True, "scene", "Bring all photos to one exposure and white balance by the points they share")
    matching: str = option("auto", "scene", "How photos without a COLMAP model are matched", choices=("auto", "exhaustive", "sequential"))

    # masks
    use_masks: bool = option(True, "masks", "Train inside the building masks only; off models the whole picture (ablation a)")
    masked_points: bool = option(True, "masks", "Start from the points on the building only (ablation b)")
    segmenter: str = option("auto", "masks", "What draws the masks", choices=("auto", "random_walker", "efficientsam"))
    weights: str = option("", "masks", "Folder with the EfficientSAM weights; empty takes the user's cache folder")
    second_level: str = option("auto", "masks", "Find elements inside the building (windows, doors, wall fields); auto: where a part was clicked or a loss uses them", choices=("auto", "on", "off"))
    voters: str = option("all", "masks", "Whose masks vote on points and Gaussians, eq. 3 and 22: those of all photos, or of the root images alone", choices=("all", "roots"))
    strict_vote: bool = option(False, "masks", "Eq. 3 read literally: a point must lie in every root mask")
    vote_tolerance: float = option(0.1, "masks", "Share of root images that may vote against a point", low=0, high=1)
    vote_dilation: int = option(3, "masks", "Masks grow by this much before points are tested against them", low=0, high=100, unit="px")

    mask_margin: float = option(0.008, "masks", "Rim of background that is trained along with the building, as a share of the photo's longest side", low=0, high=0.2)

    # field
    iterations: int = option(0, "field", "Training iterations; 0 takes as many as the passes over the photos come to", low=0, high=1_000_000)
    passes: int = option(50, "field", "Iterations for each photo trained on, as for 20 photos where there are fewer and 60 where there are more; 0 trains nothing and keeps the start", low=0, high=1000)
    holdout_every: int = option(8, "field", "Every n-th photo is kept out of training to measure the result; 0 trains on all", low=0, high=1000)
    max_gaussians: int = option(120_000, "field", "The field never grows beyond this many Gaussians", low=100, high=10_000_000)
    start: str = option("surface", "field", "Where the first Gaussians lie: on a starting surface from edges, planes and stereo, on dense points by stereo, or on sparse points alone", choices=("surface", "dense", "sparse"))
    sh_degree: int = option(2, "field", "Degree of the spherical harmonics that make colour depend on the view", low=0, high=3)
    coarse_to_fine: bool = option(True, "field", "Start on small pictures and end at the full working resolution")
    filter_3d: bool = option(True, "field", "Keep every Gaussian at least as large as the finest photo can show")
    random_background: bool = option(True, "field", "Train before another colour in each iteration; off trains before black")
    multilevel_loss: bool = option(False, "field", "Multi-level perceptual mask loss, eq. 18-19; off uses the plain RGB loss, eq. 16 (ablation c)")
    boundary_loss: bool = option(False, "field", "Boundary loss, eq. 17; off gives its share to the other colour term (ablation c)")
    l1_weight: float = option(0.8, "field", "Weight of the L1 term in eq. 16-18", low=0, high=1)
    ssim_weight: float = option(0.2, "field", "Weight of the SSIM term in eq. 16-18", low=0, high=1)
    boundary_weight: float = option(10.0, "field", "w_edge of eq. 12: weight of pixels on mask boundaries", low=1, high=1000)
    multilevel_lambda: float = option(0.5, "field", "Lambda 1 of eq. 20, multi-level perceptual mask loss", low=0, high=1000)
    boundary_lambda: float = option(0.5, "field", "Lambda 2 of eq. 20, boundary loss", low=0, high=1000)
    distortion_lambda: float = option(100.0, "field", "Lambda 3 of eq. 20, depth distortion", low=0, high=100000)
    normal_lambda: float = option(0.05, "field", "Lambda 4 of eq. 20, normal consistency", low=0, high=1000)
    geometry_from: float = option(0.4, "field", "Share of the run after which distortion and normal terms act", low=0, high=1)
    geometry_every: int = option(3, "field", "Distortion and normal terms act in every n-th iteration, n times as strongly", low=1, high=100)
    background_lambda: float = option(0.02, "field", "Weight that empties certain background around the building", low=0, high=1000)
    densify_from: float = option(0.05, "field", "Share of the run after which Gaussians are added", low=0, high=1)
    densify_until: float = option(0.6, "field", "Share of the run after which no Gaussian is added", low=0, high=1)
    densify_every: int = option(100, "field", "Iterations between two rounds of adding and pruning", low=1, high=100000)
    training_votes: bool = option(True, "field", "Drop Gaussians that the masks vote against during training, too")
    prune_opacity: float = option(0.02, "field", "Gaussians fainter than this are dropped", low=0, high=1)

    # mesh
    screening: bool = option(True, "mesh", "Drop Gaussians that the root masks vote against, eq. 21-22 (ablation d)")
    screening_dilation: int = option(1, "mesh", "Masks grow by this much before Gaussians are screened and views judge what is solid", low=0, high=100, unit="px")
    visual_hull: bool = option(True, "mesh", "What several masks call background is free, whatever the field says")
    surface: str = option("fused", "mesh", "Where the surface lies: 'fused' is the mean of all views' depths, 'opacity' the minimum over views, eq. 25", choices=("fused", "opacity"))
    match_photos: bool = option(True, "mesh", "Move the surface to where neighbouring photos look most alike")
    depth_smoothing: float = option(20.0, "mesh", "Weight of the second differences of matched depth maps beside what photos tell of each depth; 0 leaves them as matched (with match_photos only)", low=0, high=10_000)
    refine_rounds: int = option(1, "mesh", "Times the finished mesh is moved to where the photos agree about it (with match_photos only)", low=0, high=10)
    calibrate_level: bool = option(True, "mesh", "Take the surface at the level on which the surest sparse points lie")
    opacity_level: float = option(0.5, "mesh", "Opacity at which the surface is taken, eq. 26, unless sparse points calibrate it (surface 'opacity' only)", low=0.01, high=0.99)
    level_steps: int = option(8, "mesh", "Points tried at most on each edge that crosses the surface", low=0, high=16)
    merge_flat: bool = option(True, "mesh", "Keep one vertex per cell where the raw surface is flat")
    drop_unseen: bool = option(True, "mesh", "Drop parts that no photo shows: shadows behind the building, bubbles, and what stands apart from all clicks")
    face_votes: bool = option(True, "mesh", "Cut away faces that the masks of most photos call background, pixel by pixel")
    fill_holes: bool = option(True, "mesh", "Close small holes that no photo looks through")
    span_dents: bool = option(True, "mesh", "Span dents that no photo confirms from their rims")
    smoothing: int = option(2, "mesh", "Rounds of smoothing, each over the next vertices only; 0 keeps the raw surface", low=0, high=1000)
    flatten: bool = option(True, "mesh", "Move what lies in a plane but for noise into it, and vertices between planes onto their edge")
    face_error: float = option(0.25, "mesh", "Leave out faces as long as the surface stays this near to the full one, in pixels of the nearest photo; 0 only keeps to max_faces", low=0, high=100, unit="px")
    color_error: float = option(8.0, "mesh", "Leave out faces as long as vertex colours stay this near to those of the full mesh (root mean square); 256 lets shape alone decide", low=0, high=256, unit="grey levels")
    max_faces: int = option(1_000_000, "mesh", "The mesh never has more faces than this, colours and shape give way, in this order; 0 for no limit", low=0, high=100_000_000, advanced=False)
    min_component: float = option(0.01, "mesh", "Parts with a smaller share of the largest part's area, or of its pixels in the photos, are dropped", low=0, high=1)
    crop_box: str = option("", "mesh", "Mesh only what lies in this box of the scene: 6 numbers (lowest and highest corner), 16 (matrix from the cube -1..1, row by row) or a file of them; empty for no limit")
    close_bottom: bool = option(False, "mesh", "Close the hole where the building meets the ground")

    # deliver
    texture: bool = option(True, "deliver", "Paint the mesh with a texture made from the photos as they were taken; Blender, OBJ and GLB show it", advanced=False)
    texture_size: int = option(4096, "deliver", "Longest side of the texture at most; it is smaller where the photos show no more", low=256, high=16384, unit="px")
    export_obj: bool = option(False, "deliver", "Write mesh.obj beside mesh.ply")
    export_glb: bool = option(False, "deliver", "Write mesh.glb beside mesh.ply")
    render_all: bool = option(False, "deliver", "Render every photo's view, not only the held-out ones")

    # georef
    gps: str = option("auto", "georef", "Take metres, up and north from the GPS of the photos, where four or more have one and they are not on a line", choices=("auto", "off"))
    crs: str = option("", "georef", "Coordinate reference system of the results, such as EPSG:25832, or auto for the UTM zone; empty for a local frame in metres")
    control: str = option("", "georef", "File of control and check points: name, east, north, height, accuracy, role (CSV, Metashape's or OpenDroneMap's)")
    marks: str = option("", "georef", "File that tells where points appear in photos: name, photo, x, y in pixels of the photo as taken (CSV)")
    scale_bars: str = option("", "georef", "File of distances between marked points: from, to, metres (CSV)")
    control_adjust: bool = option(True, "georef", "Control points move the cameras as well (bundle adjustment); off only lays the scene onto them")
    # fmt: on

    def wants_elements(self, parts_clicked: bool) -> bool:
        """Whether anything will use the second level of the masks."""
        used = parts_clicked or self.multilevel_loss or self.boundary_loss
        return self.second_level == "on" or (self.second_level == "auto" and used)

    def run_length(self, photos: int) -> int:
        """Iterations of a training on so many photos."""
        return self.iterations or self.passes * min(RUN_LENGTH["most"], max(RUN_LENGTH["fewest"], photos))


#: What each preset changes from the defaults; options the user gives win over both.
PRESETS: dict[str, dict[str, Any]] = {
    "quick": {"passes": 0, "max_photos": 60, "holdout_every": 0},
    "draft": {"passes": 13, "max_photos": 60, "holdout_every": 0, "densify_every": 75},
    "standard": {},
    "fine": {"max_gaussians": 400_000, "resolution": 1500, "sh_degree": 3, "refine_rounds": 2},
    # What sections 3 and 4.1 of the paper print, and nothing of ours; tests/test_paper_preset.py names the places. Where
    # the paper prints nothing, 3DGS and GOF, which it builds on: degree of the harmonics, growth and pruning, the share
    # of the run from which the geometry terms act.
    "paper": {
        "iterations": 7000,
        "resolution": 750,
        "even_exposure": False,
        "second_level": "on",
        "voters": "roots",
        "vote_dilation": 0,
        "mask_margin": 0.0,
        "start": "sparse",
        "sh_degree": 3,
        "coarse_to_fine": False,
        "filter_3d": False,
        "random_background": False,
        "multilevel_loss": True,
        "boundary_loss": True,
        "geometry_from": 0.5,
        "geometry_every": 1,
        "background_lambda": 0.0,
        "densify_from": 0.0167,
        "densify_until": 0.5,
        "densify_every": 100,
        "training_votes": False,
        "prune_opacity": 0.005,
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
        "face_error": 0.0,
        "min_component": 0.0,
        "texture": False,
    },
}
#: What a preset is, where the values that it sets would say little.
PRESET_HELP = {"paper": "The method as the paper prints it, and nothing of ours: to compare with"}
#: Option -> value it had in an earlier version -> value it has now; taken for one version, with a warning.
RENAMED: dict[str, dict[str, str]] = {"segmenter": {"grabcut": "random_walker"}}
_SWITCH = {"true": True, "on": True, "yes": True, "1": True, "false": False, "off": False, "no": False, "0": False}


def make_config(given: dict[str, Any] | None = None) -> Config:
    """A validated config: defaults, then the preset, then what the user gave.

    Args:
        given: option name -> value; text is converted to the option's type.

    Raises:
        BadInput: an unknown option, a value of the wrong type or outside its limits.
    """
    given = {k: v for k, v in (given or {}).items() if v is not None}
    known = {f.name: f for f in fields(Config)}
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise BadInput(f"Unknown option '{unknown[0]}'; 'mgf options' lists every option.")
    values = {name: _convert(known[name], value) for name, value in given.items()}
    preset = values.get("preset", Config.preset)
    config = replace(Config(), **{**PRESETS[preset], **values})
    if config.densify_from > config.densify_until:
        raise BadInput("densify_from must not be larger than densify_until; swap the two shares.")
    if 0 < config.max_photos < 3:
        raise BadInput("max_photos must be at least 3, or 0 to use all photos.")
    return config


def option_pairs(texts: Sequence[str]) -> dict[str, str]:
    """Options from texts NAME=VALUE as ``--set`` takes them, not converted yet.

    Raises:
        BadInput: a text is no such pair.
    """
    return {name.replace("-", "_"): value for name, value in named_values("--set", texts).items()}


def named_values(flag: str, texts: Sequence[str]) -> dict[str, str]:
    """Texts NAME=VALUE given with a flag, as name -> value.

    Raises:
        BadInput: a text is no such pair.
    """
    result = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise BadInput(f"{flag} takes NAME=VALUE, not '{text}'.")
        result[name.strip()] = value.strip()
    return result


def read_config(path: Path) -> dict[str, Any]:
    """Options from a JSON file (an object of option names and values).

    Raises:
        BadInput: the file cannot be read or is not a JSON object.
    """
    try:
        given = json.loads(path.read_text(encoding="utf-8-sig"))  # editors on Windows begin with a mark
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(
            f"Cannot read the config '{path}' ({error}); give a JSON file of option names and values."
        ) from error
    if not isinstance(given, dict):
        raise BadInput(f"The config '{path}' must be a JSON object of option names and values.")
    return given


def options_schema() -> dict[str, Any]:
    """All about the options as plain data, for panels and other front ends; ``options`` has an entry for each."""
    entries = [
        {"name": f.name, "type": type(f.default).__name__, "default": f.default, **f.metadata} for f in fields(Config)
    ]
    return {
        "sections": list(SECTIONS), "presets": PRESETS, "preset_help": PRESET_HELP, "run_length": RUN_LENGTH, "costs": COSTS,
        "options": entries,
    }  # fmt: skip


def renamed_values(given: dict[str, Any]) -> list[str]:
    """A sentence for each value that :data:`RENAMED` still takes."""
    return [
        f"{name}={value} is called {name}={RENAMED[name][value]} now; the old value works in this version only."
        for name, value in given.items()
        if isinstance(value, str) and value in RENAMED.get(name, {})
    ]


def as_dict(config: Config) -> dict[str, Any]:
    """The config as plain data for the job file and the report."""
    return asdict(config)


def _convert(spec: Any, value: Any) -> Any:
    """``value`` in the option's own type, checked against its limits."""
    kind, meta = type(spec.default), spec.metadata
    try:
        result = _parse(kind, value)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"Option {spec.name} takes {_kind_name(kind)}, not '{_shown(value)}'.") from error
    result = RENAMED.get(spec.name, {}).get(result, result) if isinstance(result, str) else result
    if meta["choices"] and result not in meta["choices"]:
        raise BadInput(f"Option {spec.name} is one of {', '.join(meta['choices'])}, not '{_shown(value)}'.")
    for limit, wrong in ((meta["low"], "at least"), (meta["high"], "at most")):
        if limit is not None and (result < limit if wrong == "at least" else result > limit):
            raise BadInput(f"Option {spec.name} must be {wrong} {limit:g}, not {_shown(value)}.")
    return result


def _shown(value: Any) -> str:
    """A value as a sentence can hold it."""
    text = str(value) if not isinstance(value, int) or abs(value) < 10**50 else "a number of many digits"
    return text if len(text) <= 60 else text[:57] + "..."


def _parse(kind: type, value: Any) -> Any:
    if kind is bool:
        key = str(value).strip().lower()
        if key not in _SWITCH:
            raise ValueError(value)
        return _SWITCH[key]
    if isinstance(value, bool):
        raise TypeError(value)
    if kind is int:
        if isinstance(value, float) and not value.is_integer():
            raise ValueError(value)
        return int(value)
    if kind is float:
        number = float(value)
        if not math.isfinite(number):
            raise ValueError(value)
        return number
    if not isinstance(value, str):
        raise TypeError(value)
    return value


def _kind_name(kind: type) -> str:
    return {bool: "true or false", int: "a whole number", float: "a number", str: "text"}[kind]
