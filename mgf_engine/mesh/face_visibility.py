# SPDX-License-Identifier: GPL-3.0-or-later
"""Count the pixels of all views that see each face of a mesh: from which side, and inside which label."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.rasterize import corners, seen_faces
from mgf_engine.mesh.face_clusters import CLUSTER_SIZE, FaceClusters
from mgf_engine.model.masks import IGNORE
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import View
from mgf_engine.native.library import call
from mgf_engine.native.parallel import parallel_map

Counts = NDArray[np.int32]
Labels = Sequence[NDArray[np.uint8]]


@dataclass(frozen=True)
class FaceImage:
    """The face visible at each pixel of a view; only pixels that show one are stored.

    Attributes:
        shape: (H, W).
        seen: bit mask of the pixels that show a face.
        faces: their faces, int32 [P].
    """

    shape: tuple[int, int]
    seen: NDArray[np.uint8]
    faces: NDArray[np.int32]

    @classmethod
    def of(cls, face: NDArray[np.int32]) -> FaceImage:
        """Pack an image of face indices, int32 [H, W], -1 for none."""
        seen = face >= 0
        return cls((face.shape[0], face.shape[1]), np.packbits(seen), face[seen])

    def unpacked(self) -> NDArray[np.int32]:
        """Return the image of face indices, int32 [H, W], -1 for none."""
        face = np.full(self.shape, -1, np.int32)
        face.ravel()[np.unpackbits(self.seen, count=face.size).view(bool)] = self.faces
        return face


@dataclass(frozen=True)
class PixelCounts:
    """Pixels that see each face, [F] each.

    Attributes:
        front, back: from outside (counter-clockwise corners), and from inside.
        inside: that the masks call building.
        known: about which the masks say anything.
        face_images: which face each of them sees, of each view.
    """

    front: Counts
    back: Counts
    inside: Counts
    known: Counts
    face_images: Sequence[FaceImage]


def count_pixels(mesh: Mesh, views: Sequence[View], labels: Labels | None = None) -> PixelCounts:
    """Draw the mesh into every view and count the pixels of each face.

    Args:
        views: normalised frame.
        labels: label map of each view, uint8 [H, W]; None: nothing is known.
    """

    def show(number: int, at: NDArray[np.float64]) -> tuple[NDArray[np.int32], FaceImage]:
        face = seen_faces(mesh.faces, views[number], at)
        return face, FaceImage.of(face)

    return _count(mesh, views, labels, show)


def count_uncovered(
    mesh: Mesh, left: NDArray[np.bool_], counts: PixelCounts, views: Sequence[View], labels: Labels | None = None
) -> PixelCounts:
    """Count as :func:`count_pixels` once some faces are gone; draws only where one of the others was seen.

    Args:
        mesh: normalised frame.
        left: bool [F], at least one face. What is counted of the others has no meaning.
        counts: of all faces, or of more than are left.
        views: cameras of the photos.
        labels: as :func:`count_pixels` takes them.
    """
    clusters, number_of = FaceClusters.of(mesh.vertices, mesh.faces[left]), np.flatnonzero(left)
    stays = np.append(left, True)  # the last for pixels that see none

    def show(number: int, at: NDArray[np.float64]) -> tuple[NDArray[np.int32], FaceImage]:
        face = counts.face_images[number].unpacked()
        lost = ~stays[face]
        near = clusters.touching(views[number], lost)
        drawn = seen_faces(clusters.faces[near].reshape(-1, 3), views[number], at)
        shown = lost & (drawn >= 0)
        cluster, place = np.divmod(drawn[shown], CLUSTER_SIZE)
        behind = np.full_like(face, -1)
        behind[shown] = number_of[near[cluster] * CLUSTER_SIZE + place]
        return behind, FaceImage.of(np.where(lost, behind, face))

    more = _count(mesh, views, labels, show)
    return replace(
        more,
        front=counts.front + more.front,
        back=counts.back + more.back,
        inside=counts.inside + more.inside,
        known=counts.known + more.known,
    )


def _count(
    mesh: Mesh,
    views: Sequence[View],
    labels: Labels | None,
    show: Callable[[int, NDArray[np.float64]], tuple[NDArray[np.int32], FaceImage]],
) -> PixelCounts:
    """Return the face images, and how many pixels see each face.

    Args:
        show: (number of a view, corners of the mesh there) -> face that each pixel to be counted sees, int32 [H, W],
            -1 for none, and the picture.
    """
    counts = np.zeros((len(mesh.faces), 4), np.int32)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int32)

    def add(number: int) -> FaceImage:
        at = corners(mesh.vertices, views[number])
        face, picture = show(number, at)
        label = None if labels is None else np.ascontiguousarray(labels[number])
        call("mgf_count_pixels", face.size, face, at, faces, label, IGNORE, counts)
        return picture

    face_images = list(parallel_map(add, range(len(views))))
    front, back, inside, known = (np.ascontiguousarray(column) for column in counts.T)
    return PixelCounts(front, back, inside, known, face_images)
