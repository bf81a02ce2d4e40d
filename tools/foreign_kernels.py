#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the tests of the kernels on those of another processor or system: ``tools/foreign_kernels.py windows-x86_64``.

The target's kernels run in an emulator (ARM: ``apt install qemu-user``; Windows: ``apt install wine wine64``) and are
called by the tests in place of this machine's, see ``tests/foreign``. Minutes; ends with code 1 where a test fails or a
kernel was never called. Paths and options behind the target go to pytest instead of the whole list.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from foreign.remote import EMULATORS, PACKAGES, emulator_of, exported  # noqa: E402

#: Tests that compare kernels with references, with other libraries, or with what must hold.
TESTS = (
    "raster/test_render_edges.py", "raster/test_adam.py", "raster/test_point_opacity.py", "field/test_losses.py",
    "model/test_topology.py", "geometry/test_rasterize.py", "mesh/test_tsdf.py", "mesh/test_photometric.py",
    "mesh/test_depth_smoothing.py", "mesh/test_planar_clustering.py", "mesh/test_decimate.py", "mesh/test_colors.py",
    "masks/refinement/test_patch_ncc.py", "masks/geometry/test_point_surface.py",
    "masks/propagation/test_superpixels.py", "start/test_smoothing.py", "start/test_start_kernels.py",
    "start/test_cut_graph.py", "scene/test_patch_match.py", "benchmarks/test_roofline.py",
)  # fmt: skip
#: Other backends do not call the kernels, other variants are not those of the target.
CHOSEN = "not cuda and not reference and not v3 and not v4"


def run(target: str, given: list[str]) -> tuple[int, dict[str, int]]:
    """pytest's exit code, and how often each kernel was called."""
    with tempfile.TemporaryDirectory() as folder:
        calls = Path(folder) / "calls.json"
        environment = {**os.environ, "MGF_TEST_KERNELS": target, "MGF_TEST_KERNELS_CALLS": str(calls),
                       "PYTHONPATH": str(ROOT), "WINEDEBUG": "-all"}  # fmt: skip
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *given]
        code = subprocess.run(command, cwd=ROOT, env=environment).returncode
        return code, json.loads(calls.read_text()) if calls.is_file() else {}


def main() -> int:
    parser = argparse.ArgumentParser(description="Run the tests of the kernels on another machine's, in an emulator.")
    parser.add_argument("target", choices=EMULATORS)
    args, given = parser.parse_known_args()
    if emulator_of(args.target) is None:
        print(f"{EMULATORS[args.target]} is not installed; run '{PACKAGES[EMULATORS[args.target]]}'.")
        return 2
    code, calls = run(args.target, given or ["-k", CHOSEN, *(f"tests/{name}" for name in TESTS)])
    missing = sorted(set(exported()) - set(calls))
    print(f"{args.target}: {len(calls)} of {len(exported())} kernels, {sum(calls.values())} calls")
    if missing and not given:
        print(f"never called: {', '.join(missing)}")
    return 1 if code or (missing and not given) else 0


if __name__ == "__main__":
    sys.exit(main())
