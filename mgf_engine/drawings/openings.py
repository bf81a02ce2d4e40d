# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows, doors and niches of an elevation: where the mesh lies behind the plane of a wall.

They are found by their depth (:mod:`mgf_engine.openings.detection`); the photos then say where between wall and bottom
their edges are, and which have arched heads (:mod:`mgf_engine.openings.locate`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from mgf_engine.drawings.model import Array, Survey
from mgf_engine.drawings.orthophoto import Visibility
from mgf_engine.drawings.photo_lines import PhotoLineOptions, line_photos, plane_frame
from mgf_engine.drawings.project import GridBuffers
from mgf_engine.drawings.regions import RegionMap
from mgf_engine.openings.arches import Proposals
from mgf_engine.openings.detection import Opening, OpeningDetectionOptions, align_edges, openings_in, without_doubles
from mgf_engine.openings.locate import locate_openings
from mgf_engine.openings.photo_edges import EdgePhotos
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.painting import Painting


@dataclass(frozen=True)
class ElevationWallOptions:
    """Options of the walls of an elevation that openings are looked for in."""

    area: float = parameter(0.02, "Minimum area of a wall, as a share of what the drawing shows", high=1)
    facing: float = parameter(0.97, "Smallest cosine between the normals of wall and drawing", high=1)
    openings: OpeningDetectionOptions = OpeningDetectionOptions()


@dataclass(frozen=True)
class ElevationPhotos:
    """The photos that edges of an elevation's openings and planes are looked for in.

    Attributes:
        edges: for openings.
        lines: for planes, with what is beside the mesh.
        survey: converts from the local to the normalised frame.
    """

    edges: EdgePhotos
    lines: EdgePhotos
    survey: Survey


def elevation_photos(
    survey: Survey, painting: Painting, visibility: Visibility, options: PhotoLineOptions = PhotoLineOptions()
) -> ElevationPhotos:
    """Return the photos that paint a survey's orthophotos, at their working size.

    Args:
        survey: mesh and masks of the job.
        painting: the photos.
        visibility: of the mesh in them.
        options: what photos show of the edges of planes.
    """
    edges = EdgePhotos(
        painting.views,
        lambda k: survey.scene.photo(painting.chosen[k]),
        lambda k, points, normal: visibility(k, points, np.broadcast_to(normal, points.shape))[0] > 0,
    )
    return ElevationPhotos(edges, line_photos(survey, painting, options), survey)


class ElevationOpening(NamedTuple):
    """An opening in the map of an elevation.

    Attributes:
        box: left, top (of the crown), right, bottom in pixels of the map, [4].
        rise: of its arched head in these pixels; 0 for a level one.
    """

    box: Array
    rise: float


def find_openings(
    regions: RegionMap,
    seen: GridBuffers,
    pixel: float,
    options: ElevationWallOptions = ElevationWallOptions(),
    photos: ElevationPhotos | None = None,
) -> list[ElevationOpening]:
    """Find the openings of an elevation.

    Args:
        regions: of the elevation, with their planes.
        seen: the mesh at the pixels of the same map.
        pixel: a ground pixel, local unit.
        options: what counts as an opening.
        photos: to take edges from; None leaves them where the mesh has them.
    """
    found, walls, resolution = list[Opening](), list[int](), regions.grid.resolution
    for wall, depth, box, area in _walls(regions, seen, options):
        corner = np.tile([box[1].start, box[0].start], 2)
        for one in openings_in(depth, pixel, resolution, area, options.openings):
            found.append(one._replace(box=one.box + corner))
            walls.append(wall)
    kept, within = without_doubles(found, options.openings.doubled), options.openings.aligned * pixel / resolution
    if not kept:
        return []
    some, own = [found[k] for k in kept], [walls[k] for k in kept]
    boxes = align_edges(np.array([one.box for one in some]), within)
    proposed = Proposals(
        regions.grid.places(boxes.reshape(-1, 2)).reshape(-1, 4), np.array([one.rise * resolution for one in some]),
        np.array([one.level for one in some]), own,
    )  # fmt: skip
    frames = {} if photos is None else {wall: plane_frame(regions, wall, photos.survey) for wall in set(own)}
    edges = None if photos is None else photos.edges
    located = locate_openings(proposed, frames, pixel, edges, options.openings)
    boxes = regions.grid.pixels(located.boxes[located.found].reshape(-1, 2)).reshape(-1, 4)
    rises = located.rises[located.found] / resolution
    return [ElevationOpening(*one) for one in zip(align_edges(boxes, 0.5 * within), rises, strict=True)]


def _walls(
    regions: RegionMap, seen: GridBuffers, options: ElevationWallOptions
) -> Iterator[tuple[int, NDArray[np.float32], tuple[slice, slice], int]]:
    """Yield each wall's label, depth map (behind its plane; NaN where nothing is seen), box in the map, and area."""
    label = np.where(regions.label > len(regions.slope), 0, regions.label)
    shown = int((seen.face >= 0).sum())
    for value, box in enumerate(find_objects(label), start=1):
        area = 0 if box is None else int((label[box] == value).sum())
        if area < options.area * shown or regions.normal(value)[2] < options.facing:
            continue
        rows, columns = np.mgrid[box]
        at = regions.grid.places(np.stack([columns, rows], -1).reshape(-1, 2) + 0.5)
        depth = (regions.before(value, at).reshape(rows.shape) - seen.before[box]).astype(np.float32)
        yield value, depth, box, area
