# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments that several commands share: paths, options by name, and how progress is shown."""

from __future__ import annotations

import argparse
from pathlib import Path

STYLES = ("auto", "bar", "plain", "json", "none")


def path_of(text: str) -> Path:
    """Convert the text of an argument to a path; ``type`` of arguments that are paths.

    Raises:
        ArgumentTypeError: it is empty, which pathlib would read as the current folder.
    """
    if not text:
        raise argparse.ArgumentTypeError("is empty; give a path")
    return Path(text)


def add_job_argument(parser: argparse.ArgumentParser) -> None:
    """Add the job folder of a command that works on finished jobs."""
    parser.add_argument("job", type=path_of, metavar="JOB", help="folder of a finished job")


def add_config_arguments(
    parser: argparse.ArgumentParser,
    metavar: str = "NAME=VALUE",
    help: str = "set any option by name, as max_faces=5 or mesh.max_faces=5; repeatable",
) -> None:
    """Add options by name, from a file and from the command line.

    Args:
        parser: of the command.
        metavar: what ``--set`` takes.
        help: of ``--set``.
    """
    parser.add_argument("--config", type=path_of, default=None, metavar="FILE", help="read options from a JSON file")
    parser.add_argument("--set", action="append", default=[], metavar=metavar, help=help)


def add_algorithm_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of the algorithms that the command runs (:mod:`mgf_engine.options.algorithms`)."""
    add_config_arguments(
        parser,
        "SECTION.NAME=VALUE",
        "set an option of an algorithm ('mgf options --algorithms' lists them); repeatable",
    )


def add_reporting_arguments(parser: argparse.ArgumentParser) -> None:
    """Add how progress is shown, and how the add-on cancels a run."""
    parser.add_argument("--progress", choices=STYLES, default="auto", help="style of messages (default auto)")
    parser.add_argument("--cancel-on-eof", action="store_true", default=False, help="cancel when standard input closes")
