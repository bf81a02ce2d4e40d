# SPDX-License-Identifier: GPL-3.0-or-later
"""The level set: the surface between solid and free corners of tetrahedra, and what cleans it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry import clean
from mgf_engine.mesh.component_filter import confirmed_parts
from mgf_engine.mesh.decimate import ground_pixels
from mgf_engine.mesh.face_visibility import count_pixels
from mgf_engine.mesh.holes import fill_holes
from mgf_engine.mesh.isosurface import FREE, Crossing, find_level, march
from mgf_engine.mesh.mask_votes import cut_background
from mgf_engine.mesh.opacity import OpacityField
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.planar_clustering import merge_flat
from mgf_engine.mesh.tetra_blocks import TetraBlocks, join_blocks
from mgf_engine.mesh.tetrahedra import TetraPoints
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.mesh.tsdf import TsdfField
from mgf_engine.mesh.unobserved_volumes import drop_unobserved
from mgf_engine.model.mesh import Mesh
from mgf_engine.timing import PartTimes


@dataclass(frozen=True)
class Reporting:
    """Who is told how far the level set is.

    Attributes:
        progress: called with the share of its vertices that are placed, 0..1.
        began: called with the number of each block before.
        times: records what tetrahedra and level set take.
    """

    progress: Callable[[float], None] = lambda share: None
    began: Callable[[int], None] = lambda number: None
    times: PartTimes = dataclass_field(default_factory=PartTimes)


def extract_level_set(
    blocks: TetraBlocks,
    make_tetrahedra: Callable[[int], NDArray[np.int32]],
    field: OpacityField | TsdfField,
    steps: int,
    reporting: Reporting = Reporting(),
    thin: Callable[[Mesh], Mesh] = lambda mesh: mesh,
) -> Mesh:
    """Extract the raw surface O(x) = level, between solid and free corners of the tetrahedra.

    Args:
        blocks: points of the tetrahedra.
        make_tetrahedra: makes the tetrahedra of a block by its number, [T, 4].
        field: tells solid from free.
        steps: of the search for the level on each edge.
        reporting: is told of blocks and progress.
        thin: takes vertices out of the mesh of a block, those on its borders excepted, where there are several.

    Raises:
        BadInput: there is no surface: everything is free, solid or unseen.
    """
    count, crossed, times = len(blocks.members), list[int](), reporting.times
    with times.part("tetrahedra"):
        state = field.classify(blocks.spanned.points)

    def mesh_of(number: int) -> Mesh:
        def report(share: float) -> None:
            reporting.progress((number + share) / count)

        with times.part("tetrahedra"):
            crossing = march(make_tetrahedra(number), state, blocks.spanned.points)
            crossed.append(len(crossing.faces))
        with times.part("level set"):
            mesh = _place(blocks.spanned, crossing, field, steps, report)
            return mesh if count < 2 else thin(clean.weld(clean.with_faces(mesh, mesh.faces)))

    mesh = mesh_of(0) if count < 2 else join_blocks(blocks, state, mesh_of, reporting.began)
    if len(mesh.faces) == 0 and not any(crossed):
        raise BadInput("The field has no surface inside the masks; train longer, or check the masks and the cameras.")
    return mesh


def _place(
    spanned: TetraPoints,
    crossing: Crossing,
    field: OpacityField | TsdfField,
    steps: int,
    progress: Callable[[float], None],
) -> Mesh:
    """Place a vertex on each crossing edge; faces with an overlong one are left out."""
    kept = crossing.faces[~_overlong(spanned, crossing.edges)[crossing.faces].any(1)]
    solid, free = (spanned.points[crossing.edges[:, k]] for k in range(2))

    def signed(points: NDArray[np.float64], share: float) -> NDArray[np.float32]:
        return field.signed(points, lambda step: progress(share + step / max(steps, 1)))

    vertices = find_level(solid, free, signed, steps)
    return Mesh(vertices, kept, np.zeros((len(vertices), 3), np.uint8))


def _overlong(spanned: TetraPoints, edges: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return edges longer than the extents of both their Gaussians together: nothing is known along them, bool [E]."""
    length = np.linalg.norm(spanned.points[edges[:, 0]] - spanned.points[edges[:, 1]], axis=1)
    too_long: NDArray[np.bool_] = length > spanned.extent[edges].sum(1)
    return too_long


def clean_level_set(
    mesh: Mesh,
    field: OpacityField | TsdfField,
    trusted: TrustedViews,
    options: ExtractionOptions,
) -> Mesh:
    """Clean the level set: remove false parts, orient it outward, close small holes, smooth it.

    Args:
        mesh: the level set.
        field: that it was extracted from.
        trusted: photos and masks.
        options: which steps to take, and how.

    Raises:
        BadInput: nothing is left.
    """
    views, labels = trusted.views, trusted.labels if options.use_masks and options.face_votes else None
    mesh = clean.weld(clean.with_faces(mesh, mesh.faces))
    if options.merge_flat:
        mesh = merge_flat(mesh, views, options.clustering)
    free = lambda points: field.classify(points) == FREE  # noqa: E731
    if options.drop_unseen:
        mesh = replace(mesh, values=field.known(mesh.vertices))
        if "confidence" in mesh.values:
            confirmed = mesh.values["confidence"] >= options.fill.unconfirmed
            mesh = drop_unobserved(mesh, confirmed, ground_pixels(mesh, views), free, options.volumes)
        mesh = replace(clean.drop_unconfirmed(mesh, mesh.values["confirmed"], options.made_up), values={})
    large = clean.large_parts(mesh, options.min_component)
    mesh = clean.with_faces(mesh, mesh.faces[large | _confirmed(mesh, ~large, field, options)])
    mesh = clean.split_nonmanifold(mesh)
    counts = count_pixels(mesh, views, labels)
    mesh = clean.orient_outward(mesh, counts.front, counts.back)
    seen = np.ones(len(mesh.faces), bool)
    small = np.zeros(len(mesh.vertices), bool)
    if options.drop_unseen:
        seen = clean.seen_parts(mesh, counts.front + counts.back, options.min_component)
        confirmed = _confirmed(mesh, ~seen, field, options)
        seen |= confirmed
        small[mesh.faces[confirmed]] = True
    if labels is None:
        mesh = clean.with_faces(mesh, mesh.faces[seen])
    else:
        mesh = cut_background(replace(mesh, values={"small": small}), views, labels, counts, seen, options.votes)
        stays = clean.large_parts(mesh, options.min_component) | mesh.values["small"][mesh.faces].all(1)
        mesh = clean.split_nonmanifold(clean.with_faces(replace(mesh, values={}), mesh.faces[stays]))
    if len(mesh.faces) == 0:
        raise BadInput("Cleaning left no faces; lower min_component or check the masks.")
    if options.fill_holes:
        mesh = fill_holes(mesh, options.small_hole * ground_pixels(mesh, views), free)
    return clean.smooth(mesh, options.smoothing)


def _confirmed(
    mesh: Mesh, asked: NDArray[np.bool_], field: OpacityField | TsdfField, options: ExtractionOptions
) -> NDArray[np.bool_]:
    """Find the faces, of those asked for, in parts that photos confirm, bool [F]; none where photos are not asked."""
    if not options.drop_unseen or "confidence" not in field.known(mesh.vertices[:1]):
        return np.zeros(len(mesh.faces), bool)
    return confirmed_parts(mesh, asked, lambda points: field.known(points)["confidence"], options.components)
