# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line in a process of its own."""

import subprocess
import sys


def mgf(*args: object, **more: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "mgf_engine", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **more)  # type: ignore[call-overload]
