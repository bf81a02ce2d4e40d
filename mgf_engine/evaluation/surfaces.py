# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangle meshes for evaluation: reading, sampling by area, distances, visibility from cameras, defects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason
from mgf_engine.geometry.components import label_components
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import View

Points = NDArray[np.float64]
Faces = NDArray[np.int64]


@dataclass(frozen=True)
class Hygiene:
    """How clean a mesh is.

    Attributes:
        components: connected parts (over shared vertices).
        boundary_edges: edges with one face; holes: closed chains of them.
        non_manifold_edges: edges with more than two faces.
        area: of all faces, squared units of the mesh.
    """

    vertices: int
    faces: int
    components: int
    boundary_edges: int
    holes: int
    non_manifold_edges: int
    area: float


@dataclass(frozen=True)
class MaskedView:
    """A view, in the frame of the surface, for visibility tests.

    Attributes:
        view: its camera.
        mask: bool [height, width] or None; false where something hides the surface.
    """

    view: View
    mask: NDArray[np.bool_] | None = None


class Surface:
    """A triangle mesh with a tree for closest points and rays.

    Args:
        vertices: [N, 3]; faces: [F, 3], any orientation.

    Raises:
        BadInput: no face, a face with an unknown vertex, or a coordinate that is not finite.
    """

    def __init__(self, vertices: Points, faces: Faces, name: str = "mesh") -> None:
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64).reshape(-1, 3)
        self.faces = np.ascontiguousarray(faces, dtype=np.int64).reshape(-1, 3)
        if len(self.faces) == 0:
            raise BadInput(f"The mesh '{name}' has no faces; give a triangle mesh, not a point cloud.")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise BadInput(f"The mesh '{name}' has faces with vertices that do not exist; write it again.")
        if not np.isfinite(self.vertices).all():
            raise BadInput(f"The mesh '{name}' has coordinates that are not numbers; write it again.")
        corners = self.vertices[self.faces]
        self._double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.areas = 0.5 * np.linalg.norm(self._double, axis=1)
        if self.areas.sum() <= 0:
            raise BadInput(f"The mesh '{name}' has no area; all its faces are degenerate.")

    @cached_property
    def _tree(self) -> Any:
        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    def sample(self, count: int, rng: np.random.Generator) -> tuple[Points, Faces]:
        """Return points uniform by area, systematic over the faces: points [count, 3], face of each [count]."""
        steps = (np.arange(count) + rng.random(count)) / count * self.areas.sum()
        face = np.minimum(np.searchsorted(np.cumsum(self.areas), steps, side="right"), len(self.faces) - 1)
        u, v = rng.random((2, count))
        root = np.sqrt(u)
        weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
        return np.einsum("nk,nkd->nd", weights, self.vertices[self.faces[face]]), face.astype(np.int64)

    def normals(self, faces: Faces) -> Points:
        """Return unit normals of faces [N], [N, 3]; zero for those without area."""
        double = 2.0 * self.areas[faces, None]
        return np.divide(self._double[faces], double, out=np.zeros((len(faces), 3)), where=double > 0)

    def distances(self, points: Points) -> Points:
        """Return the distance of each point to the surface, [N]."""
        return np.sqrt(self.closest(points)[0])

    def closest(self, points: Points) -> tuple[Points, Faces, Points]:
        """Return squared distance [N], face [N] and closest point [N, 3] on the surface."""
        squared, face, spot = self._tree.squared_distance(self.vertices, self.faces, np.ascontiguousarray(points))
        return squared, face, spot

    def first_hits(self, eye: Points, rays: Points) -> tuple[Faces, Points]:
        """Return first face each ray from one eye meets [N] (-1: none), and where along the ray (1: at its end) [N]."""
        origins = np.repeat(eye[None], len(rays), axis=0)
        face, share, _ = self._tree.intersect_ray_first(self.vertices, self.faces, origins, rays)
        return face, share

    def seen_by(self, points: Points, views: Sequence[MaskedView]) -> NDArray[np.bool_]:
        """Tell which points on this surface some view sees: in front, in frame, in its mask, nothing between; [N]."""
        seen = np.zeros(len(points), dtype=bool)
        for masked in views:
            left = np.flatnonzero(~seen)
            if len(left) == 0:
                break
            left = left[_in_mask(points[left], masked)]
            if len(left) == 0:
                continue
            eye = masked.view.centre
            face, share = self.first_hits(eye, points[left] - eye)
            seen[left[(face < 0) | (share > 1.0 - 1e-4)]] = True
        return seen

    def hygiene(self) -> Hygiene:
        """Count what is wrong with the mesh; vertices at one place count as one."""
        _, index = np.unique(self.vertices, axis=0, return_inverse=True)
        faces = index.reshape(-1)[self.faces]
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        edges = edges[edges[:, 0] != edges[:, 1]]
        unique, counts = np.unique(edges, axis=0, return_counts=True)
        border = unique[counts == 1]
        used = np.unique(faces)
        return Hygiene(
            vertices=len(self.vertices), faces=len(self.faces), components=_pieces(unique, used),
            boundary_edges=len(border), holes=_pieces(border, np.unique(border)),
            non_manifold_edges=int((counts > 2).sum()), area=float(self.areas.sum()),
        )  # fmt: skip


def _in_mask(points: Points, masked: MaskedView) -> NDArray[np.bool_]:
    """Tell which points [N, 3] lie in the frame of a view, and in its mask where it has one, bool [N]."""
    uv, _, inside = masked.view.project_into_frame(points)
    if masked.mask is not None:
        inside[inside] = masked.mask[pixel_at(masked.mask.shape, uv[inside])]
    return inside


def _pieces(edges: NDArray[np.int64], used: NDArray[np.int64]) -> int:
    """Return connected components of a graph over the used vertices."""
    if len(used) == 0:
        return 0
    rows = np.searchsorted(used, edges)
    return int(label_components(len(used), *rows.T).max()) + 1


def read_surface(path: Path) -> Surface:
    """Read a mesh file (PLY, OBJ, GLB, STL, OFF) as one surface.

    Raises:
        BadInput: the file is missing, unreadable or holds no triangles.
    """
    if not path.is_file():
        raise BadInput(f"There is no mesh '{path}'; give the path of a PLY, OBJ or GLB file.")
    try:
        loaded: Any = trimesh.load(path, process=False, force="mesh")
        vertices, faces = np.asarray(loaded.vertices), np.asarray(getattr(loaded, "faces", np.zeros((0, 3))))
    except Exception as error:  # the readers raise whatever their parsers raise
        raise BadInput(f"Cannot read the mesh '{path}' ({reason(error)}); give a PLY, OBJ or GLB file.") from error
    return Surface(vertices, faces, str(path))
