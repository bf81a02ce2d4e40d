# SPDX-License-Identifier: GPL-3.0-or-later
"""A long front photographed in two rows, whose COLMAP model is bent: its lens was taken for a pinhole.

The model is what bundle adjustment without control makes of the tracks, so that it agrees with itself.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pycolmap

SIZE, FOCAL, BEND = (800, 600), 700.0, -0.02
ORIGIN = np.array([691_200.0, 5_334_800.0, 500.0])
TARGETS = {
    "P1": (-18, 0, 1), "P2": (18, 0, 1), "P3": (-18, 0, 7), "P4": (18, 0, 7), "P5": (0, -1, 8), "C1": (-9, 0, 4),
    "C2": (9, 0, 4), "C3": (0, 0, 1),
}  # fmt: skip


def write_strip(folder: Path, noise: float = 0.5) -> tuple[Path, Path]:
    """Scene with photos and model, and the files of points (1 cm) and marks (``noise`` pixels)."""
    rng = np.random.default_rng(0)
    true = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=SIZE[0], height=SIZE[1], params=[FOCAL, 400, 300, BEND], camera_id=1
    )
    poses = [_pose(x, z) for z in (2.0, 6.5) for x in np.linspace(-20, 20, 9)]
    points = rng.uniform((-21, 0, 0), (21, 0, 9), (700, 3))
    points[:, 1] = rng.choice((0.0, -0.6, 0.5), 700)
    model = pycolmap.Reconstruction()
    guess = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=SIZE[0], height=SIZE[1], params=[FOCAL, 400, 300], camera_id=1
    )
    model.add_camera_with_trivial_rig(guess)
    tracks: list[list[pycolmap.TrackElement]] = [[] for _ in points]
    marks = ["name,photo,x,y"]
    for number, pose in enumerate(poses, start=1):
        at, seen = _seen(true, pose, points)
        keypoints = at[seen] + rng.normal(0, noise, (len(seen), 2))
        for place, index in enumerate(seen):
            tracks[index].append(pycolmap.TrackElement(number, place))
        name = f"p{number:02d}.png"
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=name, keypoints=keypoints, camera_id=1, image_id=number), pose
        )
        targets, shown = _seen(true, pose, np.array(list(TARGETS.values()), float))
        for index in shown:
            x, y = targets[index] + rng.normal(0, noise, 2)
            marks.append(f"{list(TARGETS)[index]},{name},{x:.3f},{y:.3f}")
        (folder / "images").mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / "images" / name), np.full((SIZE[1], SIZE[0], 3), 128, np.uint8))
    for point, track in zip(points, tracks, strict=True):
        if len(track) > 1:
            model.add_point3D(point, pycolmap.Track(track))
    _bundle(model)
    model.transform(pycolmap.Sim3d(0.2, pycolmap.Rotation3d(np.array([0.1, 0.2, 0.3, 0.9])), np.array([3.0, 1, 2])))
    (folder / "sparse" / "0").mkdir(parents=True)
    model.write_binary(str(folder / "sparse" / "0"))
    lines = ["name,east,north,height,accuracy,role"]
    for name, at in TARGETS.items():
        east, north, height = ORIGIN + at + rng.normal(0, 0.01, 3)
        lines.append(f"{name},{east:.4f},{north:.4f},{height:.4f},0.01,{'check' if name[0] == 'C' else 'control'}")
    (folder / "points.csv").write_text("\n".join(lines))
    (folder / "marks.csv").write_text("\n".join(marks))
    return folder / "points.csv", folder / "marks.csv"


def _pose(x: float, z: float) -> pycolmap.Rigid3d:
    eye = np.array([x, -9.0, z])
    forward = np.array([0.3 * x, 0, 4.0]) - eye if abs(x) > 15 else np.array([x, 0, 4.0]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1.0))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return pycolmap.Rigid3d(np.c_[rotation, -rotation @ eye])


def _seen(camera: pycolmap.Camera, pose: pycolmap.Rigid3d, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    local = pose * points
    at = np.asarray(camera.img_from_cam(local)).reshape(-1, 2)
    inside = (local[:, 2] > 0.1) & (at > 5).all(1) & (at < np.array(SIZE) - 5).all(1)
    return at, np.flatnonzero(inside)


def _bundle(model: pycolmap.Reconstruction) -> None:
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary, options.ceres.solver_options.num_threads = False, 1
    pycolmap.bundle_adjustment(model, options)
