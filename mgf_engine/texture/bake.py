# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake the texture: look up each texel in the original photo that is chosen for its face."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import draw_triangles
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.pixels import sample_pixels
from mgf_engine.model.scene import View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.scene.cameras import to_original
from mgf_engine.scene.photos import PhotoMemory
from mgf_engine.texture.blending import Bands, BlendOptions, find_bands
from mgf_engine.texture.charts import ChartOptions
from mgf_engine.texture.model import NO_VIEW, Layout, Source
from mgf_engine.texture.painting import Painting

Array = NDArray[Any]
Faces = NDArray[np.int32]
Weights = NDArray[np.float64]
CHUNK = 1 << 18  # pixels looked up together, which bounds the memory: each takes some 300 bytes meanwhile


def bake(
    mesh: Mesh,
    layout: Layout,
    painting: Painting,
    progress: Callable[[float], None] = lambda share: None,
    options: ChartOptions = ChartOptions(),
    blend: BlendOptions = BlendOptions(),
) -> NDArray[np.uint8]:
    """Paint the picture, RGB uint8 [H, W, 3].

    Args:
        mesh: normalised frame.
        layout: place of each face in the picture.
        painting: which photo paints which face, and the photos.
        progress: called with the share that is done.
        options: of the layout.
        blend: of blending at seams.
    """
    label = painting.label
    face = draw_triangles(layout.at, layout.height, layout.width)
    pixel = np.flatnonzero(face >= 0)
    bands = find_bands(layout, painting, mesh.faces, face, blend)
    own, mixed = _groups(label[face.ravel()[pixel]], len(painting.views)), _groups(bands.view, len(painting.views))
    kinds = [k for k in range(len(own)) if len(own[k]) or len(mixed[k])]
    image = np.zeros((layout.height * layout.width, 3), np.uint8)
    second = np.zeros((len(bands.pixel), 3), np.uint8)
    painter = _Painter(mesh, layout, painting, face)
    colors = parallel_map(lambda k: painter.paint(k - 1, pixel[own[k]], bands, mixed[k]), kinds)
    for done, (k, (first, other)) in enumerate(zip(kinds, colors, strict=True)):
        progress(done / len(kinds))
        image[pixel[own[k]]], second[mixed[k]] = first, other
    share = bands.share[:, None]
    image[bands.pixel] = np.rint(image[bands.pixel] * (1 - share) + second * share)
    return fill_gutters(image.reshape(layout.height, layout.width, 3), face >= 0, 2 * options.gutter)


def _groups(view: NDArray[np.int32], count: int) -> list[NDArray[np.int64]]:
    """Return the positions of each value from :data:`NO_VIEW` to ``count - 1``."""
    order = np.argsort(view, kind="stable")
    return np.split(order, np.searchsorted(view[order], np.arange(NO_VIEW + 1, count)))


