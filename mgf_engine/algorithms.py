# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the algorithms: numbers that the panel does not show and that ``--set section.name=value`` sets.

Each algorithm keeps its numbers in a frozen dataclass in its own module; :func:`parameter` gives each number a sentence
and a unit. :data:`ALGORITHMS` names the dataclasses, ``docs/algorithms.md`` is written from them, and
:meth:`mgf_engine.config.Config.algorithm` makes one with the values that the user set. Like :mod:`mgf_engine.stages`,
this module imports nothing of the algorithms: a dataclass is named as ``module:class`` and imported when it is needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, field, fields
from importlib import import_module
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.option_values import check_limits, convert


def parameter(default: Any, help: str, unit: str = "", *, low: float | None = 0, high: float | None = None) -> Any:
    """Define a dataclass field that is an option of an algorithm.

    Args:
        default: number, switch, or tuple of numbers.
        help: what it is, a noun phrase without the final full stop.
        unit: of the number; empty for counts and shares.
        low: smallest value allowed, None for no limit; of every number of a tuple.
        high: largest value allowed.
    """
    return field(default=default, metadata={"help": help, "unit": unit, "low": low, "high": high})


@dataclass(frozen=True)
class Algorithm:
    """An algorithm with options.

    Attributes:
        section: as ``--set`` names it.
        stage: the stage whose result its options decide.
        title: what it does, for the docs.
        options: its dataclass, as ``module:class``.
    """

    section: str
    stage: str
    title: str
    options: str

    def load(self) -> type:
        """Import the dataclass."""
        module, _, name = self.options.partition(":")
        found: type = getattr(import_module(module), name)
        return found

    def parameters(self) -> Iterator[Field[Any]]:
        """Iterate over the options; a field whose default is another dataclass is a section of its own."""
        return (f for f in fields(self.load()) if f.default is not MISSING and "help" in f.metadata)


ALGORITHMS: tuple[Algorithm, ...] = (
    Algorithm(
        "pose_adjustment",
        "scene",
        "Adjustment of cameras that disagree with the sparse points",
        "mgf_engine.scene.adjust:AdjustOptions",
    ),
    Algorithm(
        "random_walker",
        "masks",
        "Label propagation from clicks to all photos and points",
        "mgf_engine.masks.propagation.random_walker:RandomWalkerOptions",
    ),
    Algorithm(
        "start_views",
        "field",
        "Photos and masks that the starting surface is made from",
        "mgf_engine.start.options:ViewOptions",
    ),
    Algorithm("start_lines", "field", "Edges in photos and lines in space", "mgf_engine.start.options:SegmentOptions"),
    Algorithm("start_planes", "field", "Planes through lines", "mgf_engine.start.options:PlaneOptions"),
    Algorithm("start_stereo", "field", "Points by stereo", "mgf_engine.start.options:DenseOptions"),
    Algorithm(
        "start_cut", "field", "Minimum cut that makes the starting surface", "mgf_engine.start.options:CutOptions"
    ),
    Algorithm("start_samples", "field", "Samples on the starting surface", "mgf_engine.start.samples:SampleOptions"),
    Algorithm("start_points", "field", "Points that Gaussians start from", "mgf_engine.field.start:StartPointOptions"),
    Algorithm(
        "initialisation",
        "field",
        "Shape and opacity of the first Gaussians",
        "mgf_engine.field.initialise:InitialisationOptions",
    ),
    Algorithm(
        "densification", "field", "Splitting and pruning of Gaussians", "mgf_engine.field.density:DensificationOptions"
    ),
    Algorithm("learning_rates", "field", "Step sizes of Adam", "mgf_engine.field.schedule:LearningRates"),
    Algorithm(
        "photometric",
        "mesh",
        "Refinement of depth maps by matching photos",
        "mgf_engine.mesh.photometric:MatchOptions",
    ),
    Algorithm(
        "depth_smoothing",
        "mesh",
        "Smoothing of matched depth maps",
        "mgf_engine.mesh.depth_smoothing:SmoothingOptions",
    ),
    Algorithm(
        "prior", "mesh", "Choice between the field and the starting surface", "mgf_engine.mesh.prior:PriorOptions"
    ),
    Algorithm("tsdf", "mesh", "Fusion of depth maps into a signed distance", "mgf_engine.mesh.tsdf:TsdfOptions"),
    Algorithm(
        "mesh_refinement", "mesh", "Photometric refinement of the mesh", "mgf_engine.mesh.refine:RefinementOptions"
    ),
    Algorithm("planar", "mesh", "Projection of planar regions", "mgf_engine.mesh.plane_detection:PlanarOptions"),
    Algorithm("vertex_colors", "mesh", "Vertex colours from photos", "mgf_engine.mesh.colors:ColorOptions"),
    Algorithm(
        "texture_visibility", "deliver", "Photos that show a face", "mgf_engine.texture.visibility:VisibilityOptions"
    ),
    Algorithm(
        "texture_views",
        "deliver",
        "Choice of the photo that paints a face",
        "mgf_engine.texture.view_selection:ViewSelectionOptions",
    ),
    Algorithm("seams", "deliver", "Levelling of colours at seams", "mgf_engine.texture.seams:SeamOptions"),
    Algorithm("sky", "masks", "Sky regions and the skyline", "mgf_engine.masks.propagation.sky_regions:SkyOptions"),
    Algorithm(
        "sky_holes",
        "masks",
        "Sky that shows through the building",
        "mgf_engine.masks.refinement.sky_holes:SkyHoleOptions",
    ),
    Algorithm(
        "ground_homography",
        "masks",
        "Ground that shows through the building",
        "mgf_engine.masks.refinement.ground_homography:GroundHomographyOptions",
    ),
    Algorithm(
        "far_background",
        "masks",
        "Far background behind an open building",
        "mgf_engine.masks.refinement.far_background:FarBackgroundOptions",
    ),
    Algorithm(
        "building_extent",
        "masks",
        "Extent of the building in the photos",
        "mgf_engine.masks.geometry.building_extent:ExtentOptions",
    ),
    Algorithm(
        "planar_clustering",
        "mesh",
        "Merging of vertices in flat areas",
        "mgf_engine.mesh.planar_clustering:PlanarClusteringOptions",
    ),
    Algorithm("mask_votes", "mesh", "Vote of the masks on faces", "mgf_engine.mesh.mask_votes:MaskVoteOptions"),
    Algorithm(
        "low_confidence_fill",
        "mesh",
        "Membrane over dents that no photo confirms",
        "mgf_engine.mesh.low_confidence_fill:LowConfidenceFillOptions",
    ),
    Algorithm(
        "unobserved_volumes",
        "mesh",
        "Removal of volumes that no photo shows",
        "mgf_engine.mesh.unobserved_volumes:UnobservedVolumeOptions",
    ),
    Algorithm(
        "superpixels",
        "masks",
        "Superpixels of each photo",
        "mgf_engine.masks.propagation.superpixels:SuperpixelOptions",
    ),
    Algorithm(
        "prompt_outliers",
        "masks",
        "Cross-validation of clicks",
        "mgf_engine.masks.propagation.prompt_outliers:PromptOutlierOptions",
    ),
    Algorithm(
        "prompt_agreement",
        "masks",
        "Clicks in several photos that confirm each other",
        "mgf_engine.masks.propagation.prompt_agreement:PromptAgreementOptions",
    ),
    Algorithm(
        "thin_structures",
        "masks",
        "Thin structures against the sky",
        "mgf_engine.masks.refinement.thin_structures:ThinStructureOptions",
    ),
    Algorithm(
        "propagation",
        "masks",
        "Drawing and checking of the masks",
        "mgf_engine.masks.propagation.propagate:PropagationOptions",
    ),
    Algorithm("extraction", "mesh", "Mesh extraction as a whole", "mgf_engine.mesh.extract:ExtractionOptions"),
    Algorithm(
        "homogeneous_regions",
        "masks",
        "Completion of homogeneous regions",
        "mgf_engine.masks.refinement.homogeneous_regions:HomogeneousRegionOptions",
    ),
    Algorithm("mask_flags", "masks", "Masks that are left out", "mgf_engine.masks.validation.mask_flags:FlagOptions"),
)
_BY_SECTION = {algorithm.section: algorithm for algorithm in ALGORITHMS}
_BY_CLASS = {algorithm.options: algorithm for algorithm in ALGORITHMS}


