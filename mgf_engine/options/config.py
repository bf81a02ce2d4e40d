# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of a job, each defined once.

Command line, job file, presets and the panel in Blender (through the JSON schema of ``mgf options``) are generated from
:class:`Config`. Each field has its section, one sentence of help and its limits as metadata.
"""

from __future__ import annotations

from dataclasses import Field, asdict, dataclass, field, fields, replace
from typing import Any, TypeVar

from mgf_engine.costs import COSTS
from mgf_engine.errors import BadInput
from mgf_engine.options.algorithms import (
    RENAMED_OPTIONS,
    algorithm_default,
    algorithm_named,
    algorithm_values,
    is_algorithm_option,
    make_options,
)
from mgf_engine.options.presets import PRESET_HELP, PRESETS
from mgf_engine.options.values import check_limits, convert, shorten
from mgf_engine.stages import SECTIONS, STAGES

#: Training iterations are proportional to the number of photos, clamped to these limits. With many more iterations the
#: field models reflections by dents behind the panes.
RUN_LENGTH = {"fewest": 20, "most": 60}

T = TypeVar("T")


def option(
    default: Any,
    section: str,
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    unit: str = "",
    path: str = "",
    level: str = "expert",
) -> Any:
    """Define a dataclass field with its section, help, limits and unit as metadata.

    Args:
        default: of the field.
        section: stage that the option belongs to.
        help: one sentence for command line, panel and documentation.
        low: smallest allowed value; None for no limit.
        high: largest allowed value; None for no limit.
        choices: allowed values of a text option.
        unit: of the number, such as px.
        path: "file" or "folder" where the value is a path.
        level: ``basic`` for what users see first, ``advanced`` for what help and panel show as well, ``expert`` for
            experiments and ablations, which ``mgf options``, the docs and Blender's *Developer Extras* list.
    """
    return field(
        default=default,
        metadata={
            "section": section, "help": help, "low": low, "high": high, "choices": choices, "unit": unit, "path": path,
            "level": level,
        },
    )  # fmt: skip


@dataclass(frozen=True)
class Config:
    """All options of one job; see each field's help. Build with :func:`make_config`, which validates."""

    # fmt: off
    # run
    preset: str = option("standard", "run", "Trade-off between time and quality", choices=("quick", "draft", "standard", "fine", "paper"), level="basic")
    device: str = option("auto", "run", "Device that trains the field", choices=("auto", "cpu", "cuda"), level="basic")
    threads: int = option(0, "run", "Number of worker threads; 0 uses all cores", low=0, high=256, level="advanced")
    memory: float = option(0.0, "run", "Maximum memory of the job; 0 uses three quarters of the free memory", low=0, high=100_000, unit="GB", level="basic")
    blocks: int = option(1, "run", "Number of blocks in which a very large building is meshed, one after another; more blocks need less memory", low=1, high=1000, level="advanced")
    seed: int = option(0, "run", "Random seed. The same seed and number of threads give the same mesh", low=0, high=2**31 - 1)
    checkpoint_seconds: float = option(60.0, "run", "Time between two checkpoints of the training", low=1, high=86400, unit="s")

    # scene
    resolution: int = option(750, "scene", "Longest side of the working photos", low=64, high=8192, unit="px", level="basic")
    max_photos: int = option(0, "scene", "Maximum number of photos; 0 uses all. Photos with clicks are kept, the others are chosen by farthest-point sampling", low=0, high=100_000, level="advanced")
    even_exposure: bool = option(True, "scene", "Equalize exposure and white balance of the photos by the sparse points they share")
    matching: str = option("auto", "scene", "Photo matching for structure from motion (photos without a COLMAP model)", choices=("auto", "exhaustive", "sequential"))

    # masks
    use_masks: bool = option(True, "masks", "Mask the building; off meshes whole photos, and no step uses masks", level="advanced")
    masked_points: bool = option(True, "masks", "Start from the sparse points on the building only (ablation b)")
    segmenter: str = option("auto", "masks", "Segmentation method of the masks", choices=("auto", "random_walker", "efficientsam"), level="advanced")
    weights: str = option("", "masks", "Folder of the EfficientSAM weights; empty uses the user's cache folder", path="folder", level="advanced")
    second_level: str = option("auto", "masks", "Segment elements of the building (windows, doors, parts of walls); auto does so if a part was clicked or a loss needs them", choices=("auto", "on", "off"))
    voters: str = option("all", "masks", "Masks that vote on points and Gaussians (eq. 3 and 22): of all photos, or only of the root photos, which have clicks", choices=("all", "roots"))
    strict_vote: bool = option(False, "masks", "Require a point to lie inside every root mask (eq. 3 as printed)")
    vote_tolerance: float = option(0.1, "masks", "Maximum share of votes against a point", low=0, high=1)
    vote_dilation: int = option(3, "masks", "Dilation of the masks before points are tested against them", low=0, high=100, unit="px")

    mask_margin: float = option(0.008, "masks", "Width of the background margin that is trained along with the building, as a share of the photo's longest side", low=0, high=0.2)

    # field
    iterations: int = option(0, "field", "Number of training iterations; 0 computes it from passes and the number of photos", low=0, high=1_000_000)
    passes: int = option(50, "field", "Training iterations per photo; fewer than 20 photos count as 20, more than 60 as 60. 0 skips the training", low=0, high=1000)
    holdout_every: int = option(8, "field", "Keep every n-th photo out of training, to measure the quality; 0 trains on all photos", low=0, high=1000)
    max_gaussians: int = option(120_000, "field", "Maximum number of Gaussians", low=100, high=10_000_000, level="advanced")
    start: str = option("surface", "field", "Initial position of the Gaussians: a surface from edges, planes and stereo, dense points by stereo, or the sparse points", choices=("surface", "dense", "sparse"))
    sh_degree: int = option(2, "field", "Degree of the spherical harmonics (view-dependent colour)", low=0, high=3)
    coarse_to_fine: bool = option(True, "field", "Train on downscaled photos first, on the full working resolution at the end")
    filter_3d: bool = option(True, "field", "Apply a 3D low-pass filter, so that no Gaussian is smaller than the photos can resolve")
    random_background: bool = option(True, "field", "Train with a random background colour in each iteration; off trains with black")
    masked_images: bool = option(True, "field", "Train on the pixels of the building alone; off trains on whole photos, while points, losses and votes still use the masks (ablation a)")
    multilevel_loss: bool = option(False, "field", "Use the multi-level perceptual mask loss, eq. 18-19; off uses the RGB loss, eq. 16 (ablation c)")
    boundary_loss: bool = option(False, "field", "Use the boundary loss, eq. 17; off gives its weight to the other colour term (ablation c)")
    l1_weight: float = option(0.8, "field", "Weight of the L1 term, eq. 16-18", low=0, high=1)
    ssim_weight: float = option(0.2, "field", "Weight of the SSIM term, eq. 16-18", low=0, high=1)
    boundary_weight: float = option(10.0, "field", "Weight of pixels on mask boundaries, w_edge of eq. 12", low=1, high=1000)
    multilevel_lambda: float = option(0.5, "field", "Weight of the multi-level perceptual mask loss, lambda 1 of eq. 20", low=0, high=1000)
    boundary_lambda: float = option(0.5, "field", "Weight of the boundary loss, lambda 2 of eq. 20", low=0, high=1000)
    distortion_lambda: float = option(100.0, "field", "Weight of the depth distortion loss, lambda 3 of eq. 20", low=0, high=100000)
    normal_lambda: float = option(0.05, "field", "Weight of the normal consistency loss, lambda 4 of eq. 20", low=0, high=1000)
    geometry_from: float = option(0.4, "field", "Share of the training after which the distortion and normal losses start", low=0, high=1)
    geometry_every: int = option(3, "field", "Apply the distortion and normal losses in every n-th iteration, with n times their weight", low=1, high=100)
    background_lambda: float = option(0.02, "field", "Weight of the loss that penalises opacity on certain background", low=0, high=1000)
    densify_from: float = option(0.05, "field", "Share of the training after which densification starts", low=0, high=1)
    densify_until: float = option(0.6, "field", "Share of the training after which densification stops", low=0, high=1)
    densify_by: str = option("error", "field", "Criterion of densification: the colour error attributed to a Gaussian, the gradient of its projected centre (3DGS), or the sum of absolute gradients (GOF)", choices=("error", "gradient", "absolute_gradient"))
    densify_every: int = option(100, "field", "Number of iterations between two rounds of densification and pruning", low=1, high=100000)
    training_votes: bool = option(True, "field", "Prune Gaussians that the masks vote against during the training as well")
    prune_opacity: float = option(0.02, "field", "Minimum opacity of a Gaussian; fainter ones are pruned", low=0, high=1)

    # mesh
    screening: bool = option(True, "mesh", "Remove Gaussians that the masks vote against before meshing, eq. 21-22 (ablation d)")
    screening_dilation: int = option(1, "mesh", "Dilation of the masks for the screening and for the depth maps of the mesh", low=0, high=100, unit="px")
    visual_hull: bool = option(True, "mesh", "Carve away what several masks show as background")
    surface: str = option("fused", "mesh", "Definition of the surface: 'fused' averages the depth maps of all photos, 'opacity' takes the minimum over the views (eq. 25)", choices=("fused", "opacity"))
    match_photos: bool = option(True, "mesh", "Refine depth maps and mesh by matching patches between neighbouring photos")
    depth_smoothing: float = option(20.0, "mesh", "Weight of the smoothness term of matched depth maps; 0 turns it off (with match_photos only)", low=0, high=10_000)
    refine_rounds: int = option(1, "mesh", "Number of rounds of photometric mesh refinement (with match_photos only)", low=0, high=10)
    calibrate_level: bool = option(True, "mesh", "Calibrate the isosurface level on the most reliable sparse points")
    opacity_level: float = option(0.5, "mesh", "Opacity of the isosurface, eq. 26, unless sparse points calibrate it (surface 'opacity' only)", low=0.01, high=0.99)
    level_steps: int = option(8, "mesh", "Maximum number of root-finding steps on each edge that crosses the surface", low=0, high=16)
    merge_flat: bool = option(True, "mesh", "Merge vertices in flat areas of the raw surface")
    drop_unseen: bool = option(True, "mesh", "Remove parts that no photo shows: unobserved volumes, floating parts, parts far from all clicks")
    face_votes: bool = option(True, "mesh", "Remove faces that most masks show as background, tested per pixel")
    fill_holes: bool = option(True, "mesh", "Close small holes, unless a photo looks through them")
    span_dents: bool = option(True, "mesh", "Fill dents that no photo confirms with a smooth membrane spanned over their rim")
    smoothing: int = option(2, "mesh", "Number of smoothing rounds over the raw surface; 0 turns it off", low=0, high=1000)
    flatten: bool = option(True, "mesh", "Project nearly planar regions onto their planes, and vertices between two planes onto their common edge")
    openings: bool = option(True, "mesh", "Cut windows, doors and niches of flat walls, level or arched, with their edges where the photos have them (with flatten only)", level="advanced")
    face_error: float = option(0.25, "mesh", "Maximum distance between the simplified and the full mesh, in pixels of the nearest photo; 0 only keeps to max_faces", low=0, high=100, unit="px")
    color_error: float = option(8.0, "mesh", "Maximum colour error of the simplified mesh (root mean square); 256 simplifies by shape alone", low=0, high=256, unit="grey levels")
    max_faces: int = option(1_000_000, "mesh", "Maximum number of faces, whatever color_error and face_error say; 0 for no limit", low=0, high=100_000_000, level="basic")
    min_component: float = option(0.01, "mesh", "Minimum size of a separate part, as a share of the area of the largest part and of its pixels in the photos", low=0, high=1, level="advanced")
    crop_box: str = option("", "mesh", "Crop box in the scene frame: 6 numbers (minimum and maximum corner), 16 (matrix of the cube -1..1, row by row), or a file of them; empty for none", level="advanced")
    close_bottom: bool = option(False, "mesh", "Close the mesh at the bottom, where the building meets the ground", level="advanced")

    # deliver
    texture: bool = option(True, "deliver", "Make a texture from the photos at full size; Blender, OBJ and GLB show it", level="basic")
    texture_size: int = option(4096, "deliver", "Maximum side of the texture; smaller where the photos show no more detail", low=256, high=16384, unit="px", level="advanced")
    export_obj: bool = option(False, "deliver", "Also write mesh.obj", level="advanced")
    export_glb: bool = option(False, "deliver", "Also write mesh.glb", level="advanced")
    render_all: bool = option(False, "deliver", "Render the views of all photos, not only of the held-out ones", level="advanced")

    # georef
    gps: str = option("auto", "georef", "Use the GPS positions of the photos for scale, up and north; needs at least four positions that are not on a line", choices=("auto", "off"), level="advanced")
    crs: str = option("", "georef", "Coordinate reference system of the results, such as EPSG:25832; auto for the UTM zone, empty for a local frame in metres", level="advanced")
    control: str = option("", "georef", "Control and check points: name, east, north, height, accuracy, role (CSV, or the files of Metashape or OpenDroneMap)", path="file", level="advanced")
    marks: str = option("", "georef", "Positions of the points in the photos: name, photo, x, y in pixels of the original photo (CSV)", path="file", level="advanced")
    scale_bars: str = option("", "georef", "Distances between marked points: from, to, metres (CSV)", path="file", level="advanced")
    control_adjust: bool = option(True, "georef", "Adjust the cameras to the control points (bundle adjustment); off only aligns the scene with them", level="advanced")
    # fmt: on

    #: Options of the algorithms that differ from their defaults, ``section.name`` -> value.
    algorithms: dict[str, Any] = field(default_factory=dict, hash=False)

    def algorithm(self, kind: type[T]) -> T:
        """Return the options of an algorithm, with the values that the user set.

        Args:
            kind: a dataclass of :data:`mgf_engine.options.algorithms.ALGORITHMS`.
        """
        return make_options(kind, {f.name: getattr(self, f.name) for f in option_fields()} | self.algorithms)

    def algorithms_of(self, stage: str) -> dict[str, Any]:
        """Return the changed options of the algorithms of a stage or command, ``section.name`` -> value."""
        return {k: v for k, v in self.algorithms.items() if algorithm_named(k.partition(".")[0]).stage == stage}

    def wants_elements(self, parts_clicked: bool) -> bool:
        """Tell whether the second level of the masks (elements of the building) is needed."""
        used = parts_clicked or self.multilevel_loss or self.boundary_loss
        return self.second_level == "on" or (self.second_level == "auto" and used)

    def run_length(self, photos: int) -> int:
        """Compute the number of iterations of a training on this number of photos."""
        return self.iterations or self.passes * min(RUN_LENGTH["most"], max(RUN_LENGTH["fewest"], photos))