class _Painter:
    """Colours pixels of the picture from a photo, or from the mesh where no photo shows the face.

    Args:
        mesh: normalised frame.
        layout: place of each face in the picture.
        painting: which photo paints which face, and the photos.
        face: of each pixel of the picture, -1 for none, [H, W].
    """

    def __init__(self, mesh: Mesh, layout: Layout, painting: Painting, face: NDArray[np.int32]) -> None:
        self.mesh, self.layout, self.painting, self.face = mesh, layout, painting, face.ravel()
        self._memory = PhotoMemory()

    def paint(
        self, index: int, pixels: NDArray[np.int64], bands: Bands, mixed: NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Return colours from the photo of view ``index``, or of the vertices for :data:`NO_VIEW`.

        Args:
            index: position among the views.
            pixels: pixels of its own [N] (y * width + x).
            bands: pixels that second photos are mixed into.
            mixed: those of them, [M], that this one is mixed into.

        Returns:
            Colours of ``pixels`` [N, 3], and of the bands' pixels [M, 3].
        """
        if index == NO_VIEW:
            own = self._in_chunks(pixels, lambda faces, weight: self._blend(self.mesh.colors, faces, weight))
            return own, np.zeros((0, 3), np.uint8)
        view = self.painting.views[index]
        with self._memory.reserve(view.original_width, view.original_height):
            photo = reduce_photo(view, self.painting.source(index), self.layout.scale)

            def look_up(faces: Faces, weight: Weights) -> Array:
                return sample_photo(view, photo, self._blend(self.mesh.vertices, faces, weight))

            own = self._in_chunks(pixels, look_up)
            return own, self._in_chunks(bands.pixel[mixed], look_up, bands.correction[mixed])

    def _in_chunks(
        self,
        pixels: NDArray[np.int64],
        colors: Callable[[Faces, Weights], Array],
        given: NDArray[np.float32] | None = None,
    ) -> NDArray[np.uint8]:
        """Colour pixels by their faces [n] and their weights between the corners [n, 3, 1], and level the seams.

        Args:
            pixels: [N].
            colors: of faces and weights.
            given: corrections of the pixels, [N, 3]; those of the faces' corners without.
        """
        corrections, found = self.painting.corrections, np.empty((len(pixels), 3), np.uint8)
        for first in range(0, len(pixels), CHUNK):
            chunk = slice(first, first + CHUNK)
            faces = self.face[pixels[chunk]]
            at = np.stack([pixels[chunk] % self.layout.width, pixels[chunk] // self.layout.width], 1) + 0.5
            weight = barycentric(self.layout.at[faces], at)[..., None]
            add = (corrections.value[corrections.of_corner[faces]] * weight).sum(1) if given is None else given[chunk]
            found[chunk] = np.clip(np.rint(colors(faces, weight) + add), 0, 255).astype(np.uint8)
        return found

    def _blend(self, values: Array, faces: Faces, weight: Weights) -> NDArray[np.float64]:
        """Interpolate values of the vertices [V, 3] on faces [n], [n, 3]."""
        return np.asarray((values[self.mesh.faces[faces]] * weight).sum(1), np.float64)


def barycentric(triangle: NDArray[np.float64], at: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return weights [n, 3] of the corners of triangles [n, 3, 2] at points [n, 2] inside."""
    first, second, off = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0], at - triangle[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    b = (off[:, 0] * second[:, 1] - off[:, 1] * second[:, 0]) / area
    c = (first[:, 0] * off[:, 1] - first[:, 1] * off[:, 0]) / area
    return np.stack([1 - b - c, b, c], 1)


def sample_reduced_photo(view: View, source: Source, points: NDArray[np.float64], scale: float) -> NDArray[np.uint8]:
    """Look up the photo of a view at points [n, 3]; RGB uint8 [n, 3].

    Args:
        view: camera of the photo.
        source: reads its photo.
        points: [n, 3], normalised frame.
        scale: pixels wanted per pixel of the working photo; a photo that has more is made smaller first.
    """
    return sample_photo(view, reduce_photo(view, source, scale), points)


def reduce_photo(view: View, source: Source, scale: float) -> Source:
    """Return the photo of a view with at most ``scale`` pixels per pixel of the working photo."""
    height, width = source.image.shape[:2]
    shrink = min(1.0, scale * view.width / width)
    if shrink == 1.0:
        return source
    size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
    return replace(source, image=np.asarray(cv2.resize(source.image, size, interpolation=cv2.INTER_AREA), np.uint8))


def sample_photo(view: View, source: Source, points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return colours of a photo, of whatever size, at points [n, 3] in its view; RGB uint8 [n, 3]."""
    at, size = view.project(points)[0], (view.width, view.height)
    if source.original:
        at, size = to_original(view, at), (view.original_width, view.original_height)
    height, width = source.image.shape[:2]
    if (width, height) != size:
        at = at * (width / size[0], height / size[1])
    return sample_pixels(source.image, at, cv2.INTER_CUBIC)


def fill_gutters(image: NDArray[np.uint8], painted: NDArray[np.bool_], width: int) -> NDArray[np.uint8]:
    """Give pixels up to ``width`` px beside the patches the nearest patch's colour, which mipmaps mix in."""
    if not painted.any():
        return image
    distance, nearest = cv2.distanceTransformWithLabels(
        (~painted).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    source = np.zeros(int(nearest.max()) + 1, np.int64)
    source[nearest[painted]] = np.flatnonzero(painted)
    near, flat = distance <= width, image.reshape(-1, 3)
    beside = np.flatnonzero(near & ~painted)
    mean = cv2.mean(image, painted.astype(np.uint8))[:3]
    flat[beside] = flat[source[nearest.ravel()[beside]]]
    np.copyto(image, np.array(mean, np.uint8), where=~near[..., None])
    return image
