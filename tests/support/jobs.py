# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of small scenes, begun and run to the end."""

from __future__ import annotations

import json
import os
import subprocess
import sys

ENVIRONMENT = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE"}


def start(*args: object) -> subprocess.Popen:
    command = [sys.executable, "-m", "mgf_engine", *map(str, args), "--progress", "json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)


def finish(run: subprocess.Popen) -> list[dict]:
    out, err = run.communicate(timeout=400)
    assert "Traceback" not in err, err
    return [json.loads(line) for line in out.splitlines()]
