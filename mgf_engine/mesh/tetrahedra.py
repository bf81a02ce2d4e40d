# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices of the tetrahedra: centre and box corners of each Gaussian, as in Gaussian Opacity Fields.

The box extends to where the contribution of the Gaussian falls below 1/255, sqrt(2 ln(255 alpha)) standard deviations,
and never beyond three. :mod:`mgf_engine.geometry.delaunay` joins the points.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mgf_engine.errors import BadInput
from mgf_engine.geometry.morton import morton
from mgf_engine.geometry.rasterize import face_normals
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.mesh import Mesh
from mgf_engine.options.algorithms import parameter
from mgf_engine.raster.points import deviations
from mgf_engine.scene.crop import CropBox
from mgf_engine.start.samples import sample_poisson_disk

MERGE = 1e-6  # distance below which points are merged, as a share of the longest side of their bounding box
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # [8, 3]


@dataclass(frozen=True)
class TetrahedraOptions:
    """Options of the points that the tetrahedra join."""

    reach: float = parameter(3.0, "Largest half side of a Gaussian's box, in standard deviations", low=0.1)
    spacing: float = parameter(3.0, "Distance between points beside the starting surface", "ground px", low=0.1)
    off: float = parameter(1.5, "Distance from the starting surface of the points beside it", "ground px", low=0.01)
    near: float = parameter(
        2.0,
        "Distance to a point of a Gaussian within which no points are added beside the starting surface",
        "ground px",
    )


@dataclass(frozen=True)
class TetraPoints:
    """Vertices of the tetrahedra.

    Attributes:
        points: distinct points, normalised frame, float64 [M, 3].
        extent: half the diagonal of the box of the Gaussian a point came from (the largest, if merged), float64 [M].
    """

    points: NDArray[np.float64]
    extent: NDArray[np.float64]


def tetra_points(gaussians: Gaussians, options: TetrahedraOptions = TetrahedraOptions()) -> TetraPoints:
    """Return centres and box corners of the visible Gaussians; nearly equal points are merged.

    Raises:
        BadInput: no Gaussian is visible.
    """
    opacity = gaussians.opacities.detach().double().numpy()
    visible = opacity > 1 / 255
    if not visible.any():
        raise BadInput("No Gaussian is opaque enough to make a surface; train longer or check the masks.")
    centres = gaussians.positions.detach().double().numpy()[visible]
    reach = np.minimum(options.reach, np.sqrt(2 * np.log(255 * opacity[visible])))
    half_axes = deviations(gaussians)[visible] * reach[:, None, None]
    offsets = np.einsum("nij,cj->nci", half_axes, _CORNERS)
    points = np.concatenate([centres[:, None], centres[:, None] + offsets], 1).reshape(-1, 3)
    extent = np.repeat(np.sqrt((half_axes**2).sum((1, 2))), 1 + len(_CORNERS))
    return _merge(points, extent)


def add_surface_points(
    sites: TetraPoints,
    mesh: Mesh,
    pixel: float,
    box: CropBox | None = None,
    beside: float = 0.0,
    options: TetrahedraOptions = TetrahedraOptions(),
) -> TetraPoints:
    """Add points on both sides of a surface where there are none near it, so that the level set can follow it.

    Args:
        sites: points of the Gaussians.
        mesh: the surface, normalised frame.
        pixel: size of a pixel at the building, in the mesh's units.
        box: crop box, in and near which points are added; None for no limit.
        beside: margin of the box, as a share of its size.
        options: spacing of the new points, and their distance from the surface.
    """
    spacing = options.spacing * pixel
    face, points = sample_poisson_disk(mesh, spacing, np.random.default_rng(0))
    normals = face_normals(mesh)[face]
    kept = cKDTree(sites.points).query(points, distance_upper_bound=options.near * pixel)[0] == np.inf
    if box is not None:
        kept &= box.contains(points, beside)
    both = [points[kept] + side * options.off * pixel * normals[kept] for side in (-1, 1)]
    extent = np.concatenate([sites.extent, np.full(2 * int(kept.sum()), 2 * spacing)])
    return _merge(np.concatenate([sites.points, *both]), extent)


def _merge(points: NDArray[np.float64], extent: NDArray[np.float64]) -> TetraPoints:
    finite = np.isfinite(points).all(1)
    points, extent = points[finite], extent[finite]
    low = points.min(0)
    cell = max(float((points.max(0) - low).max()) * MERGE, 1e-12)
    key = np.rint((points - low) / cell).astype(np.int64)
    _, first, group = np.unique(morton(key), return_index=True, return_inverse=True)
    largest = np.zeros(len(first))
    np.maximum.at(largest, group, extent)
    return TetraPoints(points[first], largest)
