# SPDX-License-Identifier: GPL-3.0-or-later
"""A synthetic house: COLMAP model, photos and a finished job folder, made with numpy and the standard library."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

#: One camera of every kind the reader knows, with odd sizes, fx != fy and principal points off the centre.
CAMERAS = {
    1: ("SIMPLE_PINHOLE", 640, 480, (500.0, 320.0, 240.0)),
    2: ("PINHOLE", 641, 479, (612.5, 580.25, 301.2, 260.7)),
    3: ("PINHOLE", 479, 641, (550.0, 700.0, 260.0, 300.0)),
    4: ("SIMPLE_RADIAL", 800, 600, (700.0, 410.0, 290.0, 0.0)),
    5: ("OPENCV", 400, 900, (801.0, 799.0, 180.0, 470.0, 0.0, 0.0, 0.0, 0.0)),
    6: ("PINHOLE", 1500, 700, (4000.0, 4100.0, 100.0, 650.0)),
}
NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "OPENCV": 4}


@dataclass(frozen=True)
class House:
    """Where the synthetic scene lies and what it truly is."""

    folder: Path
    model: Path
    job: Path
    poses: dict  # photo name -> (camera id, rotation [3, 3], translation [3])
    xyz: np.ndarray
    rgb: np.ndarray


def write_png(path: Path, rgb: np.ndarray) -> None:
    """A PNG from uint8 [H, W, 3] or [H, W]."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = rgb.shape[:2]
    kind = 2 if rgb.ndim == 3 else 0
    rows = b"".join(b"\0" + np.ascontiguousarray(row).tobytes() for row in rgb)

    def chunk(tag: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body))

    head = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World -> camera for COLMAP axes."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    return rotation, -rotation @ eye


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation matrix, by the largest component."""
    m = rotation
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    values, vectors = np.linalg.eigh(k / 3.0)
    x, y, z, w = vectors[:, np.argmax(values)]
    return np.array([w, x, y, z])


def write_house(
    folder: Path, shift: tuple = (0.0, 0.0, 0.0), tilt: bool = True, text: bool = False, prefix: str = "IMG"
) -> House:
    """Write model, photos and a finished job; the house leans with the whole scene when ``tilt`` is set."""
    random = np.random.default_rng(7)
    xyz = random.uniform((-3, -2, 0), (3, 2, 4), (400, 3))
    rgb = random.integers(0, 256, (400, 3)).astype(np.uint8)
    turn = _turn(0.7, -0.4) if tilt else np.eye(3)
    poses = {}
    for i in range(12):
        angle = 2 * np.pi * i / 12
        eye = np.array([14 * np.cos(angle), 12 * np.sin(angle), 3.0 + (i % 3)])
        rotation, _ = look_at(eye, np.array([0.2, 0.1, 1.8]), np.array([0, 0, 1.0]))
        rotation, eye = rotation @ turn.T, turn @ eye + shift
        poses[f"wing/{prefix} {i:02d}.png"] = (1 + i % 6, rotation, -rotation @ eye)
    xyz = xyz @ turn.T + shift
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (write_text if text else write_binary)(model, poses, xyz, rgb)
    for name, (camera, _, _) in poses.items():
        _, width, height, _ = CAMERAS[camera]
        write_png(folder / "images" / name, _gradient(width, height))
    job = folder / "job"
    write_job(job, poses, turn, np.array(shift))
    return House(folder, model, job, poses, xyz, rgb)


def _turn(a: float, b: float) -> np.ndarray:
    rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return rx @ ry


def _gradient(width: int, height: int) -> np.ndarray:
    picture = np.zeros((height, width, 3), np.uint8)
    picture[..., 0] = np.linspace(0, 255, width)[None]
    picture[..., 1] = np.linspace(0, 255, height)[:, None]
    return picture


def write_binary(model: Path, poses: dict, xyz: np.ndarray, rgb: np.ndarray) -> None:
    """cameras.bin, images.bin, points3D.bin."""
    out = struct.pack("<Q", len(CAMERAS))
    for number, (name, width, height, params) in CAMERAS.items():
        out += struct.pack(f"<IiQQ{len(params)}d", number, NUMBERS[name], width, height, *params)
    (model / "cameras.bin").write_bytes(out)
    out = struct.pack("<Q", len(poses))
    for i, (name, (camera, rotation, translation)) in enumerate(poses.items()):
        out += struct.pack("<I7dI", i + 1, *quaternion(rotation), *translation, camera) + name.encode() + b"\0"
        out += struct.pack("<Q", 2) + struct.pack("<ddqddq", 1.0, 2.0, 1, 3.0, 4.0, -1)
    (model / "images.bin").write_bytes(out)
    out = struct.pack("<Q", len(xyz))
    for i, (p, c) in enumerate(zip(xyz, rgb, strict=True)):
        track = struct.pack("<IIII", 1, 0, 2, 0)
        out += struct.pack("<Q3d3BdQ", i + 1, *p, *c.tolist(), 0.25, 2) + track
    (model / "points3D.bin").write_bytes(out)


def write_text(model: Path, poses: dict, xyz: np.ndarray, rgb: np.ndarray) -> None:
    """The same as .txt files."""
    lines = ["# Camera list"]
    for number, (name, width, height, params) in CAMERAS.items():
        lines.append(" ".join(map(repr, (number,))) + f" {name} {width} {height} " + " ".join(map(repr, params)))
    (model / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# Image list"]
    for i, (name, (camera, rotation, translation)) in enumerate(poses.items()):
        numbers = " ".join(repr(float(v)) for v in (*quaternion(rotation), *translation))
        lines += [f"{i + 1} {numbers} {camera} {name}", "" if i % 2 else "1.0 2.0 1 3.0 4.0 -1"]
    (model / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# 3D point list"]
    for i, (p, c) in enumerate(zip(xyz, rgb, strict=True)):
        numbers = " ".join(repr(float(v)) for v in p)
        lines.append(f"{i + 1} {numbers} {' '.join(map(str, c.tolist()))} 0.25 1 0 2 0")
    (model / "points3D.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def house_mesh() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Walls and a gable roof: vertices [N, 3], triangles [F, 3], colours [N, 3]."""
    x, y, z, top = 3.0, 2.0, 2.8, 4.2
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0), (-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)]
    corners += [(-x, 0, top), (x, 0, top)]
    quads = [(0, 1, 5, 4), (2, 3, 7, 6), (4, 5, 9, 8), (6, 7, 8, 9), (3, 2, 1, 0)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    faces += [(1, 2, 6), (1, 6, 5), (5, 6, 9), (3, 0, 4), (3, 4, 7), (7, 4, 8)]
    colors = np.array([(176, 92, 70)] * 8 + [(90, 96, 110)] * 2, np.uint8)
    return np.array(corners, float), np.array(faces, np.int32), colors


def write_mesh(path: Path, xyz: np.ndarray, faces: np.ndarray, rgb: np.ndarray, **extras: np.ndarray) -> None:
    """A binary PLY with float64 positions and float32 values per vertex."""
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        + "".join(f"property float {name}\n" for name in extras)
        + f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertices = np.zeros(len(xyz), [("p", "<f8", 3), ("c", "u1", 3), *((name, "<f4") for name in extras)])
    vertices["p"], vertices["c"] = xyz, rgb
    for name, values in extras.items():
        vertices[name] = values
    table = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    table["n"], table["v"] = 3, faces
    path.write_bytes(head.encode() + vertices.tobytes() + table.tobytes())


def write_job(job: Path, poses: dict, turn: np.ndarray, shift: np.ndarray) -> None:
    """deliver.json, mesh.ply and renders of a finished job."""
    (job / "renders").mkdir(parents=True)
    xyz, faces, rgb = house_mesh()
    write_mesh(job / "mesh.ply", xyz @ turn.T + shift, faces, rgb)
    views = []
    for i, (name, (camera, rotation, translation)) in enumerate(poses.items()):
        model, width, height, params = CAMERAS[camera]
        fx, fy, cx, cy = (params[0], *params[:3]) if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL") else params[:4]
        render = None
        if i % 3 == 0:
            render = f"renders/{i:04d}.png"
            write_png(job / render, _gradient(width // 2, height // 2)[::-1])
        to_world = np.eye(4)
        to_world[:3, :3], to_world[:3, 3] = rotation.T, -rotation.T @ translation
        views.append(
            {"name": name, "file": None, "width": width // 2, "height": height // 2, "fx": fx / 2, "fy": fy / 2,
             "cx": cx / 2, "cy": cy / 2, "camera_to_world": to_world.tolist(), "render": render, "held_out": i % 3 == 0}
        )  # fmt: skip
    figures = {"psnr": 27.5, "faces": len(faces)}
    content = {"views": views, "mesh": "mesh.ply", "figures": figures, "report": "report.html"}
    (job / "deliver.json").write_text(json.dumps(content), encoding="utf-8")
    (job / "report.html").write_text("<p>report</p>", encoding="utf-8")
