# SPDX-License-Identifier: GPL-3.0-or-later
"""The town without Blender: painted by the engine's own z-buffer and a solid noise, with exact cameras, in minutes.

Light is a sun without shadows; glass does not mirror. It is for what depends on shapes, occlusion and neighbours (which
photos, which clicks, which job), not for how well materials can be measured: that is what the rendered scenes are for.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from benchmarks.camera_path import Shot
from benchmarks.catalogue import SceneSpec
from benchmarks.develop import photo_frame
from benchmarks.shapes import Part, labelled_mesh
from benchmarks.synthetic.house import solid_noise
from mgf_engine.geometry.rasterize import MeshBuffers, render_mesh
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View

#: Material -> RGB, and how much it is mottled; plain ones get hardly any sparse points.
_PAINT: dict[str, tuple[tuple[int, int, int], float]] = {
    "brick": ((150, 80, 62), 0.5), "sandstone": ((196, 164, 118), 0.45), "clay": ((205, 180, 140), 0.3),
    "timber": ((82, 58, 40), 0.3), "ashlar": ((150, 145, 135), 0.45), "slate": ((84, 90, 100), 0.45),
    "tiles": ((160, 82, 58), 0.45), "ridge_tiles": ((140, 70, 50), 0.3), "dark_metal": ((70, 74, 80), 0.12),
    "clean_white": ((232, 231, 226), 0.03), "clean_red": ((150, 76, 60), 0.05), "glass": ((64, 84, 100), 0.15),
    "grass": ((92, 120, 58), 0.5), "asphalt": ((92, 92, 95), 0.35), "paving": ((150, 148, 140), 0.4),
    "gravel": ((160, 152, 140), 0.5), "leaves": ((70, 120, 44), 0.5), "bark": ((80, 62, 48), 0.4),
    "cladding": ((150, 116, 80), 0.45), "felt": ((86, 82, 80), 0.4), "wood": ((120, 84, 54), 0.3),
}  # fmt: skip
_OTHER = ((170, 165, 155), 0.2)
_SKY, _SUN = (176, 205, 235), np.array([0.45, -0.55, 0.7])
_SUPERSAMPLE, _DENSITY, _SIGMA, _OFF = 2, 2.0, 0.3, 0.01  # samples; points to a square metre; px; metres


def lawn(low: tuple[float, float], high: tuple[float, float], step: int = 4) -> Part:
    """Grass in squares: the z-buffer leaves out faces that reach behind the camera.

    Args:
        low, high: corners of the buildings; grass reaches 30 m further.
    """
    x, y = np.meshgrid(*(np.arange(a - 30, b + 30 + step, step) for a, b in zip(low, high, strict=True)))
    rows, side = x.shape
    corner = (np.arange(rows - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.stack([corner, corner + 1, corner + side + 1, corner + side], 1)
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, -0.02)], 1).astype(float)
    return Part("ground.lawn", "grass", vertices, tuple(map(tuple, faces.tolist())), "", False)


def paint_views(folder: Path, spec: SceneSpec, parts: list[tuple[int, Part]], shots: list[Shot]) -> None:
    """``work/photos`` and ``work/ids`` as Blender would leave them, and ``sparse/0`` with the true cameras.

    Args:
        parts: the number of the house (0: surroundings) and the part.
    """
    kept = [(number, part) for number, part in parts if not part.name.startswith("ground.:")]
    kept = [(n, p) for n, p in kept if np.abs(p.vertices).max() < 200]
    stands = np.concatenate([p.vertices[:, :2] for n, p in kept if n])
    kept.append((0, lawn(tuple(stands.min(0)), tuple(stands.max(0)))))
    vertices, faces, owner = labelled_mesh([part for _, part in kept])
    mesh = Mesh(vertices, faces, np.zeros(vertices.shape, np.uint8))
    house = np.array([number for number, _ in kept])[owner]
    paint = [_PAINT.get(part.material, _OTHER) for _, part in kept]
    base, mottle = np.array([p[0] for p in paint], float)[owner], np.array([p[1] for p in paint])[owner]
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    for kind in ("photos", "ids"):
        (folder / "work" / kind).mkdir(parents=True, exist_ok=True)
    views = [_view(spec, shot) for shot in shots]
    rendered = []
    for shot, view in zip(shots, views, strict=True):
        buffers = render_mesh(mesh, view)
        rendered.append(buffers)
        stem = Path(shot.name).stem + ".png"
        ids = np.where(buffers.face >= 0, house[np.maximum(buffers.face, 0)], 0).astype(np.uint8)
        cv2.imwrite(str(folder / "work/ids" / stem), ids)
        photo = folder / "work/photos" / stem
        if not photo.exists():
            cv2.imwrite(str(photo), _photograph(mesh, view, base, mottle, normal)[..., ::-1])
    ground = (stands.min(0) - 12, stands.max(0) + 12)
    _write_model(folder / "sparse/0", mesh, mottle, views, rendered, spec, ground)


def _view(spec: SceneSpec, shot: Shot) -> View:
    f = photo_frame(spec)
    return View(
        name=shot.name, file=f"images/{shot.name}", width=f.width, height=f.height, fx=f.fx, fy=f.fy, cx=f.cx, cy=f.cy,
        rotation=shot.rotation, translation=shot.translation, original_width=f.width, original_height=f.height,
    )  # fmt: skip


def _photograph(
    mesh: Mesh, view: View, base: NDArray[np.float64], mottle: NDArray[np.float64], normal: NDArray[np.float64]
) -> NDArray[np.uint8]:
    s = _SUPERSAMPLE
    large = View(**{**view.__dict__, "width": view.width * s, "height": view.height * s, "fx": view.fx * s,
                    "fy": view.fy * s, "cx": view.cx * s, "cy": view.cy * s})  # fmt: skip
    buffers = render_mesh(mesh, large)
    y, x = np.mgrid[: large.height, : large.width] + 0.5
    rays = np.stack([(x - large.cx) / large.fx, (y - large.cy) / large.fy, np.ones_like(x)], -1)
    points = (rays * buffers.depth[..., None] - view.translation) @ view.rotation
    face = np.maximum(buffers.face, 0)
    noise = solid_noise(points * 1.3, 1) + 0.8 * solid_noise(points * 4.1, 2) - 0.9
    facing = normal[face] * np.where((normal[face] * (points - view.centre)).sum(-1) > 0, -1, 1)[..., None]
    light = 0.55 + 0.5 * np.maximum(facing @ (_SUN / np.linalg.norm(_SUN)), 0)
    picture = base[face] * (light * (1 + mottle[face] * noise))[..., None]
    picture[buffers.face < 0] = _SKY
    small = cv2.resize(np.clip(picture, 0, 255), (view.width, view.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small.round(), np.uint8)


def _write_model(
    folder: Path,
    mesh: Mesh,
    mottle: NDArray[np.float64],
    views: list[View],
    rendered: list[MeshBuffers],
    spec: SceneSpec,
    ground: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """The true cameras with tracks of points on what has texture within ``ground``, each a little off."""
    rng = np.random.default_rng([spec.seed, 5])
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weight = area * np.maximum(mottle - 0.02, 0.005)
    weight[((corners[..., :2] < ground[0]) | (corners[..., :2] > ground[1])).any((1, 2))] = 0
    count = int(_DENSITY * np.prod(ground[1] - ground[0]))
    face = rng.choice(len(weight), count, p=weight / weight.sum())
    a, b = rng.random((2, count, 1))
    turn = a + b > 1
    a, b = np.where(turn, 1 - a, a), np.where(turn, 1 - b, b)
    true = corners[face, 0] + a * (corners[face, 1] - corners[face, 0]) + b * (corners[face, 2] - corners[face, 0])
    tracks: list[list[tuple[int, int]]] = [[] for _ in true]
    model = pycolmap.Reconstruction()
    f = photo_frame(spec)
    camera = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.PINHOLE, f.fx, f.width, f.height)
    camera.params = [f.fx, f.fy, f.cx, f.cy]
    model.add_camera_with_trivial_rig(camera)
    for number, (view, buffers) in enumerate(zip(views, rendered, strict=True), start=1):
        uv, depth, inside = view.project_into_frame(true, margin=1)
        index = np.flatnonzero(inside)
        met = buffers.depth[uv[index, 1].astype(int), uv[index, 0].astype(int)]
        index = index[np.abs(met - depth[index]) < 0.02 * depth[index]]
        index = index[rng.random(len(index)) < 0.7]  # nobody finds every one again
        image = pycolmap.Image(name=view.name, camera_id=1, image_id=number)
        spots = np.clip(uv[index] + rng.normal(0, _SIGMA, (len(index), 2)), 0.1, (view.width - 0.1, view.height - 0.1))
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in spots])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.c_[view.rotation, view.translation]))
        for place, point in enumerate(index.tolist()):
            tracks[point].append((number, place))
    for point, track in zip(true + rng.normal(0, _OFF, true.shape), tracks, strict=True):
        if len(track) >= 3:
            elements = [pycolmap.TrackElement(image, place) for image, place in track]
            model.add_point3D(point, pycolmap.Track(elements), np.array([128, 128, 128], np.uint8))
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(folder))
