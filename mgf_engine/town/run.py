# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf town``: plan the buildings, run their jobs with Snakemake, show progress, collect the results."""

from __future__ import annotations

import argparse
import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mgf_engine.console.shared_arguments import path_of
from mgf_engine.console.terminal import format_duration
from mgf_engine.errors import EXIT_BAD_INPUT, EXIT_DONE, BadInput, Cancelled
from mgf_engine.jobs.job_folder import locked
from mgf_engine.system.machine import is_installed
from mgf_engine.town.command import add_arguments as add_plan_arguments
from mgf_engine.town.command import plan_town, time_and_memory
from mgf_engine.town.folder import town_folder
from mgf_engine.town.footprints import TOWN
from mgf_engine.town.page import write_page
from mgf_engine.town.plan import BUILDINGS
from mgf_engine.town.result import CITYJSON, GLB, PAGE, TABLE, TERRAIN, TERRAIN_LOG, TILES, gather, read_rows
from mgf_engine.town.slurm import SLURM, cancel_jobs, check_slurm
from mgf_engine.town.worker import FAILED, FINISHED, RUNNING, STATUS, STOPPED, WAITING
from mgf_engine.town.workflow import LOCAL, LOG, MOST_JOBS, Executor, OptionalProducts, snakemake, write_config

_POLL_SECONDS, _PAGE_SECONDS = 1.0, 5.0  # between two looks at the jobs, and between two writings of the page
MOST_FACES = 20_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``mgf town`` beside the options of jobs."""
    add_plan_arguments(parser)
    parser.add_argument("--cores", type=int, default=0, metavar="N", help="cores for all jobs together (default: all)")
    parser.add_argument(
        "--executor", default=LOCAL, metavar="NAME",
        help="where the jobs run: local, slurm, or another of Snakemake's executors (default: local)",
    )  # fmt: skip
    parser.add_argument(
        "--jobs", type=int, default=MOST_JOBS, metavar="N",
        help=f"jobs in the queue of a cluster at once (default {MOST_JOBS})",
    )  # fmt: skip
    parser.add_argument(
        "--profile", type=path_of, default=None, metavar="FOLDER",
        help="a profile of Snakemake, such as the account and partition of a cluster",
    )  # fmt: skip
    parser.add_argument(
        "--faces-per-building", type=int, default=MOST_FACES, metavar="N", help=f"in town.glb (default {MOST_FACES})"
    )
    parser.add_argument("--tiles", action="store_true", default=False, help="write 3D Tiles of the town as well")
    parser.add_argument("--no-terrain", action="store_true", default=False, help="leave the terrain between them out")
    parser.add_argument("--no-solids", action="store_true", default=False, help="leave their solids (CityJSON) out")
    parser.add_argument(
        "--plan-only", action="store_true", default=False, help="stop before the jobs, as mgf buildings"
    )


def town_command(args: argparse.Namespace, user_options: dict[str, Any]) -> int:
    """Make the town; returns the exit code: 2 where a building failed.

    Raises:
        BadInput: as the plan; Snakemake is not installed or cannot run.
    """
    executor = _check(args)
    with town_folder(args.out, args.scene), _one_town(args.out), _stoppable():
        if executor.name == SLURM and (left := cancel_jobs(args.out)):
            print(f"{left} jobs of an earlier run were ended; they go on where they were.", file=sys.stderr)
        plan = plan_town(args, user_options)
        rows = read_rows(args.out, running=False)
        ready = [row for row in rows if row["job"]]
        if not ready:
            write_page(args.out / PAGE, args.out, rows)
            raise BadInput(f"No building is ready to be reconstructed; '{args.out / PAGE}' says why for each of them.")
        print(time_and_memory(ready), file=sys.stderr)
        if args.plan_only:
            return EXIT_DONE
        clean_status(args.out, ready)
        wanted = OptionalProducts(not args.no_terrain, not args.no_solids)
        memory = write_config(args.out, executor, wanted, len(ready), len(plan.scene.views), user_options)
        code = run_jobs(args.out, executor, memory)
        return finish(args.out, code, args.faces_per_building, args.tiles, wanted)


def _check(args: argparse.Namespace) -> Executor:
    """Check the arguments, and that Snakemake can run.

    Raises:
        BadInput: an argument is impossible, or a program is missing.
    """
    if args.cores < 0 or args.faces_per_building < 100 or args.jobs < 1:
        raise BadInput("--cores must be 0 or more, --jobs 1 or more, and --faces-per-building 100 or more.")
    if not is_installed("snakemake"):
        raise BadInput(f"mgf town needs the package snakemake, which is not installed; get it by {TOWN}.")
    if args.profile is not None and not args.profile.is_dir():
        raise BadInput(f"The profile '{args.profile}' is no folder; give one that holds Snakemake's config.yaml.")
    if args.executor == SLURM:
        check_slurm()
    return Executor(args.executor, args.cores, args.jobs, args.profile)


@contextlib.contextmanager
def _one_town(folder: Path) -> Iterator[None]:
    """Lock the folder, so that nobody else works in it meanwhile.

    Raises:
        BadInput: somebody does.
    """
    try:
        with locked(folder):
            yield
    except BadInput as error:
        if "in use" in str(error):
            raise BadInput(
                f"Another mgf town works in '{folder}'; wait for it, or stop it, or give another folder."
            ) from error
        raise


@contextlib.contextmanager
def _stoppable() -> Iterator[None]:
    """Have SIGTERM stop the town as Ctrl-C does."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def clean_status(town: Path, rows: list[dict[str, Any]]) -> None:
    """Forget what earlier runs said of jobs that are not done."""
    for row in rows:
        if row["job"] != FINISHED:
            (town / BUILDINGS / row["id"] / STATUS).unlink(missing_ok=True)


