# SPDX-License-Identifier: GPL-3.0-or-later
"""Remove false volumes that no photo shows, such as the space behind bars and railings.

To the level set, unseen space is as solid as the inside of a wall. Such a volume differs from a wall that few photos
show by its thickness: behind its surface is free space, behind a wall is the building.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import face_areas, open_edges, unconfirmed_patches, with_faces
from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.model.mesh import Mesh
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class UnobservedVolumeOptions:
    """Options of the removal of volumes that no photo shows."""

    thick: float = parameter(45.0, "Maximum thickness of a removed volume", "ground px")
    thick_share: float = parameter(0.05, "Maximum thickness, as a share of the mesh's size", high=1)
    probes: tuple[float, float, float] = parameter(
        (1 / 3, 2 / 3, 1.0),
        "Depths behind the surface at which free space is tested, as shares of the maximum thickness",
        high=1,
    )
    smallest: float = parameter(
        0.0005, "Minimum area of a patch, as a share of the mesh; smaller ones close holes", high=1
    )
    least_width: float = parameter(
        4.0, "Minimum width of a patch (twice its area by its rim); narrower ones close slits", "ground px"
    )
    most: float = parameter(0.5, "Share of a patch's area that must have free space behind it", high=1)


def drop_unobserved(
    mesh: Mesh,
    confirmed: NDArray[np.bool_],
    pixel: NDArray[np.floating],
    free: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
    options: UnobservedVolumeOptions = UnobservedVolumeOptions(),
) -> Mesh:
    """Remove unconfirmed patches with free space close behind them.

    Args:
        mesh: normalised frame.
        confirmed: vertices that photos show, bool [N].
        pixel: size of a ground pixel at each vertex, [N].
        free: points [N, 3] -> whether they lie in free space, bool [N].
        options: maximum thickness of such a volume, and the probed depths behind its faces.
    """
    made_up, patch, area = unconfirmed_patches(mesh, confirmed)
    if not len(made_up):
        return mesh
    areas = face_areas(mesh)
    wide = 2 * area > options.least_width * _measure_rims(replace(mesh, faces=mesh.faces[made_up]), patch, pixel)
    large = (wide & (area > options.smallest * areas.sum()))[patch]
    made_up, patch = made_up[large], patch[large]
    asked = np.unique(mesh.faces[made_up])
    reach = np.minimum(
        options.thick * pixel[asked], options.thick_share * np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    )
    spots, inward = mesh.vertices[asked], -reach[:, None] * vertex_normals(mesh)[asked]
    thin = np.zeros(len(mesh.vertices))
    thin[asked] = np.any([free(spots + depth * inward) for depth in options.probes], axis=0)
    before = np.bincount(patch, weights=areas[made_up] * thin[mesh.faces[made_up]].mean(1), minlength=len(area))
    return with_faces(mesh, np.delete(mesh.faces, made_up[(before > options.most * area)[patch]], axis=0))


def _measure_rims(mesh: Mesh, patch: NDArray[np.integer], pixel: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the length of each patch's rim, times the size of a pixel there; ``patch``: of each face, [F]."""
    of_vertex = np.zeros(len(mesh.vertices), np.int64)
    of_vertex[mesh.faces] = patch[:, None]
    start, end = open_edges(mesh)
    length = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1) * pixel[start]
    return np.asarray(np.bincount(of_vertex[start], length, int(patch.max(initial=-1)) + 1), np.float64)
