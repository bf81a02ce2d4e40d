# SPDX-License-Identifier: GPL-3.0-or-later
"""How true a scene becomes with GPS and with control points: ``python -m benchmarks.control_points SCENE``.

A generated scene is given GPS in its photos (2 m noise), five control and three check points on the building's own
corners (1 cm noise in each coordinate) and marks in all photos that see them (0.5 px), and goes through the engine's
own reading of scenes and files. The error of the check points is measured against their true places, and, as a report
does it, against their noisy coordinates.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image

from benchmarks.arguments import count
from benchmarks.gps_exif import gps_exif
from mgf_engine.errors import BadInput
from mgf_engine.evaluation.surfaces import Surface, read_surface
from mgf_engine.georef.adjust import fit_to_control
from mgf_engine.georef.crs import ProjectedCrs
from mgf_engine.georef.find import find_georeference
from mgf_engine.georef.options import GeoreferenceOptions
from mgf_engine.georef.triangulate import place_points
from mgf_engine.messages import Reporter
from mgf_engine.options.config import make_config
from mgf_engine.scene.load import load_scene

Array = NDArray[np.float64]
CRS, ORIGIN = "EPSG:25832", np.array([691_200.0, 5_334_800.0, 500.0])
CONTROL, CHECK = 5, 3
MIN_VIEWS = 5  # photos that see a point
METHODS = {"GPS": {}, "aligned to control points": {"control_adjust": "off"}, "cameras adjusted": {}}


@dataclass(frozen=True)
class Noise:
    """Standard deviations: GPS and points in metres, per axis; marks in pixels of the photos, per axis."""

    gps: float = 2.0
    point: float = 0.01
    mark: float = 0.5


@dataclass(frozen=True)
class Target:
    """A corner of the building: its true place in the scene's frame, and photo -> pixel where it is seen."""

    name: str
    place: Array
    pixels: dict[str, Array]


def targets_of(folder: Path) -> list[Target]:
    """Return corners far from each other that several photos see: control points first, then check points.

    Raises:
        BadInput: the building has too few.
    """
    truth, model = read_surface(folder / "truth.ply"), pycolmap.Reconstruction(folder / "sparse_truth")
    corners = np.unique(truth.vertices.round(3), axis=0)
    seen = [_seen_in(corners, image, truth) for image in model.images.values()]
    often = np.flatnonzero(np.isfinite(np.stack(seen)[..., 0]).sum(0) >= MIN_VIEWS)
    if len(often) < CONTROL + CHECK:
        raise BadInput(f"Only {len(often)} corners of '{folder}' are seen in {MIN_VIEWS} photos; take another scene.")
    places = corners[often]
    chosen = [int(np.linalg.norm(places - places.mean(0), axis=1).argmax())]
    while len(chosen) < CONTROL + CHECK:
        away = np.linalg.norm(places[:, None] - places[chosen][None], axis=2).min(1)
        chosen.append(int(away.argmax()))
    names = [image.name for image in model.images.values()]
    targets = []
    for k, at in enumerate(often[chosen].tolist()):
        pixels = {name: uv[at] for name, uv in zip(names, seen, strict=True) if np.isfinite(uv[at, 0])}
        targets.append(Target(f"P{k + 1}" if k < CONTROL else f"C{k + 1 - CONTROL}", corners[at], pixels))
    return targets


def _seen_in(corners: Array, image: pycolmap.Image, truth: Surface) -> Array:
    """Pixels of the corners in a photo, [N, 2]; NaN where it does not see them."""
    pose, camera = image.cam_from_world(), image.camera
    assert camera is not None
    local = corners @ pose.rotation.matrix().T + pose.translation
    uv = np.asarray(camera.img_from_cam(local)).reshape(-1, 2)
    inside = (local[:, 2] > 0.1) & (uv > 3).all(1) & (uv < np.array([camera.width, camera.height]) - 3).all(1)
    eye = -pose.rotation.matrix().T @ pose.translation
    _, share = truth.first_hits(eye, corners - eye)  # 1 at the corner itself
    away = np.linalg.norm(corners - eye, axis=1)
    return np.where((inside & (share > 1 - 0.02 / away))[:, None], uv, np.nan)


