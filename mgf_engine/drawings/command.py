# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf drawings``: facade orthophotos, plans, elevations, sections, sheets and quantities of a finished job."""

from __future__ import annotations

import argparse
import math
import re

from mgf_engine.console.commands import PATIENCE, read_algorithm_options, read_number, run_reported
from mgf_engine.console.shared_arguments import (
    add_algorithm_arguments,
    add_job_argument,
    add_reporting_arguments,
    path_of,
)
from mgf_engine.drawings.kinds import KINDS
from mgf_engine.errors import BadInput
from mgf_engine.messages import Reporter
from mgf_engine.system.machine import is_installed

NEEDED = ("rasterio", "ezdxf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``mgf drawings``."""
    add_job_argument(parser)
    parser.add_argument("--out", type=path_of, metavar="FOLDER", help="where drawings go (default: JOB/drawings)")
    parser.add_argument(
        "--facade", action="append", default=[], metavar="'x,y,z x,y,z x,y,z'",
        help="a facade through three points of the mesh, in its own coordinates, in place of those found; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--resolution", default=None, metavar="MM", help="millimetres per pixel (default: the photos' own)"
    )
    parser.add_argument(
        "--section", action="append", default=[], metavar="NAME=WHERE",
        help="cut at this height above the ground (z=1.2), across a facade at this distance from its left end (A=3.5), "
        "or through a point along a plane with this normal (NAME=x,y,z,nx,ny,nz, coordinates of mesh.ply), in place of "
        "three sections through the middle; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--draw", action="append", default=[], choices=KINDS, help="only these; repeatable (default: everything)"
    )
    parser.add_argument("--paper", choices=("A3", "A1"), default="A3", help="of the sheets (default A3)")
    parser.add_argument(
        "--scale", default=None, metavar="N", help="of the sheets, 1:N (default: the largest round one that fits)"
    )
    add_algorithm_arguments(parser)
    add_reporting_arguments(parser)


def drawings_command(args: argparse.Namespace) -> int:
    """Draw everything that was asked for; returns the exit code."""
    return run_reported(args, lambda reporter: _draw(args, reporter), PATIENCE)


def _draw(args: argparse.Namespace, reporter: Reporter) -> None:
    """Draw.

    Raises:
        BadInput: the job has no mesh, an argument cannot be used, or a package is missing.
    """
    require_packages()
    points = [read_points(text) for text in args.facade]
    millimetres = read_number("--resolution", args.resolution, "a length in millimetres")
    scale = read_number("--scale", args.scale and args.scale.removeprefix("1:"), "the N of 1:N, a number")
    algorithms = read_algorithm_options(args, "drawings")
    from mgf_engine.drawings.make import make_drawings
    from mgf_engine.drawings.work import DrawingOptions

    kinds = frozenset(args.draw or KINDS)
    resolution = None if millimetres is None else millimetres / 1000
    options = DrawingOptions(points, resolution, args.section, args.paper, scale, kinds, algorithms)
    make_drawings(args.job, args.out, options, reporter)


def require_packages() -> None:
    """Refuse to begin where a package is missing.

    Raises:
        BadInput: one is, and how to install it.
    """
    missing = [package for package in NEEDED if not is_installed(package)]
    if missing:
        raise BadInput(
            f"Drawings need {', '.join(missing)}; install with: pip install 'mgf-engine[survey]', in the engine's "
            "environment."
        )


def read_points(text: str) -> list[list[float]]:
    """Read three points from ``x,y,z x,y,z x,y,z``.

    Raises:
        BadInput: they are not three points of three numbers.
    """
    refusal = BadInput(f"--facade takes three points 'x,y,z x,y,z x,y,z', not '{text}'.")
    try:
        points = [[float(number) for number in group.split(",")] for group in re.split(r"[\s;]+", text.strip())]
    except ValueError as error:
        raise refusal from error
    if [len(point) for point in points] != [3, 3, 3] or not all(math.isfinite(v) for point in points for v in point):
        raise refusal
    return points
