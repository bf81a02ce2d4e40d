# SPDX-License-Identifier: GPL-3.0-or-later
"""Convert a job's local frame to geocentric coordinates (WGS 84, EPSG:4978)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pycolmap
from numpy.typing import NDArray

from mgf_engine.drawings.model import Survey
from mgf_engine.georef.crs import ProjectedCrs
from mgf_engine.georef.model import Georeference

Array = NDArray[np.float64]

ARM = 100.0  # metres along each axis over which a projection counts as linear; a building is not larger


def to_geocentric(survey: Survey) -> Array | None:
    """Return the matrix from the local frame of the drawings to geocentric coordinates in metres, [4, 4]; None where
    nobody knows the place.

    Raises:
        BadInput: the job has a CRS, and pyproj is not installed.
    """
    return place_on_earth(survey.georeference, survey.world, survey.turn)


def place_on_earth(georeference: Georeference, world: Callable[[Array], Array], turn: Array) -> Array | None:
    """Return the matrix [4, 4] from a metric frame, z up, to geocentric metres; None where the place is unknown.

    From a projected CRS the matrix carries the projection's scale and the convergence of its meridians, too; from
    GPS alone it is a rotation and a translation.

    Args:
        world: points of the frame [N, 3] -> coordinates of the georeference's CRS.
        turn: axes of the frame -> axes of the georeference's local frame, [3, 3].

    Raises:
        BadInput: there is a CRS, and pyproj is not installed.
    """
    if georeference.crs is not None:
        ends = np.concatenate([np.zeros((1, 3)), ARM * np.eye(3), -ARM * np.eye(3)])
        places = ProjectedCrs(georeference.crs).places(world(ends))
        if not np.isfinite(places).all():
            return None
        at = _geocentric(places)
        return _matrix((at[1:4] - at[4:7]).T / (2 * ARM), at[0])
    if georeference.origin is None or not (georeference.metric and georeference.north_known):
        return None
    latitude, longitude, _ = np.radians(georeference.origin)
    (sp, cp), (sl, cl) = (np.sin(latitude), np.cos(latitude)), (np.sin(longitude), np.cos(longitude))
    axes = np.array([[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [0.0, cp, sp]])  # east, north, up
    return _matrix(axes @ turn.T, _geocentric(np.array([georeference.origin]))[0])


def _geocentric(places: Array) -> Array:
    """Convert latitude and longitude in degrees and height [N, 3] to geocentric coordinates [N, 3]."""
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    return np.asarray(transform.ellipsoid_to_ecef(places))


def _matrix(axes: Array, origin: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, origin
    return matrix
