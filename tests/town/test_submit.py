# SPDX-License-Identifier: GPL-3.0-or-later
"""Snakemake on a cluster ends with the ``mgf town`` that started it, also where Ctrl-C is ignored."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

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


@pytest.mark.parametrize("before", [signal.SIG_DFL, signal.SIG_IGN])
def test_snakemake_is_interrupted_when_its_input_ends(before: signal.Handlers) -> None:
    """``nohup mgf town … &`` in a script ignores Ctrl-C, and so would all that it starts."""
    run = subprocess.Popen(
        [sys.executable, "-c", _WAITING, "--jobs", "2"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, before),
    )  # fmt: skip
    assert run.stdin is not None and run.stdout is not None
    assert run.stdout.readline().strip() == "['--jobs', '2']"
    said, _ = run.communicate(timeout=50)  # closes its input
    assert said.strip() == "interrupted"
