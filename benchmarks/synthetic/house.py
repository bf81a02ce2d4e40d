# SPDX-License-Identifier: GPL-3.0-or-later
"""A small painted house on a painted lawn, photographed from a ring: photos, COLMAP model, clicks and true mesh.

Everything is computed with the engine's own z-buffer and a solid noise for paint, so that a whole job can be tested
in seconds without Blender.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from benchmarks.synthetic.meshes import merged
from mgf_engine.geometry.rasterize import render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View

WIDTH, HEIGHT, FOCAL = 240, 180, 220.0
OFFSET = np.array([100.0, -40.0, 7.0])  # the house does not stand at the origin
_SUPERSAMPLE = 2
_SKY = (150, 190, 235)
#: Points [..., 3], their faces [...] and the number of the house's faces -> RGB [..., 3].
Paint = Callable[[NDArray[np.float64], NDArray[np.int32], int], NDArray[np.uint8]]


@dataclass(frozen=True)
class House:
    """Where the house's files are, and the truth.

    Attributes:
        folder: ``images/``, ``sparse/0/`` and ``prompts.json``.
        mesh: the true house without the lawn, in the model's own frame.
        masks: photo name -> true mask, bool [H, W].
    """

    folder: Path
    mesh: Mesh
    masks: dict[str, NDArray[np.bool_]]

    @property
    def prompts(self) -> Path:
        return self.folder / "prompts.json"


def build_house(folder: Path, photos: int = 14, painted: Paint | None = None) -> House:
    """Write the scene into ``folder`` (made if missing) and return it; ``painted`` takes the place of :func:`paint`."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    house, both = house_mesh(), house_on_lawn()
    views = [ring_view(k, photos) for k in range(photos)]
    masks = {}
    for view, (picture, on_house) in zip(views, _photographs(photos, painted), strict=True):
        masks[view.name] = on_house.copy()
        cv2.imwrite(str(folder / "images" / view.name), picture[:, :, ::-1])
    write_model(folder / "sparse" / "0", views, both, house)
    write_prompts(folder / "prompts.json", views, masks)
    return House(folder, house, masks)


def house_mesh() -> Mesh:
    """Return a box of 4 x 3 x 2 with a gable roof up to 3.2, z up, without a floor."""
    x, y, z, top = 2.0, 1.5, 2.0, 3.2
    v = np.array([
        [-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0], [-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z],
        [-x, 0, top], [x, 0, top],
    ])  # fmt: skip
    f = np.array([
        [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6], [1, 2, 6], [1, 6, 5], [5, 6, 9], [3, 0, 4], [3, 4, 7], [7, 4, 8],
        [4, 5, 9], [4, 9, 8], [6, 7, 8], [6, 8, 9],
    ], np.int32)  # fmt: skip
    return Mesh(v + OFFSET, f, np.zeros((len(v), 3), np.uint8))


def lawn_mesh(half: int = 12) -> Mesh:
    """Return a flat lawn in small squares: the z-buffer leaves out faces that reach behind the camera."""
    x, y = np.meshgrid(np.arange(-half, half + 1), np.arange(-half, half + 1))
    v = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1) + OFFSET
    side = 2 * half + 1
    corner = (np.arange(2 * half)[:, None] * side + np.arange(2 * half)).ravel()
    f = np.r_[np.c_[corner, corner + 1, corner + side + 1], np.c_[corner, corner + side + 1, corner + side]]
    return Mesh(v, f.astype(np.int32), np.zeros((len(v), 3), np.uint8))


def house_on_lawn() -> Mesh:
    """Return both as one mesh, the house's faces first."""
    return merged(house_mesh(), lawn_mesh())


@functools.cache
def _photographs(photos: int, painted: Paint | None) -> list[tuple[NDArray[np.uint8], NDArray[np.bool_]]]:
    """Photo and true mask from each place of the ring: many tests want the same house."""
    both, faces = house_on_lawn(), len(house_mesh().faces)
    return [photograph(both, faces, ring_view(k, photos), painted) for k in range(photos)]


def ring_view(index: int, count: int) -> View:
    """Return camera ``index`` of two rings around the house, looking at its middle."""
    angle, high = 2 * np.pi * index / count, index % 2
    centre = OFFSET + np.array([7 * np.cos(angle), 7 * np.sin(angle), 5.0 if high else 2.6])
    z = OFFSET + np.array([0, 0, 1.4]) - centre
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    return View(
        name=f"photo_{index:02d}.png", file=f"images/photo_{index:02d}.png", width=WIDTH, height=HEIGHT, fx=FOCAL,
        fy=FOCAL, cx=WIDTH / 2, cy=HEIGHT / 2, rotation=rotation, translation=-rotation @ centre,
        original_width=WIDTH, original_height=HEIGHT,
    )  # fmt: skip