def job_option(name: str) -> Any:
    """Define a field of an algorithm's options whose value is that of an option of the job (:class:`Config`)."""
    return field(default=getattr(Config, name), metadata={"job_option": name})


#: Option -> earlier value -> value now; accepted for one version, with a warning.
RENAMED: dict[str, dict[str, str]] = {"segmenter": {"grabcut": "random_walker"}}


def make_config(given: dict[str, Any] | None = None) -> Config:
    """Make a validated config: defaults, then the preset, then what the user gave.

    Args:
        given: option name -> value; text is converted to the option's type. Options of algorithms are
            ``section.name``.

    Raises:
        BadInput: an unknown option, a value of the wrong type or outside its limits.
    """
    given = {k: v for k, v in (given or {}).items() if v is not None}
    known = {f.name: f for f in option_fields()}
    own = {name: value for name, value in given.items() if not is_algorithm_option(name)}
    unknown = sorted(set(own) - set(known))
    if unknown:
        raise BadInput(f"Unknown option '{unknown[0]}'; 'mgf options' lists every option.")
    values = {name: _convert(known[name], value) for name, value in own.items()}
    preset = PRESETS[values.get("preset", Config.preset)]
    preset = preset | _compressed(preset, values)
    algorithms = algorithm_values({**_of_algorithms(preset), **_of_algorithms(given)})
    own_preset = {name: value for name, value in preset.items() if name in known}
    config = replace(Config(algorithms=algorithms), **{**own_preset, **values})
    if config.densify_from > config.densify_until:
        raise BadInput("densify_from must not be larger than densify_until; swap the two shares.")
    if 0 < config.max_photos < 3:
        raise BadInput("max_photos must be at least 3, or 0 to use all photos.")
    return config


