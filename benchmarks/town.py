# SPDX-License-Identifier: GPL-3.0-or-later
"""A small synthetic town with truth: twelve houses along two streets, five of them in rows, and their footprints.

``python -m benchmarks.town FOLDER`` makes ``images/`` (with RTK-like GPS), ``sparse/0`` (structure from motion put onto
the true frame), ``buildings/ID/truth.ply``, ``buildings/ID/masks/`` (255 building), ``footprints.geojson`` and
``town.json``. Footprints are half a metre off, one house is missing among them and one was torn down, as maps are.
``--houses 6`` makes the first street alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from benchmarks.camera_path import Shot, look_at
from benchmarks.catalogue import SceneSpec
from benchmarks.develop import develop, photo_frame
from benchmarks.features import sfm_model
from benchmarks.gps_exif import gps_exif
from benchmarks.scenes import run_blender, write_render_job
from benchmarks.town_houses import HOUSES, TORN_DOWN, TOWNS, House, around, moved, parts_of
from benchmarks.town_painted import paint_views
from benchmarks.truth import write_truth
from mgf_engine.errors import BadInput
from mgf_engine.files.atomic import write_json
from mgf_engine.georef.crs import ProjectedCrs

CRS = "EPSG:25832"
#: Where the town lies: easting, northing, height of its origin.
ORIGIN = np.array([691_234.0, 5_334_876.0, 519.0])
FOOTPRINT_ERROR, GPS_ERROR = 0.5, 0.05  # metres


def flight(photos: int, houses: int, rng: np.random.Generator) -> list[Shot]:
    """A grid flown in four oblique directions and straight down, as surveys of quarters are."""
    lines, (south, north, ratio) = 5, TOWNS[houses]
    each = [photos // lines + (k < photos % lines) for k in range(lines)]
    shots = list[Shot]()
    for k, count in enumerate(each):
        columns = int(np.ceil(np.sqrt(count * ratio)))
        rows = int(np.ceil(count / columns))
        for i in range(count):
            row, column = divmod(i, columns)
            across = column + (0.5 * (row % 2))
            depth = south + (north - south) * (row + 0.5) / rows
            target = np.array([-34 + 68 * (across + 0.25) / columns, depth, 3.0])
            angle = np.pi / 2 * k
            back = np.array([np.cos(angle), np.sin(angle), 0.0]) * (23.0 if k < 4 else 0.0)
            eye = target + back + [0, 0, 17.0 if k < 4 else 32.0] + rng.normal(0, 0.4, 3)
            rotation, translation = look_at(eye, target + rng.normal(0, 0.5, 3), float(rng.normal(0, 0.01)))
            shots.append(Shot(f"photo_{len(shots):03d}.jpg", rotation, translation, 1.0))
    return shots


def make_town(
    folder: Path,
    photos: int,
    width: int,
    blender: Path | None,
    threads: int,
    painted: bool = False,
    count: int = len(HOUSES),
) -> None:
    """Render the town into a folder; pictures that are there are kept.

    Args:
        count: of houses, one of :data:`TOWNS`.
        painted: without Blender, see :mod:`benchmarks.town_painted`.
    """

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    (folder / "work").mkdir(parents=True, exist_ok=True)
    spec = SceneSpec(photos=photos, width=width, samples=6, denoiser="fast", rings=(), seed=51)
    rng = np.random.default_rng(spec.seed)
    shots = flight(photos, count, rng)
    houses = {house.id: parts_of(house) for house in HOUSES[:count]}
    others = around(rng, 1 if count <= min(TOWNS) else 2)
    numbered = [(k, part) for k, parts in enumerate(houses.values(), 1) for part in parts]
    numbered += [(0, part) for part in others]
    if painted:
        paint_views(folder, spec, numbered, shots)
    else:
        write_render_job(folder, spec, numbered, shots, threads)
        run_blender(folder, blender, say)
    write_photos(folder, spec, shots, rng)
    for number, (name, parts) in enumerate(houses.items(), 1):
        (folder / "buildings" / name / "masks").mkdir(parents=True, exist_ok=True)
        write_truth(folder / "buildings" / name, parts)
        for shot in shots:
            stem = Path(shot.name).stem + ".png"
            ids = cv2.imread(str(folder / "work/ids" / stem), cv2.IMREAD_UNCHANGED)
            assert ids is not None
            ids = ids if ids.ndim == 2 else ids[..., 0]
            cv2.imwrite(
                str(folder / "buildings" / name / "masks" / stem), np.where(ids == number, 255, 0).astype(np.uint8)
            )
    write_footprints(folder / "footprints.geojson", HOUSES[:count], rng)
    if not painted:
        model = sfm_model(folder, shots, photo_frame(spec))
        say(f"structure from motion: {model.num_reg_images()} photos, {model.num_points3D()} points")
    write_json(folder / "town.json", {"crs": CRS, "origin": ORIGIN.tolist(), "houses": list(houses)})


def write_photos(folder: Path, spec: SceneSpec, shots: list[Shot], rng: np.random.Generator) -> None:
    """Rendered pictures become photos with the place of their camera in EXIF."""
    (folder / "images").mkdir(exist_ok=True)
    projection = ProjectedCrs(CRS)
    for i, shot in enumerate(shots):
        picture = cv2.imread(str(folder / "work/photos" / (Path(shot.name).stem + ".png")), cv2.IMREAD_COLOR)
        assert picture is not None
        photo = develop(spec, np.asarray(picture, np.uint8), i)
        centre = -shot.rotation.T @ shot.translation + ORIGIN + rng.normal(0, GPS_ERROR, 3)
        latitude, longitude, height = projection.places(centre[None])[0].tolist()
        exif = gps_exif(latitude, longitude, height)
        Image.fromarray(photo[..., ::-1]).save(folder / "images" / shot.name, quality=spec.jpeg, exif=exif)


def write_footprints(path: Path, houses: Sequence[House], rng: np.random.Generator) -> None:
    """The map: half a metre off, without the houses that it misses, with the one that was torn down."""
    rings = {h.id: moved(np.array(h.outline, float), h.place) for h in houses if h.mapped}
    rings["torn_down"] = np.array(TORN_DOWN, float)
    features = []
    for name, ring in rings.items():
        angle = rng.uniform(0, 2 * np.pi)
        ring = ring + ORIGIN[:2] + FOOTPRINT_ERROR * np.array([np.cos(angle), np.sin(angle)])
        closed = [*ring.round(3).tolist(), ring[0].round(3).tolist()]
        geometry = {"type": "Polygon", "coordinates": [closed]}
        features.append({"type": "Feature", "properties": {"id": name}, "geometry": geometry})
    crs = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{CRS.split(':')[1]}"}}
    write_json(path, {"type": "FeatureCollection", "crs": crs, "features": features})


def main() -> int:
    """Run ``python -m benchmarks.town FOLDER``."""
    parser = argparse.ArgumentParser(description="Render a small synthetic town with footprints and truth.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--photos", type=int, help="default: 55 of six houses, 150 of twelve")
    parser.add_argument("--houses", type=int, choices=sorted(TOWNS), default=max(TOWNS))
    parser.add_argument("--width", type=int, default=400, help="of the photos, pixels")
    parser.add_argument("--painted", action="store_true", help="without Blender, with exact cameras")
    parser.add_argument("--blender", type=Path, help="a Python that has bpy")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    photos = args.photos or {6: 55, 12: 150}[args.houses]
    make_town(args.folder, photos, args.width, args.blender, args.threads, args.painted, args.houses)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BadInput as error:
        print(error, file=sys.stderr)
        sys.exit(2)
