# SPDX-License-Identifier: GPL-3.0-or-later
"""300 random operators, undos, redos, scene switches, saves and reopenings, see :mod:`walk`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("seed", [5, 21])  # each ended Blender once
def test_a_random_walk_ends_well(seed, engine, tmp_path):
    command = [sys.executable, str(Path(__file__).with_name("walk.py")), str(seed), "300", str(tmp_path)]
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (here.parents[1], here.parent, here)))}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    if done.returncode or "survived" not in done.stdout:
        pytest.fail(f"ended with {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}", pytrace=False)
