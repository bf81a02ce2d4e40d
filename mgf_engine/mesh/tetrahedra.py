# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the opacity is asked: points spanned by the Gaussians, and the Delaunay tetrahedra between them.

Each Gaussian gives its centre and the corners of its box. The box reaches as far as the Gaussian is visible,
sqrt(2 ln(255 alpha)) standard deviations (there its contribution falls below 1/255), and never beyond three.
"""

from __future__ import annotations

import contextlib
import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.field.gaussians import Gaussians
from mgf_engine.mesh.order import morton
from mgf_engine.raster.points import deviations

MAX_SIGMA = 3.0
MERGE = 1e-6  # of the points' bounding box: nearer points become one

with contextlib.suppress(ModuleNotFoundError):  # one that is there and cannot be loaded says why itself
    from igl.copyleft import tetgen

_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # [8, 3]


@dataclass(frozen=True)
class TetraPoints:
    """Points where the opacity is asked.

    Attributes:
        points: float64 [M, 3], normalised frame, no two alike.
        extent: float64 [M], half the diagonal of the box of the Gaussian a point came from (the largest, when merged).
    """

    points: NDArray[np.float64]
    extent: NDArray[np.float64]


def tetra_points(gaussians: Gaussians) -> TetraPoints:
    """Centres and box corners of the visible Gaussians, nearly equal ones merged.

    Raises:
        BadInput: no Gaussian is visible.
    """
    opacity = gaussians.opacities.detach().double().numpy()
    visible = opacity > 1 / 255
    if not visible.any():
        raise BadInput("No Gaussian is opaque enough to make a surface; train longer or check the masks.")
    centres = gaussians.positions.detach().double().numpy()[visible]
    reach = np.minimum(MAX_SIGMA, np.sqrt(2 * np.log(255 * opacity[visible])))
    half_axes = deviations(gaussians)[visible] * reach[:, None, None]
    offsets = np.einsum("nij,cj->nci", half_axes, _CORNERS)
    points = np.concatenate([centres[:, None], centres[:, None] + offsets], 1).reshape(-1, 3)
    extent = np.repeat(np.sqrt((half_axes**2).sum((1, 2))), 1 + len(_CORNERS))
    return _merge(points, extent)


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


def delaunay(points: NDArray[np.float64], method: str = "tetgen") -> NDArray[np.int32]:
    """Delaunay tetrahedra [T, 4] of distinct points [M, 3], all of positive volume.

    Args:
        method: "tetgen" (libigl; fast) or "qhull" (SciPy; permissive licence, about ten times slower).

    Raises:
        BadInput: fewer than four points, or all in one plane, or the chosen method is not installed.
    """
    if len(points) < 4 or _flat(points):
        raise BadInput("The field is a point, a line or a plane, and no surface can be made of it; train longer.")
    if method == "tetgen":
        return _tetgen(points)
    from scipy.spatial import Delaunay

    return _positive(points, Delaunay(points).simplices.astype(np.int32))


def _flat(points: NDArray[np.float64]) -> bool:
    centred = points - points.mean(0)
    spread = np.linalg.svd(centred.T @ centred, compute_uv=False)
    return bool(spread[2] <= 1e-14 * spread[0])


def _tetgen(points: NDArray[np.float64]) -> NDArray[np.int32]:
    if "tetgen" not in globals():
        raise BadInput("libigl is not installed; run 'pip install libigl' or choose the method 'qhull'.")
    low, size = points.min(0), float(np.ptp(points, axis=0).max())
    try:
        result = tetgen.tetrahedralize(np.ascontiguousarray((points - low) / size), flags="Q")
    except RuntimeError as error:
        raise BadInput(f"The tetrahedra of the field could not be made ({error}); train longer.") from error
    if len(result[0]) != len(points):
        raise RuntimeError("tetgen changed the points")
    return result[1].astype(np.int32)


def _positive(points: NDArray[np.float64], tetrahedra: NDArray[np.int32]) -> NDArray[np.int32]:
    """The tetrahedra that have a volume, turned so that it is positive."""
    a, b, c, d = (points[tetrahedra[:, k]] for k in range(4))
    volume = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)
    turned = tetrahedra.copy()
    turned[volume < 0] = turned[volume < 0][:, [0, 1, 3, 2]]
    return turned[volume != 0]
