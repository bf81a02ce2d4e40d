# SPDX-License-Identifier: GPL-3.0-or-later
"""The photos chosen for the faces of a mesh, with the images themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.model.scene import View
from mgf_engine.scene.exposure import with_gain
from mgf_engine.scene.photos import original_photo
from mgf_engine.texture.model import Source
from mgf_engine.texture.seams import Corrections
from mgf_engine.texture.visibility import ShownFaces, VisibilityOptions


class Originals:
    """The photos as the user took them, in the exposure of the working photos; working photos where they are gone.

    Attributes:
        gone: for each photo that could not be read, why.
    """

    def __init__(self, views: list[View], working: Callable[[int], NDArray[np.uint8]]) -> None:
        self._views, self._working = views, working
        self.gone: list[str] = []

    def __call__(self, index: int) -> Source:
        """Read the photo of a view by its position; the working photo if the original is gone."""
        view = self._views[index]
        try:
            image = original_photo(view)
        except BadInput as error:
            self.gone.append(str(error))
            return Source(self._working(index), False)
        if view.gain != (1.0, 1.0, 1.0):
            image = with_gain(image, view.gain)
        return Source(image, True)


@dataclass(frozen=True)
class Painting:
    """The assignment of photos to faces.

    Attributes:
        chosen: indices in the scene of the views that may paint.
        views: their cameras.
        label: position among ``views`` of the view that paints each face, int32 [F];
            :data:`mgf_engine.texture.model.NO_VIEW` for faces that none shows.
        neighbours: pairs of faces that share an edge, [E, 2].
        patch: of each face: faces of one view that are connected by edges, int32 [F].
        shows: tells of faces and views (positions among ``views``) which a view shows well enough to paint it.
        corrections: of the colours at seams.
        source: position among ``views`` -> the photo to paint with.
        visibility: options that the views were found by.
    """

    chosen: list[int]
    views: list[View]
    label: NDArray[np.int32]
    neighbours: NDArray[np.int64]
    patch: NDArray[np.int32]
    shows: ShownFaces
    corrections: Corrections
    source: Originals
    visibility: VisibilityOptions
