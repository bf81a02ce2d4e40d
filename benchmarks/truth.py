# SPDX-License-Identifier: GPL-3.0-or-later
"""The truth of a synthetic scene: its mesh with a material per face, and depth, normal and material per pixel.

``truth.ply`` is the building's mesh in metres, z up. ``truth_materials.json`` is a list of names (the generator's
materials); ``truth_materials.npy`` holds for each face of ``truth.ply``, in its order, an index into that list (int32).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from benchmarks.catalogue import SceneSpec
from benchmarks.develop import pixel_rays
from benchmarks.shapes import Part, Points, labelled_mesh
from mgf_engine.errors import BadInput
from mgf_engine.evaluation.materials import Materials, read_materials
from mgf_engine.evaluation.surfaces import Surface, read_surface
from mgf_engine.files.atomic import atomic_path, write_json

MESH, MATERIALS, FACE_MATERIALS = "truth.ply", "truth_materials.json", "truth_materials.npy"


def write_truth(folder: Path, parts: Sequence[Part]) -> None:
    """Mesh and materials of a building into a scene's folder; the list of names is written last."""
    building = [p for p in parts if p.building]
    vertices, faces, owner = labelled_mesh(building)
    names = sorted({p.material for p in building})
    materials = np.array([names.index(p.material) for p in building], dtype=np.int32)[owner]
    _write_ply(folder / MESH, vertices, faces)
    with atomic_path(folder / FACE_MATERIALS) as partial, partial.open("wb") as stream:
        np.save(stream, materials)
    write_json(folder / MATERIALS, names)


def _write_ply(path: Path, vertices: Points, faces: NDArray[np.int32]) -> None:
    head = [
        "ply", "format binary_little_endian 1.0", "comment metres, z up",
        f"element vertex {len(vertices)}", "property float x", "property float y", "property float z",
        f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n",
    ]  # fmt: skip
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("i", "<i4", (3,))])
    rows["n"], rows["i"] = 3, faces
    with atomic_path(path) as partial:
        partial.write_bytes("\n".join(head).encode() + vertices.astype("<f4").tobytes() + rows.tobytes())


@dataclass(frozen=True)
class Truth:
    """A scene's true mesh and what its faces are made of."""

    surface: Surface
    materials: Materials


@dataclass(frozen=True)
class TruePixels:
    """What the rays through a photo's pixel centres meet first of the building; nothing of the surroundings counts.

    Attributes:
        depth: float64 [H, W], along the camera's axis, infinite where the building is not met.
        normal: float64 [H, W, 3], unit, out of the building; 0 where it is not met.
        material: int64 [H, W], index into the materials' names; -1 where the building is not met.
    """

    depth: NDArray[np.float64]
    normal: NDArray[np.float64]
    material: NDArray[np.int64]

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Where the building is met, bool [H, W]."""
        return np.asarray(self.material >= 0)


def read_truth(folder: Path) -> Truth:
    """Read the truth of a scene.

    Raises:
        BadInput: a file is missing or does not fit the others.
    """
    surface = read_surface(folder / MESH)
    materials = read_materials(folder / MESH, len(surface.faces))
    if materials is None:
        raise BadInput(f"The scene '{folder}' has no materials; make it again with 'mgf bench scenes'.")
    return Truth(surface, materials)


def true_pixels(truth: Truth, rotation: Points, translation: Points, rays: Points) -> TruePixels:
    """Return depth, normal and material per pixel by casting rays.

    Args:
        rotation, translation: ``camera = rotation @ world + translation``.
        rays: [H, W, 3] in the camera's frame with z = 1, see :func:`benchmarks.develop.pixel_rays`.
    """
    face, depth = truth.surface.first_hits(-rotation.T @ translation, rays.reshape(-1, 3) @ rotation)
    hit = face >= 0
    corners = truth.surface.vertices[truth.surface.faces[face[hit]]]
    out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.zeros((len(face), 3))
    normal[hit] = out / np.linalg.norm(out, axis=1, keepdims=True)
    shape = rays.shape[:2]
    return TruePixels(
        np.where(hit, depth, np.inf).reshape(shape), normal.reshape(*shape, 3),
        np.where(hit, truth.materials.faces[face], -1).reshape(shape),
    )  # fmt: skip


def write_pixels(folder: Path, spec: SceneSpec) -> Path:
    """``pixels/PHOTO.npz`` of each photo of a scene: depth, normal (both float32), material (int16), mask; its folder.

    The pixels are those of the photo, lens and all; the camera is the true one of ``sparse_truth``.

    Raises:
        BadInput: the scene's truth is missing or damaged.
    """
    truth, rays, out = read_truth(folder), pixel_rays(spec), folder / "pixels"
    out.mkdir(exist_ok=True)
    for image in pycolmap.Reconstruction(folder / "sparse_truth").images.values():
        pose = image.cam_from_world()
        seen = true_pixels(truth, pose.rotation.matrix(), pose.translation, rays)
        with atomic_path(out / f"{Path(image.name).stem}.npz") as partial, partial.open("wb") as stream:
            np.savez_compressed(
                stream, depth=seen.depth.astype(np.float32), normal=seen.normal.astype(np.float32),
                material=seen.material.astype(np.int16), mask=seen.mask,
            )  # fmt: skip
    return out
