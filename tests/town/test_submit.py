# SPDX-License-Identifier: GPL-3.0-or-later
"""What Snakemake is told: to end with the ``mgf town`` that started it, and where a job's words go."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine.files.atomic import write_json
from mgf_engine.town.workflow import Executor, OptionalProducts, snakemake_arguments, write_config

#: Snakemake's command line that waits, in the place of the real one, and says how it ended.
_WAITING = """
import time, snakemake.cli
def wait(arguments):
    try:
        print(arguments, flush=True)
        time.sleep(60)
        print("ran to the end")
    except KeyboardInterrupt:
        print("interrupted")
snakemake.cli.main = wait
from mgf_engine.town.submit import main
main()
"""


def test_snakemake_is_interrupted_when_its_input_ends() -> None:
    """``nohup mgf town … &`` in a script ignores Ctrl-C, and so would all that it starts."""
    run = subprocess.Popen(
        [sys.executable, "-c", _WAITING, "--jobs", "2"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )  # fmt: skip
    assert run.stdin is not None and run.stdout is not None
    assert run.stdout.readline().strip() == "['--jobs', '2']"
    said, _ = run.communicate(timeout=50)  # closes its input
    assert said.strip() == "interrupted"


@pytest.mark.parametrize(("attempt", "solids"), [(1, False), (2, True)])
def test_a_second_attempt_adds_to_what_the_first_one_wrote(tmp_path: Path, attempt: int, solids: bool) -> None:
    folder = tmp_path / "buildings" / "left"
    folder.mkdir(parents=True)
    for name in ("prompts.json", "building.json"):
        (folder / name).write_text("{}")
    row = {"id": "left", "state": "ready", "estimate": {"bytes": 4e8}, "photos": []}
    write_json(tmp_path / "buildings.json", {"buildings": [row]})
    write_config(tmp_path, Executor(), OptionalProducts(False, solids), 1, 20, {"threads": 2})
    command = [
        sys.executable,
        "-m",
        "snakemake",
        *snakemake_arguments(Executor(), 4000),
        "--dry-run",
        "--printshellcmds",
    ]
    done = subprocess.run([*command, "--attempt", str(attempt)], cwd=tmp_path, capture_output=True, text=True)
    (line,) = [line for line in (done.stdout + done.stderr).splitlines() if "mgf_engine.town.worker" in line]
    assert f"if [ {attempt} = 1 ]; then rm -f buildings/left/worker.txt; fi" in line
    solid = " --solid" if solids else ""  # in the same process
    assert f"--attempt {attempt} --threads 2{solid} >> buildings/left/worker.txt 2>&1" in line
