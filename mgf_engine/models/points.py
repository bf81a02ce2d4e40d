# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on the surface of the mesh with its colours, as LAZ, for those who compare with a laser scanner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine import __version__
from mgf_engine.drawings.model import Array, Survey
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.geometry.clean import face_areas
from mgf_engine.georef.crs import ProjectedCrs
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.models.atlas import colors_at

FILE = "surface.laz"
MAX_POINTS = 20_000_000
MILLIMETRE = 0.001
BUILDING = 6  # class of ASPRS
STEPS = 5e6  # of a coordinate over the size of the building, where lengths are no metres


def least_spacing(mesh: Mesh) -> float:
    """Return the spacing at which a mesh has :data:`MAX_POINTS` points, in its unit."""
    return float(np.sqrt(face_areas(mesh).sum() / MAX_POINTS))


def surface_points(mesh: Mesh, texture: Texture | None, spacing: float) -> tuple[Array, NDArray[np.uint8], Array]:
    """Return points spread evenly over a mesh.

    Args:
        spacing: about the distance between neighbours, in the mesh's unit; :func:`least_spacing` or more.

    Returns:
        points [N, 3], colours RGB uint8 [N, 3], outward normals [N, 3].
    """
    surface = Surface(mesh.vertices, mesh.faces.astype(np.int64))
    count = max(1, int(surface.areas.sum() / spacing**2))
    points, face = surface.sample(count, np.random.default_rng(0))
    if texture is not None:
        colors = colors_at(points, face, surface, texture)
    else:
        corner = np.linalg.norm(mesh.vertices[mesh.faces[face]] - points[:, None], axis=2).argmin(1)
        colors = mesh.colors[mesh.faces[face, corner]]
    return points, colors, surface.normals(face)


def write_laz(path: Path, survey: Survey, points: Array, colors: NDArray[np.uint8], normals: Array) -> None:
    """Write LAZ 1.4 in the coordinates of the CRS, or local ones where there is none; normals as extra dimensions.

    Args:
        path: of the file.
        survey: for the CRS.
        points: [n, 3], local frame.
        colors: uint8 [n, 3].
        normals: unit [n, 3].
    """
    import laspy

    world, turned = survey.world(points), normals @ survey.turn
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.offsets = np.floor(world.min(0))
    size = float(np.ptp(world, axis=0).max())
    header.scales = np.full(3, MILLIMETRE if survey.georeference.metric else size / STEPS)
    header.generating_software = f"mgf {__version__}"[:32]
    header.add_extra_dims([laspy.ExtraBytesParams(f"normal_{axis}", "float32") for axis in "xyz"])
    if survey.georeference.crs is not None:
        header.add_crs(ProjectedCrs(survey.georeference.crs).crs)
    data = laspy.LasData(header)
    data.x, data.y, data.z = world.T
    data.red, data.green, data.blue = (colors.astype(np.uint16) * 257).T
    for axis, values in zip("xyz", turned.T, strict=True):
        data[f"normal_{axis}"] = values.astype(np.float32)
    data.classification = np.full(len(world), BUILDING, np.uint8)
    data.write(str(path))