def run_jobs(town: Path, executor: Executor, memory: int) -> int:
    """Run Snakemake on the folder and show how far it is; returns its exit code.

    Args:
        memory: megabytes for all local jobs together.

    Raises:
        Cancelled: Ctrl-C or SIGTERM.
    """
    try:
        with snakemake(town, executor, memory) as process:
            _watch(town, process)
    except KeyboardInterrupt:
        write_page(town / PAGE, town, read_rows(town, running=False))
        raise Cancelled("Cancelled; run again to continue.") from None
    return int(process.returncode)


def _watch(town: Path, process: subprocess.Popen[bytes]) -> None:
    """Show the table and write the page until the process ends."""
    from rich.console import Console
    from rich.live import Live

    console, written, said = Console(stderr=True), 0.0, dict[str, str]()
    live = Live(console=console, refresh_per_second=2) if console.is_terminal else contextlib.nullcontext()
    try:
        with live as shown:
            while process.poll() is None:
                rows = read_rows(town, running=True)
                if shown is not None:
                    shown.update(buildings_table(rows))
                else:
                    _say_changes(rows, said)
                if time.monotonic() - written > _PAGE_SECONDS:
                    write_page(town / PAGE, town, rows, refresh=5)
                    written = time.monotonic()
                time.sleep(_POLL_SECONDS)
    except KeyboardInterrupt:
        print("Stopping; the jobs at work save what they did.", file=sys.stderr, flush=True)
        raise


def _say_changes(rows: list[dict[str, Any]], said: dict[str, str]) -> None:
    """Print a line for each building whose job went on to something else, for logs and pipes."""
    for row in rows:
        now = f"{row['job']} {row['status'].get('stage', '') if row['job'] == RUNNING else ''}".strip()
        if row["job"] and said.get(row["id"], WAITING) != now:
            said[row["id"]] = now
            print(f"{row['id']}: {now}", file=sys.stderr, flush=True)


def buildings_table(rows: list[dict[str, Any]]) -> Any:
    """Return the buildings as a table for the terminal."""
    from rich.table import Table

    shown = Table(box=None)
    for name, side in (("building", "left"), ("state", "left"), ("job", "left"), ("done", "right"), ("time", "right"),
                       ("photos", "right"), ("confidence", "right"), ("note", "left")):  # fmt: skip
        shown.add_column(name, justify=side)  # type: ignore[arg-type]
    for row in rows:
        status, done = row["status"], row["done"]
        job = row["job"] + (f" ({status['stage']})" if row["job"] == RUNNING and status.get("stage") else "")
        seconds = done.get("seconds", status.get("seconds"))
        note = row["reason"] or (status.get("text", "") if row["job"] in (FAILED, STOPPED) else "")
        tried = " (second attempt)" if done.get("attempt", status.get("attempt", 1)) > 1 else ""
        shown.add_row(
            row["id"], row["state"], job, f"{status.get('overall', 0.0):.0%}" if row["job"] else "",
            format_duration(seconds) if seconds else "", str(len(row["photos"])),
            f"{done['confidence']:.2f}" if done.get("confidence") is not None else "", note + tried,
        )  # fmt: skip
    return shown


def finish(town: Path, code: int, most_faces: int, tiles: bool, wanted: OptionalProducts) -> int:
    """Gather the results, print the table, and say what failed.

    Args:
        town: its folder.
        code: exit code of Snakemake.
        most_faces: of each building in ``town.glb``.
        tiles: 3D Tiles are wanted.
        wanted: what every building's job makes.

    Raises:
        BadInput: Snakemake itself could not run, or a building failed.
    """
    from rich.console import Console

    rows = read_rows(town, running=False)
    gather(town, rows, most_faces, tiles, wanted)
    made = [PAGE, *(name for name in (TABLE, GLB, TILES, CITYJSON) if (town / name).is_file())]
    write_page(town / PAGE, town, rows, files=made[1:])
    Console(width=None if sys.stdout.isatty() else 140).print(buildings_table(rows))
    ready = [row for row in rows if row["job"]]
    bad = [row for row in ready if row["job"] != FINISHED]
    print(f"{len(ready) - len(bad)} of {len(ready)} buildings are done; written to {town}: {', '.join(made)}")
    if bad and all(row["job"] == WAITING for row in bad) and code:
        raise BadInput(f"Snakemake could not run the jobs; '{town / LOG}' says why.")
    if bad:
        print(
            f"Error: {len(bad)} of {len(ready)} buildings failed (first: {bad[0]['id']}); "
            f"'{town / PAGE}' says why, and running again tries them anew.", file=sys.stderr,
        )  # fmt: skip
        return EXIT_BAD_INPUT
    if wanted.terrain and not (town / TERRAIN).is_file():
        print(f"Error: the buildings are done, and their terrain could not be made{_reason(town)}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return EXIT_DONE


def _reason(town: Path) -> str:
    """Return the one sentence of the terrain's log, or where the log is that holds more."""
    log = town / TERRAIN_LOG
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() if log.is_file() else []
    return f": {lines[0]}" if len(lines) == 1 else f"; '{log}' says why."
