# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of deliverables for the documentation, of the painted house that ``tests/blender/window/panels.py`` leaves.

    PYTHONPATH=. python tools/deliverable_pictures.py FOLDER --out docs/pictures

``drawings-lines.png``: orthophotos, and the DXF files as ezdxf draws them. ``scan.png``: ``mgf evaluate JOB --scan``
with a scan made of the true house: what 24 scanners around it see, 3 mm noise.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import cv2
import ezdxf
import laspy
import matplotlib
import numpy as np
from ezdxf.addons.drawing import Frontend, RenderContext
from ezdxf.addons.drawing.config import BackgroundPolicy, ColorPolicy, Configuration
from ezdxf.addons.drawing.matplotlib import MatplotlibBackend
from numpy.typing import NDArray

from benchmarks.control_points import ORIGIN
from mgf_engine.evaluation.pictures import circle_views
from mgf_engine.evaluation.surfaces import read_surface
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.mesh import Mesh

matplotlib.use("Agg")
import matplotlib.pyplot as plt

CELL = (420, 330)  # of the picture of drawings, pixels
DRAWINGS = ("orthophoto-south.png", "elevation-south.dxf", "section-z-1.2.dxf", "orthophoto-plan.png", "roof.dxf")
LOOKS = ((-0.6, -1.0, -0.2), (-0.6, -1.0, 0.0), (1.0, 0.2, 0.0), (0.3, 1.0, -0.3))  # of the scanners' circles
NOISE, POINTS = 0.003, 500_000


def main() -> int:
    """Write both pictures; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="what panels.py had as --out")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    drawings = args.folder / "job" / "drawings"
    upright = sorted(p.name for p in drawings.glob("section-north-*.dxf"))
    cells = [cell(drawings / name) for name in (*DRAWINGS, *upright[:1])]
    sheet = np.vstack([np.hstack(cells[:3]), np.hstack(cells[3:])])
    write_small(args.out / "drawings-lines.png", sheet, 96)
    scan, picture = args.folder / "scan.laz", args.folder / "scan.png"
    write_scan(args.folder / "whole" / "truth.ply", scan)
    command = [
        sys.executable,
        "-m",
        "mgf_engine",
        "evaluate",
        args.folder / "job",
        "--scan",
        scan,
        "--picture",
        picture,
    ]
    subprocess.run([*map(str, command)], check=True)
    found = cv2.imread(str(picture))
    assert found is not None
    write_small(args.out / "scan.png", cv2.resize(found, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA), 96)
    return 0


def cell(path: Path) -> NDArray[np.uint8]:
    """A drawing on white in the size of a cell."""
    picture = drawn(path) if path.suffix == ".dxf" else on_white(path)
    used = picture.min(-1) < 250
    v, u = np.flatnonzero(used.any(1)), np.flatnonzero(used.any(0))
    picture = picture[v[0] : v[-1] + 1, u[0] : u[-1] + 1]
    scale = min((c - 30) / s for c, s in zip(CELL, picture.shape[1::-1], strict=True))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    page = np.full((CELL[1], CELL[0], 3), 255, np.uint8)
    top, left = ((a - b) // 2 for a, b in zip(page.shape[:2], small.shape[:2], strict=True))
    page[top : top + small.shape[0], left : left + small.shape[1]] = small
    return page


def drawn(path: Path) -> NDArray[np.uint8]:
    """A DXF as ezdxf draws it, black on white, BGR."""
    document, figure = ezdxf.readfile(path), plt.figure(figsize=(8, 6), dpi=110)
    axes = figure.add_axes((0, 0, 1, 1))
    look = Configuration(background_policy=BackgroundPolicy.WHITE, color_policy=ColorPolicy.BLACK)
    Frontend(RenderContext(document), MatplotlibBackend(axes), config=look).draw_layout(document.modelspace())
    figure.canvas.draw()
    picture = np.asarray(figure.canvas.buffer_rgba())[..., 2::-1].copy()  # type: ignore[attr-defined]
    plt.close(figure)
    return picture


def on_white(path: Path) -> NDArray[np.uint8]:
    """A transparent PNG on white, BGR."""
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    cover = picture[..., 3:] / 255.0
    return np.asarray((picture[..., :3] * cover + 255 * (1 - cover)).round(), np.uint8)


def write_scan(truth: Path, path: Path) -> None:
    """What scanners around the true house see, as LAZ in the CRS of the control points."""
    surface, rng, seen = read_surface(truth), np.random.default_rng(0), []
    mesh = Mesh(surface.vertices, surface.faces.astype(np.int32), np.zeros(surface.vertices.shape, np.uint8))
    for look in LOOKS:
        for view in circle_views(mesh, np.array([0.0, 0.0, 1.0]), np.array(look), 6, (500, 400)):
            depth = render_mesh(mesh, view).depth
            y, x = np.nonzero((depth > 0) & np.isfinite(depth))
            rays = np.stack([(x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, np.ones(len(x))], 1)
            seen.append((rays * depth[y, x, None] - view.translation) @ view.rotation)
    points = np.concatenate(seen)
    points = points[rng.choice(len(points), min(len(points), POINTS), replace=False)]
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = ORIGIN, np.full(3, 0.001)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = (points + rng.normal(0, NOISE, points.shape) + ORIGIN).T
    cloud.write(str(path))


def write_small(path: Path, picture: NDArray[np.uint8], colors: int) -> None:
    """A PNG with a palette (ImageMagick)."""
    _, data = cv2.imencode(".png", picture)
    command = ["convert", "png:-", "-strip", "+dither", "-colors", str(colors), f"PNG8:{path}"]
    subprocess.run(command, input=data.tobytes(), check=True)


if __name__ == "__main__":
    sys.exit(main())