def photograph(
    both: Mesh, house_faces: int, view: View, painted: Paint | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the photo (RGB) and the true mask of the house, antialiased by supersampling."""
    picture, face = photograph_faces(both, house_faces, view, painted)
    return picture, mask_of_faces(face, 0, house_faces)


def photograph_faces(
    both: Mesh, house_faces: int, view: View, painted: Paint | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Return the photo (RGB) and the face that each of its supersampled pixels shows (-1: the sky)."""
    s = _SUPERSAMPLE
    large = View(**{**view.__dict__, "width": WIDTH * s, "height": HEIGHT * s, "fx": FOCAL * s, "fy": FOCAL * s,
                    "cx": view.cx * s, "cy": view.cy * s})  # fmt: skip
    buffers = render_mesh(both, large)
    y, x = np.mgrid[: large.height, : large.width] + 0.5
    rays = np.stack([(x - large.cx) / large.fx, (y - large.cy) / large.fy, np.ones_like(x)], -1)
    shown = buffers.face >= 0
    points = (rays[shown] * buffers.depth[shown, None] - view.translation) @ view.rotation
    picture = np.full((*shown.shape, 3), _SKY, np.uint8)
    picture[shown] = (painted or paint)(points, buffers.face[shown], house_faces)
    small = cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return small.astype(np.uint8), buffers.face


def mask_of_faces(face: NDArray[np.int32], first: int, end: int) -> NDArray[np.bool_]:
    """Return where more than half of a pixel shows faces from ``first`` to before ``end``."""
    shown = ((face >= first) & (face < end)) * 1.0
    return cv2.resize(shown, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) > 0.5  # type: ignore[return-value]


def paint(points: NDArray[np.float64], face: NDArray[np.int32], house_faces: int) -> NDArray[np.uint8]:
    """Red walls, slate roof and green lawn, all mottled by a solid noise; RGB."""
    roof = (face >= 10) & (face < house_faces)
    base = np.where(roof[..., None], (90, 95, 110), (180, 90, 70))
    base = np.where((face >= house_faces)[..., None], (80, 130, 60), base)
    octaves = [solid_noise((points - OFFSET) * scale, seed) for scale, seed in ((3.1, 1), (7.7, 2), (15.0, 3))]
    noise = np.sum(octaves, axis=0)
    return np.clip(base * (0.6 + 0.27 * noise[..., None]), 0, 255).astype(np.uint8)


def solid_noise(points: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Trilinear value noise in 0..1 at points [..., 3]."""
    lattice = np.random.default_rng(seed).random((32, 32, 32))
    cell = np.floor(points)
    t = points - cell
    at = np.moveaxis(cell + t * t * (3 - 2 * t), -1, 0)  # smoothly from one lattice point to the next
    return np.asarray(map_coordinates(lattice, at, order=1, mode="grid-wrap", prefilter=False))


def write_model(
    folder: Path, views: list[View], both: Mesh, house: Mesh, count: int = 1500, on_lawn: int = 750
) -> None:
    """A COLMAP model with exact cameras and tracks of ``count`` points on the house, and some on the lawn."""
    import trimesh

    folder.mkdir(parents=True, exist_ok=True)
    surfaces = [(house, count), (Mesh(both.vertices, both.faces[len(house.faces) :], both.colors), on_lawn)]
    points = np.concatenate([
        trimesh.sample.sample_surface(trimesh.Trimesh(m.vertices, m.faces, process=False), n, seed=5)[0]
        for m, n in surfaces if n
    ])  # fmt: skip
    seen = [_observed(view, both, points) for view in views]
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.PINHOLE, FOCAL, WIDTH, HEIGHT)
    camera.params = [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2]
    model.add_camera_with_trivial_rig(camera)
    tracks: list[list[tuple[int, int]]] = [[] for _ in points]
    for number, (view, (index, uv)) in enumerate(zip(views, seen, strict=True), start=1):
        image = pycolmap.Image(name=view.name, camera_id=1, image_id=number)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in uv])
        pose = pycolmap.Rigid3d(np.c_[view.rotation, view.translation])
        model.add_image_with_trivial_frame(image, pose)
        for place, point in enumerate(index):
            tracks[point].append((number, place))
    for point, track in zip(points, tracks, strict=True):
        if len(track) >= 2:
            elements = [pycolmap.TrackElement(image, place) for image, place in track]
            model.add_point3D(point, pycolmap.Track(elements), np.array([128, 128, 128], np.uint8))
    model.write_binary(str(folder))


def _observed(view: View, both: Mesh, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    uv, depth, inside = view.project_into_frame(points, margin=1)
    index = np.flatnonzero(inside)
    nearest = render_mesh(both, view).depth[uv[index, 1].astype(int), uv[index, 0].astype(int)]
    index = index[np.abs(nearest - depth[index]) < 0.05]
    return index, uv[index]


def write_prompts(path: Path, views: list[View], masks: dict[str, NDArray[np.bool_]]) -> None:
    """Clicks on every third photo: deep inside the house, and on the lawn."""
    prompts = {}
    for view in views[::3]:
        inside = masks[view.name]
        depth = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 3)
        away = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 3)
        away[: HEIGHT // 2] = 0
        positive = np.unravel_index([depth.argmax()], depth.shape)
        negative = np.unravel_index([away.argmax()], away.shape)
        roof = view.project(OFFSET[None] + [[0.0, 0.3 * np.sign(view.centre[1] - OFFSET[1]), 2.9]])[0][0]
        prompts[view.name] = {
            "positive": [[int(positive[1][0]), int(positive[0][0])], [int(roof[0]), int(roof[1])]],
            "negative": [[int(negative[1][0]), int(negative[0][0])]],
        }
    path.write_text(json.dumps(prompts))
