# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands that compare jobs of generated scenes with the truth and print a table, a row for each job."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mgf_engine.errors import BadInput
from mgf_engine.jobs.job_folder import read_job


def print_job_table(
    prog: str,
    doc: str | None,
    header: Sequence[str],
    row: Callable[[Path, Path, dict[str, Any]], Sequence[Any]],
    argv: Sequence[str] | None,
) -> int:
    """Run such a command: its arguments are job folders.

    Args:
        prog: how the command is called.
        doc: text whose first line says what it does.
        header: of the columns after the scene's name.
        row: job folder, scene folder and the spec of the scene -> the cells of these columns.
        argv: arguments; None takes those of the process.

    Returns:
        The exit code: 0, or 2 where a job cannot be compared, which one sentence on stderr says.
    """
    parser = argparse.ArgumentParser(prog=prog, description=(doc or "").split("\n")[0])
    parser.add_argument("jobs", type=Path, nargs="+", metavar="JOB", help="job folder of a generated scene")
    args = parser.parse_args(argv)
    print("| " + " | ".join(["scene", *header]) + " |")
    print("|---" * (len(header) + 1) + "|")
    for job in args.jobs:
        try:
            scene, record = read_scene_record(job)
            cells = row(job, scene, record["spec"])
        except BadInput as error:
            print(f"Error: {error}", file=sys.stderr)
            return 2
        print("| " + " | ".join(map(str, [record["name"], *cells])) + " |", flush=True)
    return 0


def read_scene_record(job: Path) -> tuple[Path, dict[str, Any]]:
    """Return the folder and the record of the generated scene that a job is of.

    Raises:
        BadInput: the scene is not a generated one.
    """
    scene = Path(read_job(job)["source"])
    try:
        record: dict[str, Any] = json.loads((scene / "scene.json").read_text(encoding="utf-8"))
        record["spec"], record["name"]
    except (OSError, ValueError, KeyError) as error:
        raise BadInput(f"'{scene}' is no generated scene; give jobs of scenes that benchmarks.scenes made.") from error
    return scene, record
