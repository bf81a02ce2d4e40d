# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangle mesh with colours and further vertex attributes, and its texture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.model.topology import Adjacency


@dataclass(frozen=True)
class Mesh:
    """Triangles with outward orientation (counter-clockwise seen from outside).

    Attributes:
        vertices: float64 [N, 3].
        faces: int32 [F, 3].
        colors: uint8 [N, 3].
        values: further vertex attributes, name -> [N]; properties of the PLY file.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    colors: NDArray[np.uint8]
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @cached_property
    def adjacency(self) -> Adjacency:
        """The corners around each vertex."""
        return Adjacency.of(self.faces, len(self.vertices))

    def gather(self, index: NDArray[np.integer], faces: NDArray[np.integer]) -> Mesh:
        """Return the mesh of the vertices at ``index`` [M], with all they carry, and ``faces`` [F, 3] between them."""
        values = {name: value[index] for name, value in self.values.items()}
        return Mesh(self.vertices[index], np.asarray(faces, np.int32), self.colors[index], values)


@dataclass(frozen=True)
class Texture:
    """Texture image and the UV coordinates of the faces.

    Attributes:
        uv: float32 [F, 3, 2], 0..1, u to the right, v upwards, of the corners of each face.
        image: RGB uint8 [H, W, 3], first row at the top (v = 1).
    """

    uv: NDArray[np.float32]
    image: NDArray[np.uint8]
