# SPDX-License-Identifier: GPL-3.0-or-later
"""Several meshes as one."""

from __future__ import annotations

import numpy as np

from mgf_engine.model.mesh import Mesh


def merged(*meshes: Mesh) -> Mesh:
    """Return one mesh with the vertices and faces of all, in their order."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(faces).astype(np.int32),
        np.concatenate([mesh.colors for mesh in meshes]),
    )
