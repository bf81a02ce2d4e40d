# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean the level set: remove what no photo shows and what the masks show as background, make it a manifold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry import clean
from mgf_engine.mesh.component_filter import confirmed_parts
from mgf_engine.mesh.face_visibility import count_pixels
from mgf_engine.mesh.ground_pixels import ground_pixels
from mgf_engine.mesh.holes import fill_holes
from mgf_engine.mesh.isosurface import FREE
from mgf_engine.mesh.mask_votes import cut_background
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.planar_clustering import merge_flat
from mgf_engine.mesh.surface_field import SurfaceField
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.mesh.unobserved_volumes import drop_unobserved
from mgf_engine.model.mesh import Mesh

#: Vertex attribute, bool [N]: vertices of small parts that the photos confirm.
_SMALL_PART = "small_part"


def clean_level_set(
    mesh: Mesh,
    field: SurfaceField,
    trusted: TrustedViews,
    options: ExtractionOptions,
) -> Mesh:
    """Remove false parts of the level set, orient it outward, close small holes, and smooth it.

    Args:
        mesh: the level set.
        field: the field that it was extracted from.
        trusted: photos and masks.
        options: which steps to take, and how.

    Raises:
        BadInput: nothing is left.
    """
    mesh = clean.weld(clean.with_faces(mesh, mesh.faces))
    if options.merge_flat:
        mesh = merge_flat(mesh, trusted.views, options.clustering)
    if options.drop_unseen:
        mesh = _drop_unseen(mesh, field, trusted, options)
    mesh = drop_unconfirmed_parts(mesh, field, options)
    mesh = _cut_background(clean.split_nonmanifold(mesh), field, trusted, options)
    if len(mesh.faces) == 0:
        raise BadInput("Cleaning left no faces; lower min_component or check the masks.")
    if options.fill_holes:
        size = ground_pixels(mesh, trusted.views)
        mesh = fill_holes(mesh, options.small_hole * size, lambda points: field.classify(points) == FREE)
    return clean.smooth(mesh, options.smoothing)


def drop_unconfirmed_parts(mesh: Mesh, field: SurfaceField, options: ExtractionOptions) -> Mesh:
    """Remove the parts of a mesh that are small and that no photos confirm.

    Args:
        mesh: normalised frame.
        field: its confidence tells what photos confirm.
        options: which parts are small, and which are confirmed.
    """
    large = clean.large_parts(mesh, options.min_component)
    return clean.with_faces(mesh, mesh.faces[large | _find_confirmed(mesh, ~large, field, options)])


def _drop_unseen(mesh: Mesh, field: SurfaceField, trusted: TrustedViews, options: ExtractionOptions) -> Mesh:
    """Remove volumes and large patches that no photo shows."""
    mesh = replace(mesh, values=field.observations(mesh.vertices))
    if "confidence" in mesh.values:
        confirmed = mesh.values["confidence"] >= options.fill.unconfirmed
        size = ground_pixels(mesh, trusted.views)
        free = lambda points: field.classify(points) == FREE  # noqa: E731
        mesh = drop_unobserved(mesh, confirmed, size, free, options.volumes)
    return replace(clean.drop_unconfirmed(mesh, mesh.values["confirmed"], options.made_up), values={})


def _cut_background(mesh: Mesh, field: SurfaceField, trusted: TrustedViews, options: ExtractionOptions) -> Mesh:
    """Orient the mesh outward; remove parts that few pixels show, and faces that the masks show as background.

    Small parts that the photos confirm are kept, even if the removal makes them smaller; other small pieces are not.
    """
    labels = trusted.labels if options.use_masks and options.face_votes else None
    counts = count_pixels(mesh, trusted.views, labels)
    mesh = clean.orient_outward(mesh, counts.front, counts.back)
    seen, small = np.ones(len(mesh.faces), bool), np.zeros(len(mesh.vertices), bool)
    if options.drop_unseen:
        seen = clean.seen_parts(mesh, counts.front + counts.back, options.min_component)
        confirmed = _find_confirmed(mesh, ~seen, field, options)
        seen |= confirmed
        small[mesh.faces[confirmed]] = True
    if labels is None:
        return clean.with_faces(mesh, mesh.faces[seen])
    marked = replace(mesh, values={_SMALL_PART: small})
    cut = cut_background(marked, trusted.views, labels, counts, seen, options.votes)
    stays = clean.large_parts(cut, options.min_component) | cut.values[_SMALL_PART][cut.faces].all(1)
    return clean.split_nonmanifold(clean.with_faces(replace(cut, values={}), cut.faces[stays]))


def _find_confirmed(
    mesh: Mesh, asked: NDArray[np.bool_], field: SurfaceField, options: ExtractionOptions
) -> NDArray[np.bool_]:
    """Find those of the faces ``asked`` [F] that are in parts confirmed by the photos, bool [F]."""
    if not options.drop_unseen or "confidence" not in field.observations(mesh.vertices[:1]):
        return np.zeros(len(mesh.faces), bool)
    return confirmed_parts(mesh, asked, lambda points: field.observations(points)["confidence"], options.components)
