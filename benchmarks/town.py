# SPDX-License-Identifier: GPL-3.0-or-later
"""A small synthetic town with truth: twelve houses along two streets, five of them in rows, and their footprints.

``python -m benchmarks.town FOLDER`` makes ``images/`` (with RTK-like GPS), ``sparse/0`` (structure from motion put onto
the true frame), ``buildings/ID/truth.ply``, ``buildings/ID/masks/`` (255 building), ``footprints.geojson`` and
``town.json``. Footprints are half a metre off, one house is missing
among them and one was torn down, as maps are. ``--houses 6`` makes the first street alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.buildings import BUILDINGS
from benchmarks.camera_path import Shot, look_at
from benchmarks.catalogue import SceneSpec
from benchmarks.develop import develop, photo_frame, render_frame
from benchmarks.features import sfm_model
from benchmarks.roofs import gable_roof
from benchmarks.scenes import _run_blender
from benchmarks.shapes import Builder, Part, wall_row
from benchmarks.surroundings import car, tree
from benchmarks.town_painted import paint_views
from benchmarks.truth import write_truth
from mgf_engine.errors import BadInput
from mgf_engine.georef.crs import Projection
from mgf_engine.system import write_json

Ring = list[tuple[float, float]]
CRS = "EPSG:25832"
#: Where the town lies: easting, northing, height of its origin.
ORIGIN = np.array([691_234.0, 5_334_876.0, 519.0])
FOOTPRINT_ERROR, GPS_ERROR = 0.5, 0.05  # metres


@dataclass(frozen=True)
class House:
    """A house of the town.

    Attributes:
        id: its name in the map.
        make: makes its parts around its own origin.
        outline: its walls on the ground, in the same frame.
        place: x, y and angle of that frame in the town.
        mapped: the footprints hold it.
    """

    id: str
    make: Callable[[], list[Part]]
    outline: Ring
    place: tuple[float, float, float]
    mapped: bool = True


def row_house(wall: str, roof: str, windows: int, free: tuple[str, ...]) -> list[Part]:
    """Return a terraced house (8 x 10 x 9.4 m) whose walls towards neighbours are left out, for nobody sees them.

    Args:
        free: which of ``east`` and ``west`` have no neighbour.
    """
    b = Builder()
    x, y, eaves, ridge = 4.0, 5.0, 6.0, 9.2
    holes = [h for foot in (0.9, 3.7) for h in wall_row(2 * x, windows, 1.1, foot, 1.4)]
    b.wall((-x, -y), (x, -y), (0, eaves), wall, holes, "south")
    b.wall((x, y), (-x, y), (0, eaves), wall, holes, "north")
    if "east" in free:
        b.wall((x, -y), (x, y), (0, eaves), wall, (), "east", gable=ridge - eaves)
    if "west" in free:
        b.wall((-x, y), (-x, -y), (0, eaves), wall, (), "west", gable=ridge - eaves)
    gable_roof(b, x, y, eaves, ridge, 0.0, roof)
    b.box((-1.0, 1.0, 8.0), (-0.4, 1.6, 10.2), "brick", "chimney")
    return b.parts()


def _box(x0: float, y0: float, x1: float, y1: float) -> Ring:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


_L_SHAPE: Ring = [(-6, -4.75), (6, -4.75), (6, -3.2), (12, -3.2), (12, 3.4), (6, 3.4), (6, 4.75), (-6, 4.75)]
HOUSES = (
    House("villa", lambda: BUILDINGS["slate_villa"]("slate"),
          [(-6, -5), (-2, -5), (-1.3, -6.3), (1.3, -6.3), (2, -5), (6, -5), (6, 5), (-6, 5)], (-25.0, 13.0, 0.0)),
    House("timber", lambda: BUILDINGS["half_timber"]("clay"), _box(-5, -4, 5, 4), (-3.0, 12.0, 0.12)),
    House("row_west", lambda: row_house("brick", "tiles", 3, ("west",)), _box(-4, -5, 4, 5), (16.0, 12.5, 0.0)),
    House("row_east", lambda: row_house("sandstone", "slate", 2, ("east",)), _box(-4, -5, 4, 5), (24.0, 12.5, 0.0)),
    House("white", lambda: BUILDINGS["plain_house"]("clean_white"), _L_SHAPE, (-20.0, -13.0, 0.0)),
    House("bungalow", lambda: BUILDINGS["bungalow"]("cladding"),
          [(-8, -3.6), (1.5, -3.6), (1.5, -8.6), (7.5, -8.6), (7.5, -3.6), (8, -3.6), (8, 3.6), (-8, 3.6)],
          (8.0, -10.5, 0.0), mapped=False),
    House("terrace_west", lambda: row_house("plaster", "tiles", 2, ("west",)), _box(-4, -5, 4, 5), (-24.0, 33.0, 0.0)),
    House("terrace_middle", lambda: row_house("brick", "slate", 3, ()), _box(-4, -5, 4, 5), (-16.0, 33.0, 0.0)),
    House("terrace_east", lambda: row_house("clay", "tiles", 2, ("east",)), _box(-4, -5, 4, 5), (-8.0, 33.0, 0.0)),
    House("red", lambda: BUILDINGS["plain_house"]("clean_red"), _L_SHAPE, (14.0, 33.5, 0.0)),
    House("chapel", lambda: BUILDINGS["chapel"]("sandstone"),
          [(-7, -4.2), (7, -4.2), (9.6, -2.2), (10, 0), (9.6, 2.2), (7, 4.2), (-7, 4.2)], (-22.0, 59.0, 0.0)),
    House("warehouse", lambda: BUILDINGS["warehouse"]("brick"), _box(-10, -5.5, 10, 5.5), (13.0, 59.5, 0.08)),
)  # fmt: skip
#: Houses -> how far their town reaches south and north, and the columns of the flight to its rows.
TOWNS = {6: (-20.0, 20.0, 1.6), 12: (-20.0, 72.0, 0.75)}
#: What the map still shows and nobody sees any more.
TORN_DOWN = _box(26, -18, 35, -10)
_STREET, _SECOND = 3.2, 46.0  # half the width of a street; where the second one runs


def moved(points: NDArray[np.float64], place: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return points [N, 2 or 3] of a house's frame in the town's."""
    x, y, angle = place
    c, s = np.cos(angle), np.sin(angle)
    turned = points.copy()
    turned[:, :2] = points[:, :2] @ np.array([[c, s], [-s, c]]) + (x, y)
    return turned


