# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf evaluate``: compare any mesh with a true one, and measure how even its walls are."""

from __future__ import annotations

import argparse
import errno
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mgf_engine.console.shared_arguments import path_of
from mgf_engine.errors import EXIT_DONE, BadInput, reason
from mgf_engine.files.atomic import write_json

if TYPE_CHECKING:
    from mgf_engine.evaluation.evenness import Evenness
    from mgf_engine.evaluation.scores import GeometryScores, MaterialScores
    from mgf_engine.evaluation.surfaces import Surface


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``mgf evaluate``."""
    parser.add_argument("mesh", type=path_of, help="mesh to evaluate (PLY, OBJ or GLB), or a job folder")
    parser.add_argument(
        "--scan", type=path_of, help="laser scan to measure the mesh by (LAS, LAZ, E57 or PLY), registered by ICP first"
    )
    parser.add_argument(
        "--reach", type=float, default=None,
        help="distance beyond which scan points belong to something else (default: 2%% of the size of the mesh)",
    )  # fmt: skip
    parser.add_argument(
        "--truth", type=path_of,
        help="true mesh in the same coordinates; NAME_materials.json and .npy beside it add scores by material",
    )  # fmt: skip
    parser.add_argument(
        "--thresholds", type=float, nargs="+", default=[0.05], help="distance thresholds (default 0.05)"
    )
    parser.add_argument("--samples", type=int, default=1_000_000, help="points sampled on each mesh (default 1000000)")
    parser.add_argument(
        "--scene", type=path_of,
        help="COLMAP project: excludes true points that no camera sees, and gives evenness in pixels",
    )  # fmt: skip
    parser.add_argument(
        "--photo-size",
        type=int,
        default=750,
        help="longest side of the photos whose pixels are the unit of evenness (default 750)",
    )
    parser.add_argument("--leave-out", type=path_of, help="mesh of a part of the truth to exclude from the scores")
    parser.add_argument("--align", choices=("none", "rigid", "similarity"), default=None,
                        help="align first (ICP; default: rigid for a scan, else none)")  # fmt: skip
    parser.add_argument("--picture", type=path_of, help="write a picture of both meshes coloured by distance (z is up)")
    parser.add_argument("--json", type=path_of, help="also write the scores to this JSON file")


def evaluate_command(args: argparse.Namespace) -> int:
    """Print the scores as a table and, on request, write them as JSON and draw them; returns the exit code.

    Raises:
        BadInput: a mesh or scene that cannot be used, impossible numbers, or a place that cannot be written.
    """
    _check(args)
    figures = dict[str, Any]()
    if args.scan is not None:
        figures["scan"] = _compare_with_scan(args, _read_mesh(args.mesh))
    if args.truth is not None or args.scene is not None:
        figures |= _measure(args)
    if args.json:
        try:
            write_json(args.json, figures)
        except OSError as error:
            raise BadInput(f"Cannot write the figures '{args.json}' ({error.strerror}); give another place.") from error
    return EXIT_DONE


def _measure(args: argparse.Namespace) -> dict[str, Any]:
    """Print what the truth and the evenness of the walls say about the mesh; returns the figures."""
    # The command line asks this module for its arguments; it need not load scipy and igl for that.
    from mgf_engine.evaluation.evenness import measure_evenness
    from mgf_engine.evaluation.model_cameras import colmap_pixel

    mesh, figures = _read_mesh(args.mesh, georeferenced=args.scene is None), dict[str, Any]()
    if args.truth is not None:
        scores = _compare(args, mesh)
        print(format_scores(scores))
        figures |= scores.as_dict()
    if args.scene is not None:
        evenness = measure_evenness(mesh, colmap_pixel(args.scene, args.photo_size))
        print(evenness_table(evenness))
        figures["evenness"] = evenness.as_dict()
    return figures


def _check(args: argparse.Namespace) -> None:
    from mgf_engine.evaluation.scores import check_thresholds

    if args.truth is None and args.scene is None and args.scan is None:
        raise BadInput("Nothing to compare the mesh with; give --truth MESH, --scan FILE or --scene FOLDER.")
    if args.truth is not None and args.scan is not None:
        raise BadInput("A mesh is measured by a true mesh or by a scan; give --truth or --scan, not both.")
    other = args.truth or args.scan
    if other is None and (args.picture or args.align is not None):
        raise BadInput("--picture and --align compare with a true mesh or a scan; give --truth or --scan, too.")
    if args.truth is None and args.leave_out:
        raise BadInput("--leave-out compares with a true mesh; give --truth MESH, too.")
    if args.json is not None and args.json.is_dir():  # before minutes of work
        raise BadInput(f"Cannot write the figures '{args.json}' ({os.strerror(errno.EISDIR)}); give another place.")
    check_thresholds(args.thresholds)
    if args.reach is not None and not 0 < args.reach < float("inf"):
        raise BadInput(f"--reach takes a distance above 0, not {args.reach:g}.")
    if not 1 <= args.photo_size <= 100_000:
        raise BadInput(f"--photo-size must be 1 to 100000 pixels, not {args.photo_size}.")


def _compare(args: argparse.Namespace, mesh: Surface) -> GeometryScores:
    """Score against the truth, with the picture that was asked for."""
    from mgf_engine.evaluation.error_map import write_error_map
    from mgf_engine.evaluation.geometry import ComparisonOptions, score_surface, transform_mesh
    from mgf_engine.evaluation.materials import read_materials
    from mgf_engine.evaluation.model_cameras import colmap_cameras
    from mgf_engine.evaluation.surfaces import read_surface

    cameras = colmap_cameras(args.scene) if args.scene else None
    truth = read_surface(args.truth)
    materials = read_materials(args.truth, len(truth.faces))
    leave_out = read_surface(args.leave_out) if args.leave_out else None
    options = ComparisonOptions(args.samples, cameras, align=args.align or "none")
    scores = score_surface(mesh, truth, args.thresholds, options, leave_out, materials)
    if args.picture:
        write_error_map(args.picture, transform_mesh(mesh, scores.alignment), truth, min(args.thresholds))
    return scores


def _read_mesh(path: Path, georeferenced: bool = True) -> Surface:
    """Read a mesh file, or the mesh of a job.

    Args:
        path: file or job folder.
        georeferenced: whether a job's mesh is read in the coordinates of its CRS where it has them; else in those of
            its COLMAP model.

    Raises:
        BadInput: the mesh or its georeference cannot be read.
    """
    from mgf_engine.evaluation.surfaces import Surface, read_surface

    if not path.is_dir():
        return read_surface(path)
    folder = path / "georeferenced"
    if not georeferenced or not (folder / "mesh.ply").is_file():
        return read_surface(path / "mesh.ply")
    found = read_surface(folder / "mesh.ply")
    try:
        offset = np.array(json.loads((folder / "georef.json").read_text(encoding="utf-8"))["offset"], np.float64)
        return Surface(found.vertices + offset, found.faces, str(path))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(
            f"The georeference in '{folder}' cannot be used ({reason(error)}); run 'mgf georef' again."
        ) from error


def _compare_with_scan(args: argparse.Namespace, mesh: Surface) -> dict[str, Any]:
    """Print what a scan says about the mesh, and draw it where that was asked for; returns the figures."""
    from mgf_engine.evaluation.scan import ScanOptions, compare_with_scan, scan_table
    from mgf_engine.evaluation.scan_files import read_scan
    from mgf_engine.evaluation.scan_picture import write_scan_picture
    from mgf_engine.evaluation.surfaces import Surface

    scan = read_scan(args.scan)
    origin = mesh.vertices.mean(0)  # near which ICP is exact, also at the size of UTM
    local = Surface(mesh.vertices - origin, mesh.faces, str(args.mesh))
    scores, found = compare_with_scan(
        local, scan - origin, args.align or "rigid", args.thresholds, ScanOptions(args.reach)
    )
    print(scan_table(scores))
    if args.picture:
        metres = (args.mesh / "georeferenced" / "mesh.ply").is_file()
        write_scan_picture(args.picture, local, found, scores.reach, " m" if metres else "")
    return {**scores.as_dict(), "origin": origin.tolist()}


def format_scores(scores: GeometryScores) -> str:
    """Return the scores as people read them."""
    rows = ["threshold  accuracy  completeness      F1"]
    for row in zip(scores.thresholds, scores.accuracy, scores.completeness, scores.f1, strict=True):
        rows.append("{:9g}  {:7.2f}%  {:11.2f}%  {:5.2f}%".format(*row))
    rows.append(
        f"mesh to truth: mean {scores.mean_error:.4g}, median {scores.median_error:.4g}; "
        f"truth to mesh: mean {scores.mean_gap:.4g}, median {scores.median_gap:.4g}"
    )
    clean = scores.hygiene
    rows.append(
        f"faces {clean.faces:,}, parts {clean.components}, holes {clean.holes}, non-manifold edges "
        f"{clean.non_manifold_edges}; {scores.truth_seen:.1f}% of the truth seen"
    )
    if scores.normal_median is not None:
        rows.append(f"normals: median {scores.normal_median:.1f}, 90% below {scores.normal_90:.1f} degrees off")
    if scores.materials:
        rows.append("")
        head = "".join(f"  {f'F1 at {t:g}':>12}" for t in scores.thresholds)
        rows.append(f"{'material':20}  share{head}  normals: median   90%")
        rows += [_material_row(name, material) for name, material in scores.materials.items()]
    return "\n".join(rows)


def _material_row(name: str, scores: MaterialScores) -> str:
    known = scores.normal_median is not None and scores.normal_90 is not None
    normals = f"{scores.normal_median:15.1f} {scores.normal_90:5.1f}" if known else f"{'-':>15} {'-':>5}"
    return f"{name:20} {scores.share:5.1f}%" + "".join(f"  {value:11.2f}%" for value in scores.f1) + f"  {normals}"


def evenness_table(evenness: Evenness) -> str:
    """Return the largest planes as people read them."""
    mean = evenness.mean
    if mean is None:
        return "evenness: the mesh has no plane to measure"
    rows = ["plane  share  RMS (pixels)  angle: median   90%  90% away from edges"]
    planes = [(str(k + 1), plane) for k, plane in enumerate(evenness.planes)]
    for name, plane in [*planes, ("all", mean)]:
        rows.append(
            f"{name:>5} {100 * plane.share:5.1f}% {plane.rms:13.3f} {plane.angle_median:14.1f} {plane.angle_90:5.1f}"
            f" {plane.interior_90:20.1f}"
        )
    return "\n".join([*rows, f"a pixel of the photos covers {evenness.ground_pixel:.4g}"])
