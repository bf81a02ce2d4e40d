# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf drawings``: facade orthophotos, plans, elevations, sections, sheets and quantities of a finished job."""

from __future__ import annotations

import argparse
import importlib.util
import logging
import math
import re
from pathlib import Path

from mgf_engine.errors import EXIT_DONE, BadInput
from mgf_engine.messages import Reporter
from mgf_engine.terminal import make_sink

NEEDED = {"rasterio": "rasterio", "ezdxf": "ezdxf", "shapely": "shapely"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of ``mgf drawings``."""
    parser.add_argument("job", type=Path, metavar="JOB", help="job folder with a finished mesh")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="where drawings go (default: JOB/drawings)")
    parser.add_argument(
        "--facade", action="append", default=[], metavar="'x,y,z x,y,z x,y,z'",
        help="a facade through three points of the mesh, in its own coordinates, in place of those found; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--resolution", default=None, metavar="MM", help="millimetres per pixel (default: the photos' own)"
    )
    parser.add_argument(
        "--section", action="append", default=[], metavar="NAME=DISTANCE",
        help="cut at this height above the ground (z=1.2), or across a facade at this distance from its left end "
        "(A=3.5), in place of three sections through the middle; repeatable",
    )  # fmt: skip
    parser.add_argument("--paper", choices=("A3", "A1"), default="A3", help="of the sheets (default A3)")
    styles = ("auto", "bar", "plain", "json", "none")
    parser.add_argument("--progress", choices=styles, default="auto", help="how to show progress")


def drawings_command(args: argparse.Namespace) -> int:
    """Draw everything that was asked for; returns the exit code.

    Raises:
        BadInput: the job has no mesh, an argument cannot be used, or a package is missing.
    """
    require_packages()
    points = [read_points(text) for text in args.facade]
    resolution = None if args.resolution is None else read_length("--resolution", args.resolution, "MM") / 1000
    from mgf_engine.drawings.make import DrawingOptions, make_drawings

    logging.getLogger("mgf").addHandler(logging.NullHandler())  # or warnings would come twice
    reporter = Reporter(make_sink(args.progress))
    make_drawings(args.job, args.out, DrawingOptions(points, resolution, args.section, args.paper), reporter)
    return EXIT_DONE


def require_packages() -> None:
    """Refuse to begin where a package is missing.

    Raises:
        BadInput: one is, and how to install it.
    """
    missing = [name for module, name in NEEDED.items() if importlib.util.find_spec(module) is None]
    if missing:
        raise BadInput(
            f"Drawings need {', '.join(missing)}; install with: pip install 'mgf-engine[survey]', in the engine's "
            "environment."
        )


def read_points(text: str) -> list[list[float]]:
    """Three points from ``x,y,z x,y,z x,y,z``.

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


def read_length(flag: str, text: str, unit: str) -> float:
    """A length above 0.

    Raises:
        BadInput: it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise BadInput(f"{flag} takes a length in {unit} above 0, not '{text}'.")
    return value