def parts_of(house: House) -> list[Part]:
    """Return the parts of a house where it stands."""
    return [replace(p, name=f"{house.id}.{p.name}", vertices=moved(p.vertices, house.place)) for p in house.make()]


def around(rng: np.random.Generator, streets: int) -> list[Part]:
    """Ground, streets, paths, trees and cars."""
    b, big = Builder(building=False, prefix="ground."), 3000.0
    b.polygon(_level(-big, -big, big, big, -0.02), "grass")
    for y in (0.0, _SECOND)[:streets]:
        b.polygon(
            [(-big, y - _STREET, 0), (big, y - _STREET, 0), (big, y + _STREET, 0), (-big, y + _STREET, 0)], "asphalt"
        )
        for side in (-1, 1):
            low, high = sorted((y + side * _STREET, y + side * (_STREET + 1.6)))
            b.polygon(_level(-60, low, 60, high, 0.03), "paving")
        for x in np.arange(-60, 60, 6.0):
            b.polygon(
                [(x, y - 0.08, 0.01), (x + 3, y - 0.08, 0.01), (x + 3, y + 0.08, 0.01), (x, y + 0.08, 0.01)], "paint"
            )
    x0, y0, x1, y1 = (*TORN_DOWN[0], *TORN_DOWN[2])
    b.polygon([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)], "gravel")
    parts = b.parts()
    spots = [(-13.5, 12), (6.5, 16), (33, 14), (-3, -8.5), (-36, -10), (-34, 20), (22, -22), (8, 24), (-14, 25)]
    cars = [(-30, -2.0), (-9, 2.0), (4, -2.0), (21, 2.1)]
    if streets > 1:
        spots += [(2, 36), (-34, 35), (32, 34), (-5, 58), (29, 58), (-36, 60), (-14, 69), (6, 70)]
        cars += [(-25, 44.0), (-2, 48.0), (17, 44.0)]
    for i, spot in enumerate(spots):
        parts += tree(f"tree{i}.", np.array(spot, float), float(rng.uniform(4.5, 7.5)), rng)
    for i, spot in enumerate(cars):
        parts += car(f"car{i}.", np.array(spot, float), rng)
    return parts


