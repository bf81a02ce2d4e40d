# SPDX-License-Identifier: GPL-3.0-or-later
"""A surveyed site with truth: cameras around a house-sized box, points on it, GPS in the photos, control points.

The truth is metres in UTM zone 32. The scene is the same turned, scaled and moved as structure from motion leaves it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from benchmarks.gps_exif import gps_exif
from mgf_engine.georef.crs import ProjectedCrs
from mgf_engine.model.scene import Scene, Similarity, View
from mgf_engine.scene.cameras import to_original

CRS = "EPSG:25832"
ORIGIN = np.array([691_234.0, 5_334_876.0, 519.0])
WIDTH, HEIGHT, FOCAL = 2000, 1500, 1700.0  # of the photos as taken
SHRINK = 4  # working photos are so much smaller
#: Corners of windows, roof and ground around the house, metres from ORIGIN.
TARGETS = {
    "P1": (-5.0, -4.0, 0.3), "P2": (5.0, -4.0, 2.6), "P3": (5.0, 4.0, 0.4), "P4": (-5.0, 4.0, 5.8),
    "P5": (0.0, -4.0, 6.2), "C1": (-5.0, 0.0, 3.0), "C2": (5.0, 1.0, 4.8), "C3": (1.0, -4.0, 1.5),
}  # fmt: skip


@dataclass(frozen=True)
class Site:
    """A scene and the truth of it.

    Attributes:
        to_scene: similarity [4, 4], UTM less ORIGIN -> scene frame.
        folder: where photos and tables are written.
    """

    scene: Scene
    to_scene: np.ndarray
    folder: Path

    def truth(self, points: np.ndarray) -> np.ndarray:
        """Normalised frame -> UTM."""
        inverse = np.linalg.inv(self.to_scene)
        return self.scene.to_normalised.invert(points) @ inverse[:3, :3].T + inverse[:3, 3] + ORIGIN

    def normalised(self, utm: np.ndarray) -> np.ndarray:
        """UTM -> normalised frame."""
        local = np.asarray(utm) - ORIGIN
        return self.scene.to_normalised.apply(local @ self.to_scene[:3, :3].T + self.to_scene[:3, 3])

    def write_control(self, noise: float = 0.0, seed: int = 3, name: str = "points.csv", **changed: Any) -> Path:
        """The targets as a CSV with a heading; ``changed``: name -> coordinates in the place of the true ones."""
        rng = np.random.default_rng(seed)
        lines = ["name,east,north,height,accuracy,role"]
        for key, local in TARGETS.items():
            at = changed.get(key, ORIGIN + local + rng.normal(0, noise, 3) if noise else ORIGIN + local)
            role = "check" if key.startswith("C") else "control"
            lines.append(f"{key},{at[0]:.4f},{at[1]:.4f},{at[2]:.4f},0.01,{role}")
        path = self.folder / name
        path.write_text("\n".join(lines) + "\n")
        return path

    def marks(self, noise: float = 0.0, seed: int = 4) -> list[tuple[str, str, float, float]]:
        """Target, photo, x and y of every place where a target is in the frame, pixels of the photo as taken."""
        rng = np.random.default_rng(seed)
        found = []
        for key, local in TARGETS.items():
            at = self.normalised(ORIGIN + local)
            for view in self.scene.views:
                uv, depth = view.project(at[None])
                x, y = to_original(view, uv)[0] + rng.normal(0, noise, 2)
                if depth[0] > 0 and 0 < x < WIDTH and 0 < y < HEIGHT:
                    found.append((key, view.name, x, y))
        return found

    def write_marks(self, marks: list[tuple[str, str, float, float]], name: str = "marks.csv") -> Path:
        path = self.folder / name
        path.write_text("name,photo,x,y\n" + "".join(f"{a},{b},{x:.3f},{y:.3f}\n" for a, b, x, y in marks))
        return path


def make_site(folder: Path, count: int = 16, seed: int = 0, radius: float = 16.0, arc: float = 2 * np.pi) -> Site:
    """A site with ``count`` photos (grey working photos, no photos as taken yet)."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_euler("xyz", (97, 14, 31), degrees=True).as_matrix()
    to_scene = np.eye(4)
    to_scene[:3, :3], to_scene[:3, 3] = 0.37 * turn, (1.2, -3.4, 0.6)
    frame = Similarity(1.7, np.eye(3), np.array([-2.0, 5.5, -1.0]))

    def normalised(local: np.ndarray) -> np.ndarray:
        return frame.apply(local @ to_scene[:3, :3].T + to_scene[:3, 3])

    (folder / "images").mkdir(parents=True, exist_ok=True)
    views = []
    for index in range(count):
        angle = arc * index / count
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), 2.0 + 7.0 * (index % 3)])
        forward = np.array([0, 0, 2.5]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (0, 0, 1.0))
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward]) @ turn.T
        name, size = f"photo_{index:02d}.jpg", (WIDTH // SHRINK, HEIGHT // SHRINK)
        views.append(View(
            name=name, file=f"images/{index:04d}.png", width=size[0], height=size[1], fx=FOCAL / SHRINK,
            fy=FOCAL / SHRINK, cx=size[0] / 2, cy=size[1] / 2, rotation=rotation,
            translation=-rotation @ normalised(eye), original_width=WIDTH, original_height=HEIGHT,
            photo=str(folder / name),
        ))  # fmt: skip
        cv2.imwrite(str(folder / views[-1].file), np.full((size[1], size[0], 3), 128, np.uint8))
    local = rng.uniform((-5, -4, 0), (5, 4, 6), (400, 3))
    face = rng.integers(0, 3, 400)
    local[face == 0, 0] = np.sign(local[face == 0, 0]) * 5
    local[face == 1, 1] = np.sign(local[face == 1, 1]) * 4
    local[face == 2, 2] = 0
    start, track_view, track_uv, points = [0], [], [], normalised(local)
    seen = [view.project(points) for view in views]
    for i in range(len(points)):
        for k, (uv, depth) in enumerate(seen):
            if depth[i] > 0 and (uv[i] > 0).all() and (uv[i] < (views[k].width, views[k].height)).all():
                track_view.append(k)
                track_uv.append(uv[i] + rng.normal(0, 0.15, 2))
        start.append(len(track_view))
    scene = Scene(
        views=tuple(views), points=points, colors=np.full((len(points), 3), 128, np.uint8),
        errors=np.zeros(len(points), np.float32), track_start=np.array(start, np.int64),
        track_view=np.array(track_view, np.int32), track_uv=np.array(track_uv, np.float32), to_normalised=frame,
        roots=(0,), held_out=(), folder=folder,
    )  # fmt: skip
    return Site(scene, to_scene, folder)


def write_gps(site: Site, noise: float = 0.0, seed: int = 5, line: bool = False) -> None:
    """Small JPEG photos with the place of each camera in EXIF, off by ``noise`` metres."""
    rng = np.random.default_rng(seed)
    for index, view in enumerate(site.scene.views):
        at = site.truth(view.centre) + rng.normal(0, noise, 3) if noise else site.truth(view.centre)
        at = np.add(ORIGIN, (3.0 * index, 0, 0)) if line else at
        latitude, longitude, height = ProjectedCrs(CRS).places(at[None])[0]
        write_photo(Path(view.photo), latitude, longitude, height)


def write_photo(path: Path, latitude: float, longitude: float, height: float, xmp: str = "") -> None:
    """A small JPEG with a place in EXIF."""
    image = Image.new("RGB", (16, 12))
    exif = gps_exif(latitude, longitude, height)
    image.save(path, exif=exif, xmp=xmp.encode()) if xmp else image.save(path, exif=exif)