def is_algorithm_option(name: str) -> bool:
    """Tell whether an option's name begins with the section of an algorithm."""
    return name.partition(".")[0] in _BY_SECTION and "." in name


def algorithm_named(section: str) -> Algorithm:
    """Return the algorithm of a section.

    Raises:
        KeyError: there is none.
    """
    return _BY_SECTION[section]


def algorithm_of(kind: type) -> Algorithm:
    """Return the algorithm whose options a dataclass holds.

    Raises:
        KeyError: the dataclass is not in the table.
    """
    return _BY_CLASS[f"{kind.__module__}:{kind.__qualname__}"]


def algorithm_default(name: str) -> Any:
    """Return the default of an option ``section.name``.

    Raises:
        KeyError: there is no such section.
        StopIteration: there is no such option.
    """
    section, _, own = name.partition(".")
    return next(f.default for f in algorithm_named(section).parameters() if f.name == own)


def algorithms_schema() -> list[dict[str, Any]]:
    """List the options of all algorithms as plain data: name, default, help, unit, limits, algorithm, stage."""
    return [
        {
            "name": f"{algorithm.section}.{spec.name}", "default": spec.default, **spec.metadata,
            "algorithm": algorithm.title, "stage": algorithm.stage,
        }
        for algorithm in ALGORITHMS
        for spec in algorithm.parameters()
    ]  # fmt: skip


def algorithm_values(given: dict[str, Any]) -> dict[str, Any]:
    """Check options of algorithms; those at their default are left out, so that they change no job.

    Args:
        given: ``section.name`` -> value; text is converted to the option's type.

    Raises:
        BadInput: an unknown option, a value of the wrong type or outside its limits.
    """
    result = {}
    for key, value in sorted(given.items()):
        section, _, name = key.partition(".")
        spec = next((f for f in algorithm_named(section).parameters() if f.name == name), None)
        if spec is None:
            raise BadInput(f"Unknown option '{key}'; 'mgf options --algorithms' lists the options of {section}.")
        result[key] = convert(key, value, spec.default)
        check_limits(key, result[key], spec.metadata["low"], spec.metadata["high"])
        if result[key] == spec.default:
            del result[key]
    return result