def write_inputs(folder: Path, out: Path, targets: Sequence[Target], noise: Noise, seed: int) -> dict[str, Array]:
    """The scene with GPS in its photos, ``points.csv`` and ``marks.csv``; returns the noisy coordinates by name."""
    rng = np.random.default_rng(seed)
    (out / "images").mkdir(parents=True)
    (out / "sparse").symlink_to(folder / "sparse")
    for image in pycolmap.Reconstruction(folder / "sparse_truth").images.values():
        at = image.projection_center() + ORIGIN + rng.normal(0, noise.gps, 3)
        latitude, longitude, height = ProjectedCrs(CRS).places(at[None])[0]
        _stamp(folder / "images" / image.name, out / "images" / image.name, latitude, longitude, height)
    told, points, marks = {}, ["name,east,north,height,accuracy,role"], ["name,photo,x,y"]
    for target in targets:
        told[target.name] = target.place + ORIGIN + rng.normal(0, noise.point, 3)
        east, north, height = told[target.name]
        role = "check" if target.name[0] == "C" else "control"
        points.append(f"{target.name},{east:.4f},{north:.4f},{height:.4f},{noise.point},{role}")
        for photo, uv in target.pixels.items():
            x, y = uv + rng.normal(0, noise.mark, 2)
            marks.append(f"{target.name},{photo},{x:.3f},{y:.3f}")
    (out / "points.csv").write_text("\n".join(points) + "\n")
    (out / "marks.csv").write_text("\n".join(marks) + "\n")
    return told


def _stamp(photo: Path, out: Path, latitude: float, longitude: float, height: float) -> None:
    """A copy of a photo with a place in EXIF, its pixels as they are."""
    picture = Image.open(photo)
    how = {"quality": "keep"} if picture.format == "JPEG" else {}
    picture.save(out, exif=gps_exif(latitude, longitude, height), **how)


def errors_of(inputs: Path, method: str, targets: Sequence[Target], resolution: int) -> dict[str, Array]:
    """Return where the engine puts each target less where it truly is, metres."""
    options = {"crs": CRS, "resolution": resolution, **METHODS[method]}
    reporter = Reporter()
    reporter.stage("scene")
    config = make_config({**options, "control": str(inputs / "points.csv"), "marks": str(inputs / "marks.csv")})
    reading = make_config(options) if method == "GPS" else config
    with tempfile.TemporaryDirectory() as folder:
        adjust = fit_to_control if reading.control and reading.control_adjust else None
        scene = load_scene(inputs, Path(folder) / "scene", reading, reporter, adjust=adjust)
        found = find_georeference(scene, reading.algorithm(GeoreferenceOptions), lambda text: None)
        from mgf_engine.georef.control_points import read_marks

        marks, _ = read_marks(inputs / "marks.csv", [view.name for view in scene.views])
        placed, _ = place_points(scene, marks)
    to_scene = scene.to_normalised.invert
    return {
        t.name: found.georeference.world(to_scene(placed[t.name].position)) - ORIGIN - t.place
        for t in targets
        if t.name in placed
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table: RMSE of the check points over all seeds, per axis and in space."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.control_points", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("scene", type=Path, help="folder of a generated scene")
    parser.add_argument("--seeds", type=count, default=3, help="draws of the noise (default 3)")
    parser.add_argument("--resolution", type=count, default=1000, help="longest side of the working photos")
    args = parser.parse_args(argv)
    noise = Noise()
    try:
        targets = targets_of(args.scene.resolve())
    except BadInput as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    seen = np.mean([len(t.pixels) for t in targets])
    print(f"{len(targets)} points, each marked in {seen:.0f} photos on average; mm")
    print("| method | east | north | height | in space | in space, against the file |\n|---|---|---|---|---|---|")
    for method in METHODS:
        true, told = list[Array](), list[Array]()
        for seed in range(args.seeds):
            with tempfile.TemporaryDirectory() as folder:
                inputs = Path(folder) / "scene"
                noisy = write_inputs(args.scene.resolve(), inputs, targets, noise, seed)
                errors = errors_of(inputs, method, targets, args.resolution)
            for target in (t for t in targets if t.name[0] == "C"):
                true.append(errors[target.name])
                told.append(errors[target.name] + target.place + ORIGIN - noisy[target.name])
        axes, space, file = _rms(true), np.hypot.reduce(_rms(true)), np.hypot.reduce(_rms(told))
        print(f"| {method} | " + " | ".join(f"{1000 * v:.1f}" for v in (*axes, space, file)) + " |", flush=True)
    return 0


def _rms(errors: Sequence[Array]) -> Array:
    return np.asarray(np.sqrt(np.square(np.array(errors)).mean(0)))


if __name__ == "__main__":
    raise SystemExit(main())
