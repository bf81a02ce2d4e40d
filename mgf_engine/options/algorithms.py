# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the algorithms: parameters that are in no panel; ``--set section.name=value`` sets them.

Each algorithm has a frozen dataclass of parameters in its own module; :func:`parameter` gives each a description and a
unit. :data:`mgf_engine.options.algorithm_table.ALGORITHMS` lists the dataclasses, ``docs/algorithms.md`` is generated
from them, and :meth:`mgf_engine.options.config.Config.algorithm` makes one with the values that the user set.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field, fields, is_dataclass
from typing import Any, TypeVar

from mgf_engine.errors import BadInput
from mgf_engine.options.algorithm_table import ALGORITHMS, Algorithm
from mgf_engine.options.values import check_limits, convert

T = TypeVar("T")


def parameter(default: Any, help: str, unit: str = "", *, low: float | None = 0, high: float | None = None) -> Any:
    """Define a dataclass field that is an option of an algorithm.

    Args:
        default: number, switch, or tuple of numbers.
        help: description, a noun phrase without the final full stop.
        unit: of the number; empty for counts and shares.
        low: smallest allowed value, also of each number of a tuple; None for no limit.
        high: largest allowed value; None for no limit.
    """
    return field(default=default, metadata={"help": help, "unit": unit, "low": low, "high": high})


_BY_SECTION = {algorithm.section: algorithm for algorithm in ALGORITHMS}
_BY_CLASS = {algorithm.options: algorithm for algorithm in ALGORITHMS}
#: Earlier name of an option -> its name now; accepted for one version, with a warning.
RENAMED_OPTIONS = {
    "start_cut.outside_views": "start_outside.least_views",
    "start_lines.outside_views": "start_outside.least_views",
    "start_lines.outside_margin": "start_outside.margin",
    "building_extent.same_side": "point_visibility.same_side",
    "building_extent.steep": "point_visibility.steep",
    "building_extent.over_share": "superstructures.height",
    "building_extent.plan_close": "superstructures.gap",
    "building_extent.plan_side": "superstructures.side",
    "planar.seed_block": "planar.seed_coarse",
    "patch_match.most_off": "patch_match.consistency_max_cost",
    "patch_match.held_score": "patch_match.consistency_min_ncc",
    "prior.sure": "prior.least_confidence",
    "prior.trust": "prior.unmatched_weight",
    "tsdf.through": "tsdf.free_space_alpha",
    "tsdf.through_weight": "tsdf.free_space_weight",
    "mesh_refinement.sure": "mesh_refinement.search_tolerance",
    "ground_homography.colour": "ground_homography.color",
    "start_lines.colour": "start_lines.color",
    "regions.steepest": "regions.largest_slope",
    "wall_openings.wall": "elevation_walls.area",
    "wall_openings.facing": "elevation_walls.facing",
    "solid_evidence.steepest": "solid_evidence.largest_tilt",
    "opening_walls.behind": "opening_cuts.reach",
    "opening_cuts.deepest": "opening_detection.deepest",
    **{f"sky_silhouette.{n}": f"silhouette_hull.{n}" for n in ("photos", "photo_share", "most_cells", "feet")},
    **{
        f"wall_openings.{name}": f"opening_detection.{name}"
        for name in (
            *("depth", "deepest", "holes", "middle", "uneven", "bottom", "crossing", "shape", "side", "filled"),
            *("corners", "corner_side", "around", "largest", "aligned"),
        )
    },
}


def is_algorithm_option(name: str) -> bool:
    """Tell whether an option's name begins with the section of an algorithm, or did so in an earlier version."""
    return name in RENAMED_OPTIONS or (name.partition(".")[0] in _BY_SECTION and "." in name)


def algorithm_named(section: str) -> Algorithm:
    """Return the algorithm of a section.

    Raises:
        KeyError: there is none.
    """
    return _BY_SECTION[section]


def _place_of(kind: type) -> str:
    """Return ``module:class`` of a dataclass, as in the table."""
    return f"{kind.__module__.removeprefix('mgf_engine.')}:{kind.__qualname__}"


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


def make_options(kind: type[T], values: dict[str, Any]) -> T:
    """Make the options of an algorithm from a dictionary ``section.name`` -> value; missing ones have their defaults.

    Fields that are dataclasses of options are made in the same way: the options of an algorithm contain those of the
    algorithms that it calls. A dataclass with only such fields needs no section.

    Args:
        kind: the dataclass.
        values: ``section.name`` -> value, and for fields defined by :func:`mgf_engine.options.config.job_option` the
            name of the option of the job -> value.
    """
    algorithm = _BY_CLASS.get(_place_of(kind))
    start = "" if algorithm is None else algorithm.section + "."
    own = {k.removeprefix(start): v for k, v in values.items() if algorithm is not None and k.startswith(start)}
    inner = {f.name: make_options(type(f.default), values) for f in fields(kind) if is_dataclass(f.default)}  # type: ignore[arg-type]
    shared = {f.name: f.metadata["job_option"] for f in fields(kind) if "job_option" in f.metadata}  # type: ignore[arg-type]
    from_job = {name: values[option] for name, option in shared.items() if option in values}
    return kind(**inner, **own, **from_job)


def check_used(command: str, names: Iterable[str]) -> None:
    """Check that a command for finished jobs uses all options of algorithms that it was given.

    Raises:
        BadInput: it does not use one of them, or there is no such option.
    """
    sections = {a.section for a in ALGORITHMS if command == a.stage or command in a.also}
    for name in names:
        if RENAMED_OPTIONS.get(name, name).partition(".")[0] not in sections:
            raise BadInput(
                f"'mgf {command}' does not use the option '{name}'; 'mgf options --algorithms' lists the options of "
                "each stage and command."
            )


def algorithm_values(given: dict[str, Any]) -> dict[str, Any]:
    """Check and convert options of algorithms; those at their default are left out, so that they change no stage key.

    Args:
        given: ``section.name`` -> value; text is converted to the option's type. A value given by an option's present
            name wins over one by its earlier name.

    Raises:
        BadInput: an unknown option, a value of the wrong type or outside its limits.
    """
    result = {}
    renamed = {RENAMED_OPTIONS[key]: value for key, value in given.items() if key in RENAMED_OPTIONS}
    present = {key: value for key, value in given.items() if key not in RENAMED_OPTIONS}
    for key, value in sorted((renamed | present).items()):
        section, _, name = key.partition(".")
        spec = next((f for f in algorithm_named(section).parameters() if f.name == name), None)
        if spec is None:
            raise BadInput(f"Unknown option '{key}'; 'mgf options --algorithms' lists the options of {section}.")
        result[key] = convert(key, value, spec.default)
        check_limits(key, result[key], spec.metadata["low"], spec.metadata["high"])
        if result[key] == spec.default:
            del result[key]
    return result
