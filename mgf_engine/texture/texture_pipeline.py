# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the texture of a finished mesh from its job's scene and masks."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.geometry.clean import face_areas, face_neighbours
from mgf_engine.geometry.rasterize import corners
from mgf_engine.mesh.screening import voting_views
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Scene, View
from mgf_engine.texture.bake import bake
from mgf_engine.texture.blending import BlendOptions
from mgf_engine.texture.charts import ChartOptions, lay_out, merge_patches
from mgf_engine.texture.model import NO_VIEW, painting_views
from mgf_engine.texture.painting import Originals, Painting
from mgf_engine.texture.seams import SeamOptions, level_seams
from mgf_engine.texture.view_selection import ViewSelectionOptions, choose_views, patches
from mgf_engine.texture.visibility import ShownFaces, VisibilityOptions, find_face_views

log = logging.getLogger("mgf")

#: Shares for the progress bar: the choice of photos among all, and what finds the visible faces among that.
_CHOICE, _VISIBILITY = 0.5, 0.7


@dataclass(frozen=True)
class TextureOptions:
    """All options of the texture."""

    visibility: VisibilityOptions = VisibilityOptions()
    views: ViewSelectionOptions = ViewSelectionOptions()
    seams: SeamOptions = SeamOptions()
    charts: ChartOptions = ChartOptions()
    blend: BlendOptions = BlendOptions()


def make_texture(
    mesh: Mesh,
    scene: Scene,
    masks: MaskSet,
    largest_side: int,
    warn: Callable[[str], None],
    progress: Callable[[float], None] = lambda share: None,
    options: TextureOptions = TextureOptions(),
) -> Texture:
    """Make a texture from the photos whose masks may be trusted.

    Args:
        mesh: normalised frame, with vertex colours.
        scene: cameras of the photos.
        masks: their label maps.
        largest_side: of the picture, pixels.
        warn: gets a sentence when photos of the user are gone; their working copies are taken instead.
        progress: called with the share of the work done.
        options: of the choice of views, the levelling and the picture.
    """
    painting = choose_painting(mesh, scene, masks, lambda share: progress(_CHOICE * share), options)
    views, label = painting.views, painting.label
    finest = float(np.median([v.original_width / v.width for v in views]))
    uv = _in_views(mesh, label, views)
    chart = merge_patches(uv, label, painting.patch, options.charts)
    layout = lay_out(uv, label, chart, max(1.0, finest), largest_side, options.charts)
    image = bake(
        mesh, layout, painting, lambda share: progress(_CHOICE + (1 - _CHOICE) * share), options.charts, options.blend
    )
    gone = painting.source.gone
    if gone:
        warn(
            f"{len(gone)} of {len(views)} photos cannot be read any more (first: "
            f"{gone[0]}); the texture uses their smaller working copies. Put the photos back and run "
            "again for a sharper texture."
        )
    log.info(
        "texture: %d x %d, %.2f pixels per working pixel, %d photos, %.1f %% of the faces without",
        layout.width, layout.height, layout.scale, len(painting_views(label)), 100 * (label == NO_VIEW).mean(),
    )  # fmt: skip
    u, v = layout.at[..., 0] / layout.width, 1 - layout.at[..., 1] / layout.height
    return Texture(np.stack([u, v], -1).astype(np.float32), image)


def choose_painting(
    mesh: Mesh,
    scene: Scene,
    masks: MaskSet,
    progress: Callable[[float], None] = lambda share: None,
    options: TextureOptions = TextureOptions(),
) -> Painting:
    """Choose the photos that paint a mesh (normalised frame) among those whose masks may be trusted.

    Args:
        mesh: normalised frame, with vertex colours.
        scene: photos and cameras.
        masks: of the photos.
        progress: called with the share that is done, 0..1.
        options: of visibility, choice and seams.
    """
    chosen = voting_views(scene, masks)
    views = [scene.views[i] for i in chosen]

    def photo(i: int) -> NDArray[np.uint8]:
        return scene.photo(chosen[i])

    face_views = find_face_views(
        mesh,
        views,
        photo,
        lambda i: building(masks.labels[chosen[i]]),
        lambda share: progress(_VISIBILITY * share),
        options.visibility,
    )
    neighbours = face_neighbours(mesh.faces)
    label = choose_views(face_views, neighbours, face_areas(mesh), options.views, options.visibility.least_size)
    progress(_VISIBILITY)
    corrections = level_seams(mesh, label, neighbours, views, photo, options.seams)
    progress(1.0)
    originals = Originals(views, photo)
    shows = ShownFaces(face_views.face, face_views.view)
    patch = patches(label, neighbours)
    return Painting(chosen, views, label, neighbours, patch, shows, corrections, originals, options.visibility)


def _in_views(mesh: Mesh, label: NDArray[np.int32], views: list[View]) -> NDArray[np.float64]:
    """Project the corners of each face into pixels of the view that paints it, [F, 3, 2]; zeros for faces without
    one."""
    result = np.zeros((len(label), 3, 2))
    for index in painting_views(label):
        rows = np.flatnonzero(label == index)
        result[rows] = corners(mesh.vertices[mesh.faces[rows].ravel()], views[index])[:, :2].reshape(-1, 3, 2)
    return result
