# SPDX-License-Identifier: GPL-3.0-or-later
"""The truth of a synthetic scene: its mesh with a material per face, and depth, normal and material per pixel.

``truth.ply`` is the building's mesh in metres, z up. ``truth_materials.json`` is a list of names (the generator's
materials); ``truth_materials.npy`` holds for each face of ``truth.ply``, in its order, an index into that list (int32).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.bench.shapes import Part, Points, labelled_mesh
from mgf_engine.errors import BadInput
from mgf_engine.evaluate.surfaces import SeeingCamera, Surface, read_surface
from mgf_engine.system import atomic_path, write_json

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
    """A scene's true mesh; ``materials`` int32 [F] are indices into ``names``."""

    surface: Surface
    names: tuple[str, ...]
    materials: NDArray[np.int32]


@dataclass(frozen=True)
class TruePixels:
    """What the rays through a camera's pixel centres meet first; nothing of the surroundings is in the way.

    Attributes:
        depth: float64 [H, W], along the camera's axis, infinite where the building is not met.
        normal: float64 [H, W, 3], unit, out of the building; 0 where it is not met.
        material: int32 [H, W], index into :attr:`Truth.names`; -1 where it is not met.
    """

    depth: NDArray[np.float64]
    normal: NDArray[np.float64]
    material: NDArray[np.int32]

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Where the building is met, bool [H, W]."""
        return self.material >= 0


def read_truth(folder: Path) -> Truth:
    """The truth of a scene.

    Raises:
        BadInput: a file is missing or does not fit the others.
    """
    surface = read_surface(folder / MESH)
    try:
        names = tuple(json.loads((folder / MATERIALS).read_text(encoding="utf-8")))
        materials = np.load(folder / FACE_MATERIALS, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise BadInput(f"Cannot read the materials of the truth in '{folder}' ({error}); make the scene again.") from error
    if materials.shape != (len(surface.faces),) or materials.min() < 0 or materials.max() >= len(names):
        raise BadInput(f"The materials of the truth in '{folder}' are not those of its mesh; make the scene again.")
    return Truth(surface, names, materials)


def true_pixels(truth: Truth, camera: SeeingCamera) -> TruePixels:
    """Depth, normal and material per pixel by casting a ray through each pixel's centre."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    rays = local.reshape(-1, 3) @ camera.rotation
    face, depth = truth.surface.first_hits(-camera.rotation.T @ camera.translation, rays)
    hit = face >= 0
    corners = truth.surface.vertices[truth.surface.faces[face[hit]]]
    out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.zeros((len(face), 3))
    normal[hit] = out / np.linalg.norm(out, axis=1, keepdims=True)
    shape = (camera.height, camera.width)
    return TruePixels(
        np.where(hit, depth, np.inf).reshape(shape), normal.reshape(*shape, 3),
        np.where(hit, truth.materials[face], -1).astype(np.int32).reshape(shape),
    )  # fmt: skip
