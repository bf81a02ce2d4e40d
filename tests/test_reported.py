# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands on finished jobs say each thing once."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import argparse
from mgf_engine.reported import run_reported

args = argparse.Namespace(progress="plain", cancel_on_eof=False)
raise SystemExit(run_reported(args, lambda reporter: reporter.warning("The roof is missing.")))
"""


def test_a_warning_is_printed_once_where_there_is_no_log() -> None:
    """Python's logging prints warnings that nobody takes; pytest takes them, so this needs a process of its own."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert (done.stdout + done.stderr).count("The roof is missing.") == 1
