# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf evaluate``: compare any mesh with a true one."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mgf_engine.errors import EXIT_DONE, BadInput
from mgf_engine.system import write_json

if TYPE_CHECKING:
    from mgf_engine.evaluate.geometry import GeometryScores


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of ``mgf evaluate``."""
    parser.add_argument("mesh", type=Path, help="the mesh to judge (PLY, OBJ, GLB)")
    parser.add_argument("--truth", type=Path, required=True, help="the true mesh, in the same coordinates")
    parser.add_argument("--thresholds", type=float, nargs="+", default=[0.05], help="distances that count as right")
    parser.add_argument("--samples", type=int, default=1_000_000, help="points sampled on each mesh")
    parser.add_argument("--scene", type=Path, help="COLMAP scene: true points that no camera saw are left out")
    parser.add_argument("--leave-out", type=Path, help="mesh of a part of the truth that is not judged, on either side")
    parser.add_argument("--align", choices=("none", "rigid", "similarity"), default="none", help="register first (ICP)")
    parser.add_argument("--picture", type=Path, help="draw both meshes coloured by distance into this file (z is up)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")


def evaluate_command(args: argparse.Namespace) -> int:
    """Print the scores as a table and, on request, write them as JSON and draw them; returns the exit code.

    Raises:
        BadInput: a mesh or scene that cannot be used, impossible numbers, or a place that cannot be written.
    """
    # The command line asks this module for its arguments; it need not load scipy and igl for that.
    from mgf_engine.evaluate.error_map import write_error_map
    from mgf_engine.evaluate.geometry import colmap_cameras, moved, score_surface
    from mgf_engine.evaluate.surfaces import read_surface

    cameras = colmap_cameras(args.scene) if args.scene else None
    mesh, truth = read_surface(args.mesh), read_surface(args.truth)
    leave_out = read_surface(args.leave_out) if args.leave_out else None
    scores = score_surface(mesh, truth, args.thresholds, args.samples, cameras, align=args.align, leave_out=leave_out)
    print(table(scores))
    if args.picture:
        write_error_map(args.picture, moved(mesh, scores.alignment), truth, min(args.thresholds))
    if args.json:
        try:
            write_json(args.json, scores.as_dict())
        except OSError as error:
            raise BadInput(f"Cannot write the figures '{args.json}' ({error.strerror}); give another place.") from error
    return EXIT_DONE


def table(scores: GeometryScores) -> str:
    """The scores as people read them."""
    rows = ["threshold  accuracy  completeness      F1"]
    for row in zip(scores.thresholds, scores.accuracy, scores.completeness, scores.f1, strict=True):
        rows.append("{:9g}  {:7.2f}%  {:11.2f}%  {:5.2f}%".format(*row))
    rows.append(
        f"mesh to truth: mean {scores.mean_error:.4g}, median {scores.median_error:.4g}; "
        f"truth to mesh: mean {scores.mean_gap:.4g}, median {scores.median_gap:.4g}"
    )
    clean = scores.hygiene
    rows.append(
        f"{clean.faces} faces in {clean.components} parts, {clean.holes} holes, {clean.non_manifold_edges} "
        f"non-manifold edges; {scores.truth_seen:.1f}% of the truth seen"
    )
    return "\n".join(rows)
