# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of a town on a Slurm cluster: what Snakemake has to be told, and the end of jobs that an earlier run left."""

from __future__ import annotations

import getpass
import shutil
import subprocess
import time
from pathlib import Path

from mgf_engine.errors import BadInput
from mgf_engine.system.machine import is_installed
from mgf_engine.town.footprints import TOWN

SLURM = "slurm"
_ANSWER = 60.0  # seconds that Slurm's commands may take
_END, _LOOK = 120.0, 1.0  # seconds for cancelled jobs to end (Slurm's KillWait is 30), and between two looks at them


def check_slurm() -> None:
    """Check that Slurm answers here, and that Snakemake can talk to it.

    Raises:
        BadInput: it does not.
    """
    if not is_installed("snakemake_executor_plugin_slurm"):
        raise BadInput(
            "--executor slurm needs the package snakemake-executor-plugin-slurm, "
            f"which is not installed; get it by {TOWN}."
        )
    if shutil.which("sbatch") is None:
        raise BadInput("--executor slurm needs Slurm's commands (sbatch), which are not here; run on a login node.")
    _ask("sinfo", "--noheader")


def slurm_arguments() -> list[str]:
    """Return the arguments of Snakemake: a job that lost its node goes back into the queue and is no failure of the
    building."""
    return [
        "--executor", SLURM, "--slurm-requeue", "--slurm-status-command", "sacct" if _accounts() else "squeue",
        "--slurm-init-seconds-before-status-checks", "2",
    ]  # fmt: skip


def _accounts() -> bool:
    """Tell whether the cluster keeps accounts of its jobs; else the queue must tell how a job ended."""
    try:
        command = ["sacct", "--noheader", "--starttime", "now"]
        return subprocess.run(command, capture_output=True, timeout=_ANSWER).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def jobs_in(town: Path) -> list[str]:
    """Return numbers of the jobs in the queue that work in the folder of a town.

    Raises:
        BadInput: Slurm does not answer.
    """
    lines = _ask("squeue", "--noheader", "--user", getpass.getuser(), "--format", "%A|%Z").splitlines()
    pairs = [line.strip().split("|", 1) for line in lines if "|" in line]
    return sorted({number for number, folder in pairs if Path(folder).resolve() == town.resolve()})


def cancel_jobs(town: Path) -> int:
    """End the jobs that an earlier run of a town left in the queue, and wait for it; their number.

    Each has saved what it did, and goes on from there when it is started again.

    Raises:
        BadInput: Slurm does not answer, or they do not end.
    """
    found = jobs_in(town)
    if not found:
        return 0
    _ask("scancel", *found)
    until = time.monotonic() + _END
    while left := jobs_in(town):
        if time.monotonic() > until:
            raise BadInput(f"Slurm does not end the jobs {', '.join(left)} of an earlier run; end them by scancel.")
        time.sleep(_LOOK)
    return len(found)


def _ask(*command: str) -> str:
    """Run one of Slurm's commands and return its output."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_ANSWER)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BadInput(f"Slurm does not answer ({command[0]}: {error}); ask who looks after the cluster.") from error
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        raise BadInput(f"Slurm does not answer ({command[0]}: {said[0]}); ask who looks after the cluster.")
    return done.stdout
