# SPDX-License-Identifier: GPL-3.0-or-later
"""The texture of a level of detail: charts of its own by xatlas, each pixel looked up on the full mesh.

A coarse face lies over many patches of the full texture, so texture coordinates cannot be carried over. The picture
is painted anew instead: each of its pixels is a point of the coarse mesh and takes the colour of the nearest point of
the full one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.geometry.rasterize import draw_triangles
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.pixels import sample_pixels
from mgf_engine.options.algorithms import parameter
from mgf_engine.texture.bake import barycentric, fill_gutters
from mgf_engine.texture.charts import JPEG_UNIT

CHUNK_FACES = 5000  # for which charts are made together
AT_ONCE = 500_000  # pixels looked up together

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AtlasOptions:
    """Options of the textures of levels of detail."""

    least_side: int = parameter(256, "Minimum width of a texture", "px", low=16)
    padding: int = parameter(3, "Distance between charts", "px")
    shrink: float = parameter(4.0, "Largest factor by which the full texture is reduced before it is looked up", low=1)


def transfer_texture(
    coarse: Mesh,
    full: Mesh,
    texture: Texture,
    side: int,
    progress: Callable[[float], None] = lambda share: None,
    options: AtlasOptions = AtlasOptions(),
) -> Texture:
    """Return the texture of a coarse mesh, from that of the full mesh in the same frame.

    Args:
        coarse: mesh that gets the texture.
        full: mesh that has it.
        texture: of the full mesh.
        side: of the picture, pixels; at least the options' ``least_side`` is taken.
        progress: called with the share of the work done.
        options: charts and sizes.
    """
    side = max(options.least_side, side)
    uv, height = _charts(coarse, side, options)
    at = uv * (side, height)
    face = draw_triangles(at, height, side)
    rows, columns = np.nonzero(face >= 0)
    image = np.zeros((height, side, 3), np.uint8)
    texture = _shrunk(texture, len(rows), options)
    surface = Surface(full.vertices, full.faces.astype(np.int64))
    for first in range(0, len(rows), AT_ONCE):
        progress(first / len(rows))
        row, column = rows[first : first + AT_ONCE], columns[first : first + AT_ONCE]
        owner = face[row, column]
        weight = barycentric(at[owner], np.stack([column, row], 1) + 0.5)
        points = (coarse.vertices[coarse.faces[owner]] * weight[..., None]).sum(1)
        image[row, column] = _colors(points, surface, texture)
    image = fill_gutters(image, face >= 0, 2 * options.padding)
    return Texture(np.stack([uv[..., 0], 1 - uv[..., 1]], -1).astype(np.float32), image)


def _charts(mesh: Mesh, side: int, options: AtlasOptions) -> tuple[Array, int]:
    """Return the places of the faces' corners in a picture of this width, 0..1 from the top left, [F, 3, 2], and its
    height."""
    import xatlas

    atlas, chunks = xatlas.Atlas(), _chunks(mesh.vertices[mesh.faces].mean(1))
    local = (mesh.vertices - mesh.vertices.mean(0)).astype(np.float32)
    for rows in chunks:
        used, index = np.unique(mesh.faces[rows], return_inverse=True)
        atlas.add_mesh(local[used], index.reshape(-1, 3).astype(np.uint32))
    charts, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    charts.max_iterations = 1
    packing.padding, packing.resolution, packing.bilinear = options.padding, side, True
    atlas.generate(charts, packing)
    height = max(JPEG_UNIT, JPEG_UNIT * round(side * atlas.height / max(atlas.width, 1) / JPEG_UNIT))
    places = np.empty((len(mesh.faces), 3, 2))
    for number, rows in enumerate(chunks):
        _, corners, uv = atlas.get_mesh(number)
        places[rows] = uv[corners]
    return places, int(height)


def _chunks(middles: Array) -> list[NDArray[np.int64]]:
    """Return the rows of faces in chunks of at most :data:`CHUNK_FACES` that lie together: xatlas gets slow with
    many."""
    left, chunks = [np.arange(len(middles))], list[NDArray[np.int64]]()
    while left:
        rows = left.pop()
        if len(rows) <= CHUNK_FACES:
            chunks.append(rows)
            continue
        axis = int(np.ptp(middles[rows], axis=0).argmax())
        order = rows[np.argsort(middles[rows, axis], kind="stable")]
        left += [order[: len(order) // 2], order[len(order) // 2 :]]
    return chunks


def _shrunk(texture: Texture, pixels: int, options: AtlasOptions) -> Texture:
    """Return the texture with about as many painted pixels as asked for, at most ``shrink`` times smaller each way.

    Else a coarse picture would pick single pixels of the fine one, which flickers.
    """
    height, width = texture.image.shape[:2]
    first, second = texture.uv[:, 1] - texture.uv[:, 0], texture.uv[:, 2] - texture.uv[:, 0]
    painted = 0.5 * float(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum()) * width * height
    shrink = min(options.shrink, float(np.sqrt(painted / max(pixels, 1))))
    if shrink <= 1:
        return texture
    size = max(1, round(width / shrink)), max(1, round(height / shrink))
    return Texture(texture.uv, np.asarray(cv2.resize(texture.image, size, interpolation=cv2.INTER_AREA), np.uint8))


def _colors(points: Array, surface: Surface, texture: Texture) -> NDArray[np.uint8]:
    """Look up the texture of a surface at its points nearest to points [n, 3], RGB uint8 [n, 3]."""
    _, face, spot = surface.closest(points)
    return colors_at(spot, face, surface, texture)


def colors_at(spot: Array, face: NDArray[np.integer], surface: Surface, texture: Texture) -> NDArray[np.uint8]:
    """Look up the texture of a surface at points on it, RGB uint8 [n, 3].

    Args:
        spot: the points, [n, 3].
        face: which face each lies on, [n].
        surface: the mesh.
        texture: of the mesh.
    """
    a, b, c = (surface.vertices[surface.faces[face, k]] for k in range(3))
    first, second, off = b - a, c - a, spot - a
    normal = np.cross(first, second)
    double = np.maximum((normal**2).sum(1), 1e-300)
    v = (np.cross(off, second) * normal).sum(1) / double
    w = (np.cross(first, off) * normal).sum(1) / double
    weight = np.clip(np.stack([1 - v - w, v, w], 1), 0, 1)
    at = (texture.uv[face] * weight[..., None]).sum(1)
    height, width = texture.image.shape[:2]
    return sample_pixels(texture.image, np.stack([at[:, 0] * width, (1 - at[:, 1]) * height], 1), cv2.INTER_LINEAR)