def _level(x0: float, y0: float, x1: float, y1: float, z: float) -> list[tuple[float, float, float]]:
    return [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]


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
    if painted:
        numbered = [(k, part) for k, parts in enumerate(houses.values(), 1) for part in parts]
        paint_views(folder, spec, [*numbered, *((0, part) for part in others)], shots)
    else:
        _write_job(folder, spec, houses, others, shots, threads)
        _run_blender(folder, blender, say)
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


def _write_job(
    folder: Path, spec: SceneSpec, houses: dict[str, list[Part]], others: list[Part], shots: list[Shot], threads: int
) -> None:
    arrays, table = {}, []
    numbered = [(k, part) for k, parts in enumerate(houses.values(), 1) for part in parts]
    for i, (number, part) in enumerate([*numbered, *((0, part) for part in others)]):
        arrays[f"v{i}"] = part.vertices
        arrays[f"l{i}"] = np.array([k for face in part.faces for k in face], dtype=np.int32)
        arrays[f"s{i}"] = np.array([len(face) for face in part.faces], dtype=np.int32)
        table.append({"name": part.name, "material": part.material, "building": number > 0, "id": number})
    np.savez_compressed(folder / "work/parts.npz", table=np.array(json.dumps(table)), **arrays)  # type: ignore[arg-type]
    keys = ("texture_strength", "sun_elevation", "sun_azimuth", "sun_strength", "sky_strength", "samples", "seed",
            "denoiser", "pixel_filter")  # fmt: skip
    rows = [{**asdict(s), "rotation": s.rotation.tolist(), "translation": s.translation.tolist()} for s in shots]
    job = {**render_frame(spec)._asdict(), **{k: getattr(spec, k) for k in keys}, "threads": threads, "shots": rows}
    write_json(folder / "work/job.json", job)


def write_photos(folder: Path, spec: SceneSpec, shots: list[Shot], rng: np.random.Generator) -> None:
    """Rendered pictures become photos with the place of their camera in EXIF."""
    (folder / "images").mkdir(exist_ok=True)
    projection = Projection(CRS)
    for i, shot in enumerate(shots):
        picture = cv2.imread(str(folder / "work/photos" / (Path(shot.name).stem + ".png")), cv2.IMREAD_COLOR)
        assert picture is not None
        photo = develop(spec, np.asarray(picture, np.uint8), i)
        centre = -shot.rotation.T @ shot.translation + ORIGIN + rng.normal(0, GPS_ERROR, 3)
        latitude, longitude, height = projection.places(centre[None])[0].tolist()
        exif = Image.Exif()
        exif[0x8825] = {1: "N", 2: _sexagesimal(latitude), 3: "E", 4: _sexagesimal(longitude), 5: b"\0", 6: height}
        Image.fromarray(photo[..., ::-1]).save(folder / "images" / shot.name, quality=spec.jpeg, exif=exif)


def _sexagesimal(degrees: float) -> tuple[float, float, float]:
    minutes = 60 * (degrees % 1)
    return float(int(degrees)), float(int(minutes)), 60 * (minutes % 1)


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
    """Return ``python -m benchmarks.town FOLDER``."""
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
