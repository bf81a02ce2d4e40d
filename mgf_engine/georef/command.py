# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf georef JOB``: georeference a finished job without repeating its stages."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from mgf_engine.console.commands import run_reported
from mgf_engine.console.shared_arguments import (
    add_algorithm_arguments,
    add_job_argument,
    add_reporting_arguments,
    path_of,
)
from mgf_engine.files.atomic import atomic_path
from mgf_engine.georef.apply import apply_to_finished
from mgf_engine.georef.control_points import CHECK, CONTROL
from mgf_engine.georef.export import FOLDER
from mgf_engine.georef.find import GeoreferenceFit
from mgf_engine.georef.fit_control import ControlRow
from mgf_engine.georef.model import FILE
from mgf_engine.georef.report import facts, rms_figures
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.job_folder import known_options, read_job
from mgf_engine.messages import Reporter
from mgf_engine.options.algorithms import check_used
from mgf_engine.options.config import make_config, option_fields
from mgf_engine.options.user_input import option_pairs, read_config

STAGE = "georef"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``mgf georef`` beside the options of its section."""
    add_job_argument(parser)
    parser.add_argument(
        "--predict", type=path_of, default=None, metavar="FILE",
        help="only write where the control points should appear in the photos (JSON); the job stays as it is",
    )  # fmt: skip
    add_algorithm_arguments(parser)
    add_reporting_arguments(parser)


def georef_command(args: argparse.Namespace) -> int:
    """Find the georeference, write it and the mesh in true coordinates, print what was found."""
    return run_reported(args, lambda reporter: _georef(args, reporter))


def _georef(args: argparse.Namespace, reporter: Reporter) -> None:
    """Do it.

    Raises:
        BadInput: the job is not finished, or what the user gave cannot be used; the job is then as it was.
    """
    user_options = read_options(args)
    reporter.stages = (STAGE,)
    reporter.stage(STAGE)
    if args.predict is not None:
        from mgf_engine.georef.predict import write_places

        count = write_places(args.job, user_options, args.predict, reporter)
        reporter.send("result", path=str(args.predict), files={}, figures={"points": count})
        return
    record = args.job / "job.json"
    before = record.read_bytes() if record.is_file() else None
    earlier = read_job(args.job)
    earlier_options = known_options(earlier["given"], reporter.warning)
    try:
        adjusted = cameras_adjusted(earlier)
        job, kept = _open(args.job, user_options, earlier_options, adjusted)
        if kept and adjusted:
            reporter.warning(
                "Control points moved the cameras of this job when its scene was made; a check point of today that was "
                "among them checks nothing."
            )
        with job:
            fit = apply_to_finished(job, reporter)
    except BaseException:
        if before is not None:  # the job does not keep options that it cannot use
            with atomic_path(record) as temporary:
                temporary.write_bytes(before)
        raise
    if args.progress == "json":
        reporter.send("result", path=str(args.job), files={FILE: str(args.job / FILE)}, figures=rms_figures(fit))
        return
    reporter.progress(1.0)
    reporter.close()
    _print(fit)
    if kept:
        flags = "--resume" if adjusted else "--resume --control-adjust"
        print(f"The cameras stayed as they are; 'mgf reconstruct {flags}' adjusts them to these points as well.")
    models = f" and {args.job / FOLDER}" if fit.georeference.metric else ""
    print(f"Written to {args.job / FILE}{models}")


def read_options(args: argparse.Namespace) -> dict[str, Any]:
    """Collect the options of ``--config``, ``--set`` and the flags, later ones first.

    Raises:
        BadInput: an option that the command does not use, or a value that the option does not take.
    """
    names = [f.name for f in option_fields() if f.metadata["section"] == STAGE]
    flags = {name: value for name, value in vars(args).items() if name in names}
    user_options = {**(read_config(args.config) if args.config else {}), **option_pairs(args.set)}
    check_used(STAGE, (name for name in user_options if name not in names))
    make_config(user_options)
    return {**user_options, **flags}


def _open(
    folder: Path, user_options: dict[str, Any], earlier_options: dict[str, Any], adjusted: bool
) -> tuple[Job, bool]:
    """Return the job with new options, and whether control points would have moved its cameras, which are left
    alone: the next run adjusts those that others moved before, and keeps those that none did.

    Args:
        folder: of the job.
        user_options: new options.
        earlier_options: options that the job was made with.
        adjusted: control points moved its cameras.
    """
    job = Job.start(folder, user_options=user_options, resume=True, earlier_options=earlier_options)
    if job.done("scene") or not job.adjusts_to_control:
        return job, False
    if adjusted:
        return job, True
    job.close()
    return Job.start(
        folder, user_options={**user_options, "control_adjust": False}, resume=True, earlier_options=earlier_options
    ), True


def cameras_adjusted(record: dict[str, Any]) -> bool:
    """Tell whether control points moved the cameras of a job, by the options in its record."""
    options = record.get("config")
    return isinstance(options, dict) and bool(options.get("control")) and bool(options.get("control_adjust"))


def _print(fit: GeoreferenceFit) -> None:
    """Print the georeference with the residuals of points and scale bars."""
    for label, text in facts(fit):
        print(f"{label}: {text}")
    for role in (CONTROL, CHECK):
        rows = [] if fit.control is None else [r for r in fit.control.rows if r.point.role == role]
        for row in rows:
            said = (f"{role:<8} {row.point.name:<12}", *_residual(row), row.note)
            print("  " + "  ".join(part for part in said if part).rstrip())
    for bar in fit.bars:
        print(
            f"  bar {bar.bar.name}: given {bar.bar.length:.4f} m, found {bar.found:.4f} m ({1000 * bar.error:+z.1f} mm)"
        )
    for text in fit.notes:
        print(text)


def _residual(row: ControlRow) -> tuple[str, ...]:
    """Return a point's residual and that of its marks; nothing where it could not be placed."""
    if not math.isfinite(row.distance):
        return ()
    east, north, height = (1000 * value for value in row.residual)
    residual = f"east {east:+8.1f}  north {north:+8.1f}  height {height:+8.1f} mm"
    return residual, f"marks {row.pixels:.2f} px in {row.photos} photos"
