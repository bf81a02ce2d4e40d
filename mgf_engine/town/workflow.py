# SPDX-License-Identifier: GPL-3.0-or-later
"""Snakemake for a town: its command line on this machine or on a cluster, its configuration, and its process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mgf_engine.files.atomic import write_json
from mgf_engine.system.machine import cores
from mgf_engine.system.memory import budget_of
from mgf_engine.town.slurm import SLURM, cancel_jobs, slurm_arguments

SNAKEFILE = Path(__file__).with_name("Snakefile")
CONFIG, LOG = "town.json", "snakemake.txt"
LOCAL = "local"
#: Cores of a job on a cluster, where nothing tells how many there are; and jobs in its queue at once.
CLUSTER_THREADS, MOST_JOBS = 2, 100
_SHARED_DISK = 60  # seconds until a file that a node wrote is seen here
_STOP = 180.0  # seconds for Snakemake to cancel what it submitted


@dataclass(frozen=True)
class Executor:
    """Where the jobs run.

    Attributes:
        name: ``local``, ``slurm``, or another of Snakemake's executors whose plugin is installed.
        cores: of this machine that local jobs take together; 0 for all.
        jobs: in the queue of a cluster at once.
        profile: folder of a Snakemake profile, or None.
    """

    name: str = LOCAL
    cores: int = 0
    jobs: int = MOST_JOBS
    profile: Path | None = None

    @property
    def local(self) -> bool:
        """Whether the jobs run on this machine, under this process."""
        return self.name == LOCAL


@dataclass(frozen=True)
class OptionalProducts:
    """Whether terrain and solids are made, too."""

    terrain: bool = True
    solids: bool = True


def write_config(
    town: Path, executor: Executor, wanted: OptionalProducts, buildings: int, photos: int, user_options: dict[str, Any]
) -> int:
    """Write what the Snakefile wants to know.

    Args:
        town: its folder.
        executor: where the jobs run.
        wanted: what every building's job makes.
        buildings: that will run; photos: of the whole scene.
        user_options: options of jobs.

    Returns:
        The megabytes that all local jobs may take together; 0 on a cluster.
    """
    number = executor.cores or cores()
    usual = max(1, number // buildings) if executor.local else CLUSTER_THREADS
    allowed = float(user_options.get("memory", 0))
    memory = round(budget_of(allowed) / 1e6) if executor.local else round(allowed * 1000)
    values = {
        "python": sys.executable, "threads": int(user_options.get("threads", 0)) or usual, "memory_mb": memory,
        "photos": photos, "terrain": wanted.terrain, "solids": wanted.solids,
    }  # fmt: skip
    write_json(town / CONFIG, values)
    return memory if executor.local else 0


def snakemake_arguments(executor: Executor, memory: int) -> list[str]:
    """Return arguments of Snakemake in the folder of a town.

    Args:
        memory: megabytes for all local jobs together.
    """
    arguments = [
        "-s", str(SNAKEFILE), "--configfile", CONFIG, "--keep-going", "--rerun-triggers", "mtime",
        "--ignore-incomplete", "--nolock", "--quiet", "host",
    ]  # fmt: skip
    if executor.local:
        number = executor.cores or cores()
        arguments += ["--cores", str(number), "--resources", f"mem_mb={memory}", "--latency-wait", "2"]
    else:
        chosen = slurm_arguments() if executor.name == SLURM else ["--executor", executor.name]
        arguments += [*chosen, "--jobs", str(executor.jobs), "--latency-wait", str(_SHARED_DISK)]
    if executor.profile is not None:
        arguments += ["--profile", str(executor.profile.resolve())]
    return arguments


@contextmanager
def snakemake(town: Path, executor: Executor, memory: int) -> Iterator[subprocess.Popen[bytes]]:
    """Run Snakemake on a town; stopped, with its jobs, when the block is left by an exception."""
    module = "snakemake" if executor.local else "mgf_engine.town.submit"
    command = [sys.executable, "-m", module, *snakemake_arguments(executor, memory)]
    environment = {**os.environ, "PYTHONPATH": _with_engine()}
    environment.pop("MGF_TOWN_PIPE", None)
    if executor.local:  # the jobs inherit standard input: they stop when this process ends, however that happens
        environment["MGF_TOWN_PIPE"] = "1"
    with (town / LOG).open("ab") as log:
        process = subprocess.Popen(
            command, cwd=town, stdin=subprocess.PIPE, stdout=log, stderr=log, env=environment, start_new_session=True
        )
        try:
            yield process
        except BaseException:
            _stop(process, town, executor)
            raise


def _stop(process: subprocess.Popen[bytes], town: Path, executor: Executor) -> None:
    """End Snakemake and its jobs: at once on this machine; on a cluster after it has cancelled what it submitted."""
    assert process.stdin is not None
    if executor.local:
        process.terminate()
        process.stdin.close()
        process.wait()
        return
    process.stdin.close()  # which interrupts it once: it cancels what it submitted
    try:
        process.wait(_STOP)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if executor.name == SLURM:
        cancel_jobs(town)


def _with_engine() -> str:
    """Return ``PYTHONPATH`` that has this engine first, wherever Snakemake runs its jobs."""
    return os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH", "")])])
