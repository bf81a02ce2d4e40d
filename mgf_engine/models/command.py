# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf models``: levels of detail, 3D Tiles, a solid, USD and points of a finished job."""

from __future__ import annotations

import argparse
import math

from mgf_engine.console.commands import PATIENCE, read_algorithm_options, read_number, run_reported
from mgf_engine.console.shared_arguments import (
    add_algorithm_arguments,
    add_job_argument,
    add_reporting_arguments,
    path_of,
)
from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter
from mgf_engine.models.kinds import KINDS, PACKAGES
from mgf_engine.system.machine import is_installed

MOST_ERRORS = 9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``mgf models``."""
    add_job_argument(parser)
    parser.add_argument("--out", type=path_of, metavar="FOLDER", help="where models go (default: JOB/models)")
    parser.add_argument(
        "--only", default=",".join(KINDS), metavar="KINDS",
        help=f"what to make, with commas between (default: all of {','.join(KINDS)})",
    )  # fmt: skip
    parser.add_argument(
        "--error", default=None, metavar="CM",
        help="make the coarser levels of detail by how far they may lie from the mesh in centimetres, such as 1,5,20, "
        "in place of 25, 6 and 1.5 %% of its faces",
    )  # fmt: skip
    parser.add_argument(
        "--detail", default=None, metavar="CM",
        help="leave steps and offsets below this size in centimetres out of the solid (default: 8 pixels of the "
        "photos, or 1 %% of the building)",
    )  # fmt: skip
    parser.add_argument(
        "--spacing", default=None, metavar="CM",
        help="distance between the points in centimetres (default: a pixel of the working photos)",
    )  # fmt: skip
    parser.add_argument(
        "--draco", action="store_true",
        help="compress the levels of detail with Draco, for the web; not every program opens such files",
    )  # fmt: skip
    add_algorithm_arguments(parser)
    add_reporting_arguments(parser)


def models_command(args: argparse.Namespace) -> int:
    """Make everything that was asked for; returns the exit code."""
    return run_reported(args, lambda reporter: _make(args, reporter), PATIENCE)


def _make(args: argparse.Namespace, reporter: Reporter) -> None:
    """Make.

    Raises:
        BadInput: the job has no mesh, an argument cannot be used, or a package is missing.
    """
    kinds = read_kinds(args.only)
    errors = [] if args.error is None else [error / 100 for error in read_errors(args.error)]
    detail = _read_centimetres("--detail", args.detail)
    spacing = _read_centimetres("--spacing", args.spacing)
    algorithms = read_algorithm_options(args, "models")
    require_packages(kinds, args.draco)
    from mgf_engine.models.make import make_models
    from mgf_engine.models.work import ModelOptions

    options = ModelOptions(kinds, errors, detail, spacing, args.draco, algorithms)
    make_models(args.job, args.out, options, reporter)


def _read_centimetres(flag: str, text: str | None) -> float | None:
    """Read a length given in centimetres, in metres."""
    centimetres = read_number(flag, text, "a length in centimetres")
    return None if centimetres is None else centimetres / 100


def read_kinds(text: str) -> tuple[str, ...]:
    """Parse the argument of ``--only``, kinds of models separated by commas.

    Raises:
        BadInput: it names something else.
    """
    kinds = tuple(dict.fromkeys(part.strip() for part in text.split(",")))
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise BadInput(f"--only takes some of {', '.join(KINDS)}, not '{unknown[0]}'.")
    return kinds


def read_errors(text: str) -> list[float]:
    """Read distances in centimetres, each larger than the one before.

    Raises:
        BadInput: they are not.
    """
    refusal = BadInput(
        f"--error takes one to {MOST_ERRORS} growing distances in centimetres, such as 1,5,20, not '{text}'."
    )
    try:
        errors = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise refusal from error
    growing = all(a < b for a, b in zip([0.0, *errors], [*errors, math.inf], strict=True))
    if not growing or len(errors) > MOST_ERRORS:
        raise refusal
    return errors


def require_packages(kinds: tuple[str, ...], draco: bool = False) -> None:
    """Refuse to begin where a package is missing.

    Raises:
        BadInput: one is, and how to install it.
    """
    needed = {module: name for kind in kinds for module, name in PACKAGES[kind].items()}
    if missing := [name for module, name in needed.items() if not is_installed(module)]:
        raise BadInput(
            f"These models need {', '.join(missing)}; install with: pip install 'mgf-engine[models]', in the engine's "
            "environment, or leave them out with --only."
        )
    if draco and {"lod", "tiles"} & set(kinds) and not is_installed("DracoPy"):
        raise BadInput(
            "Compressed levels of detail need DracoPy; install with: pip install 'mgf-engine[models]', in the engine's "
            "environment, or leave out --draco."
        )