def _compressed(preset: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """Scale a preset's interval of densification to fewer iterations, for as many rounds as in a full run.

    The interval of opacity resets is not scaled: after a reset, Gaussians need some 35 iterations to exceed the opacity
    below which they are pruned.
    """
    usual, own, every = preset.get("iterations"), values.get("iterations"), preset.get("densify_every")
    if not usual or not own or not every or own >= usual:
        return {}
    return {"densify_every": max(1, round(every * own / usual))}


def _of_algorithms(given: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in given.items() if is_algorithm_option(name)}


def option_fields() -> list[Field[Any]]:
    """Return the fields of :class:`Config` that are options of a job, each with its metadata."""
    return [f for f in fields(Config) if "section" in f.metadata]


def options_schema() -> dict[str, Any]:
    """Return all options as plain data, for panels and other front ends; ``options`` has an entry for each."""
    panel_presets = {name: {k: v for k, v in p.items() if not is_algorithm_option(k)} for name, p in PRESETS.items()}
    entries = [
        {"name": f.name, "type": type(f.default).__name__, "default": f.default, **f.metadata} for f in option_fields()
    ]
    return {
        "sections": SECTIONS, "stages": {stage.name: stage.progress for stage in STAGES},
        "presets": panel_presets, "preset_help": PRESET_HELP, "run_length": RUN_LENGTH, "costs": COSTS,
        "options": entries,
    }  # fmt: skip


def renamed_values(given: dict[str, Any]) -> list[str]:
    """Return a warning for each given option or value of an earlier name."""
    options = [
        f"{name} has been renamed to {RENAMED_OPTIONS[name]}; the old name works in this version only."
        for name in given
        if name in RENAMED_OPTIONS
    ]
    return options + [
        f"{name}={value} has been renamed to {name}={RENAMED[name][value]}; the old value works in this version only."
        for name, value in given.items()
        if isinstance(value, str) and value in RENAMED.get(name, {})
    ]


def as_dict(config: Config) -> dict[str, Any]:
    """Return the config as plain data for the job file and the report."""
    data = asdict(config)
    algorithms = data.pop("algorithms")
    # Also options at their default that the preset changes: else reading the data would apply the preset's value.
    back = {name: algorithm_default(name) for name in _of_algorithms(PRESETS[config.preset])}
    return {**data, **back, **algorithms}


def _convert(spec: Any, value: Any) -> Any:
    """Convert ``value`` to the option's own type, checked against its limits."""
    meta, result = spec.metadata, convert(spec.name, value, spec.default)
    result = RENAMED.get(spec.name, {}).get(result, result) if isinstance(result, str) else result
    if meta["choices"] and result not in meta["choices"]:
        raise BadInput(f"Option {spec.name} is one of {', '.join(meta['choices'])}, not '{shorten(value)}'.")
    check_limits(spec.name, result, meta["low"], meta["high"])
    return result
