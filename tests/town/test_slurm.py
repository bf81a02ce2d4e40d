# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf town --executor slurm`` on a real Slurm: its node is lost in the middle, then ``mgf town`` itself is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.synthetic.street import PLACES, Street
from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.town.slurm import cancel_jobs, check_slurm, jobs_in

TOOL = Path(__file__).parents[2] / "tools" / "slurm-here.sh"
NEEDED = ("munged", "slurmctld", "slurmd", "sbatch")


def _reason() -> str:
    """Why Slurm cannot be started here; empty where it can."""
    path = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin"])
    missing = [name for name in NEEDED if shutil.which(name, path=path) is None]
    if missing:
        return f"Slurm is not installed ({', '.join(missing)}): apt install slurmctld slurmd slurm-client munge"
    if os.geteuid() != 0:
        return "tools/slurm-here.sh starts Slurm as root alone"
    return "this machine has a Slurm of its own" if Path("/etc/slurm/slurm.conf").exists() else ""


REASON = _reason()
needs_slurm = pytest.mark.skipif(bool(REASON), reason=REASON)


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], None]]:
    folder = tmp_path_factory.mktemp("slurm")

    def call(action: str) -> None:
        subprocess.run([TOOL, action, folder], check=True, timeout=100)

    try:
        call("start")
        yield call
    finally:
        call("stop")


def command(street: Street, town: Path) -> list[str]:
    map_ = str(street.folder / "footprints.geojson")
    options = ["--footprints-crs", "scene", "--preset", "quick", "--no-texture", "--photos-per-building", "8",
               "--no-terrain"]  # fmt: skip
    return ["town", str(street.folder), "--footprints", map_, "--out", str(town), *options, "--threads", "1",
            "--executor", "slurm"]  # fmt: skip


def wait_until(what: Callable[[], object], seconds: float, run: subprocess.Popen[bytes] | None = None) -> None:
    until = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < until and (run is None or run.poll() is None)
        time.sleep(0.2)


def stages(town: Path) -> list[str]:
    """What each building's job is at."""
    texts = [file.read_text() for file in town.glob("buildings/*/status.json")]
    return [json.loads(text)["stage"] for text in texts]


@needs_slurm
def test_a_lost_node_and_a_killed_town_cost_nothing_that_is_done(
    slurm: Callable[[str], None], short_street: Street, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    town = tmp_path / "town"
    arguments = command(short_street, town)
    run = subprocess.Popen(
        [sys.executable, "-m", "mgf_engine", *arguments], stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),  # as scripts start what runs in the background
    )  # fmt: skip
    wait_until(lambda: len(stages(town)) == 2 and "masks" in stages(town), 120, run)
    first = jobs_in(town)
    assert len(first) == 2  # both slots
    slurm("kill-node")
    wait_until(lambda: "PENDING" in _states(first), 60, run)  # in the queue again
    slurm("start-node")
    wait_until(lambda: _states(first) == {"RUNNING"}, 60, run)
    run.kill()
    run.wait()
    wait_until(lambda: not jobs_in(town), 60)  # Snakemake has cancelled them
    assert not list(town.glob("buildings/*/done.json"))  # they did not just run to their end
    assert main(arguments) == 0
    assert "2 of 2 buildings are done" in capsys.readouterr().out
    for name in PLACES:
        done = json.loads((town / "buildings" / name / "done.json").read_text())
        assert done["attempt"] == 1  # a node that is lost is no reason for smaller photos
    assert (town / "town.glb").is_file()
    wait_until(lambda: not jobs_in(town), 20)


@needs_slurm
def test_a_stopped_town_leaves_no_job_in_the_queue(
    slurm: Callable[[str], None], short_street: Street, tmp_path: Path
) -> None:
    town = tmp_path / "town"
    run = subprocess.Popen(
        [sys.executable, "-m", "mgf_engine", *command(short_street, town)], stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore Ctrl-C
    )  # fmt: skip
    wait_until(lambda: len(jobs_in(town)) == 2, 120, run)
    run.send_signal(signal.SIGINT)
    assert run.wait(100) == 3 and jobs_in(town) == []
    assert run.stderr is not None and b"run again to continue" in run.stderr.read()


def _states(jobs: list[str]) -> set[str]:
    said = subprocess.run(["squeue", "-h", "-o", "%T", "-j", ",".join(jobs)], capture_output=True, text=True)
    return set(said.stdout.split())


@needs_slurm
def test_jobs_of_an_earlier_run_are_ended_and_no_others(slurm: Callable[[str], None], tmp_path: Path) -> None:
    mine, other = tmp_path / "mine", tmp_path / "other"
    for folder in (mine, other):
        folder.mkdir()
        subprocess.run(["sbatch", "-D", folder, "--mem=10", "-o", "/dev/null", "--wrap", "sleep 100"], check=True)
    assert len(jobs_in(mine)) == 1
    assert cancel_jobs(mine) == 1 and jobs_in(mine) == [] and len(jobs_in(other)) == 1
    assert cancel_jobs(other) == 1


def test_a_machine_without_slurm_is_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    arguments = ["town", "photos", "--find", "--out", str(tmp_path / "town"), "--executor", "slurm"]
    assert main(arguments) == 2
    assert "run on a login node" in capsys.readouterr().err and not (tmp_path / "town").exists()
    dead = tmp_path / "sinfo"
    dead.write_text("#!/bin/sh\necho 'slurm_load_partitions: Unable to contact slurm controller' >&2; exit 1\n")
    dead.chmod(0o755)
    (tmp_path / "sbatch").symlink_to(dead)
    with pytest.raises(BadInput, match=r"Slurm does not answer .*Unable to contact slurm controller"):
        check_slurm()
