# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf evaluate``: compare any mesh with a true one."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of ``mgf evaluate``."""
    parser.add_argument("mesh", type=Path, help="the mesh to judge (PLY, OBJ, GLB)")
    parser.add_argument("--truth", type=Path, required=True, help="the true mesh, in the same coordinates")
    parser.add_argument("--thresholds", type=float, nargs="+", default=[0.05], help="distances that count as right")
    parser.add_argument("--samples", type=int, default=1_000_000, help="points sampled on each mesh")
    parser.add_argument("--scene", type=Path, help="COLMAP scene: true points that no camera saw are left out")
    parser.add_argument("--align", choices=("none", "rigid", "similarity"), default="none", help="register first (ICP)")
    parser.add_argument("--picture", type=Path, help="draw both meshes coloured by distance into this file (z is up)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")


def evaluate_command(args: argparse.Namespace) -> int:
    """Run ``mgf evaluate``; returns the exit code."""
    from mgf_engine.evaluate.geometry import evaluate_command as run

    return run(args)
