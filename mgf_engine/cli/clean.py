# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf clean``: list or remove the results of earlier runs of a job."""

from __future__ import annotations

import argparse
import time

from mgf_engine.errors import EXIT_DONE, BadInput
from mgf_engine.jobs.job_folder import locked, read_job
from mgf_engine.jobs.runs import Run, list_runs, remove_runs


def clean_command(args: argparse.Namespace) -> int:
    """List the runs of a job, or remove those that were named.

    Raises:
        BadInput: there is no job, it is in use, or a run cannot be removed.
    """
    read_job(args.job)
    if args.old and args.runs:
        raise BadInput("Give either --old or the numbers of runs, not both.")
    if not args.old and not args.runs:
        _list(list_runs(args.job))
        return EXIT_DONE
    with locked(args.job):
        numbers = [run.number for run in list_runs(args.job)[:-1]] if args.old else args.runs
        removed = remove_runs(args.job, numbers)
    freed = sum(run.size for run in removed)
    print(f"Removed {len(removed)} of the earlier runs, {freed / 1e6:.1f} MB.")
    return EXIT_DONE


def _list(runs: list[Run]) -> None:
    if not runs:
        print("The job has no finished run.")
        return
    print(f"{'run':>4}  {'finished':<16}  {'faces':>9}  {'PSNR':>5}  {'frees MB':>8}  options given")
    for run in runs:
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(run.time))
        faces, psnr = run.figures.get("faces"), run.figures.get("psnr")
        counted, measured = ("" if value is None else str(value) for value in (faces, psnr))
        numbers = f"{counted:>9}  {measured:>5}  {run.size / 1e6:>8.1f}"
        options = " ".join(f"{name}={value}" for name, value in run.user_options.items())
        print(f"{run.number:>4}  {when}  {numbers}  {options}{'  (present result)' if run == runs[-1] else ''}")
    print("'mgf clean JOB --old' removes all but the present result, 'mgf clean JOB 1 2' those two.")
    print("A .blend that shows the mesh of a removed run loses its texture.")
