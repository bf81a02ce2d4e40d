# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the steps of the mesh stage (section 3.3 of the paper), from the trained field to the coloured mesh."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.geometry import clean
from mgf_engine.geometry.clip import clip
from mgf_engine.geometry.normals import vertex_normals
from mgf_engine.mesh.border_smoothing import smooth_border, trim_border
from mgf_engine.mesh.colors import ColorOptions, color_from_photos
from mgf_engine.mesh.component_filter import ComponentFilterOptions, faces_near_clicks
from mgf_engine.mesh.cut_openings import cut_openings
from mgf_engine.mesh.decimate import reduce_faces
from mgf_engine.mesh.extend_planes import ON_PLANE, extend_planes
from mgf_engine.mesh.find_trusted_views import find_trusted_views
from mgf_engine.mesh.ground_pixels import ground_pixels
from mgf_engine.mesh.holes import cap_rims
from mgf_engine.mesh.level_set_cleaning import clean_level_set, drop_unconfirmed_parts
from mgf_engine.mesh.low_confidence_fill import fill_low_confidence
from mgf_engine.mesh.opacity import OpacityField
from mgf_engine.mesh.options import ExtractionOptions
from mgf_engine.mesh.photo_consistency import see_vertices
from mgf_engine.mesh.planar import flatten_planes
from mgf_engine.mesh.plane_borders import fade_moves
from mgf_engine.mesh.plane_detection import Plane, Planes
from mgf_engine.mesh.raw_surface import RAW_SURFACE_DONE, SurfaceInputs, raw_surface, timed_part
from mgf_engine.mesh.refine import RefinementOptions, project_onto_surface, refine
from mgf_engine.mesh.relief import Relief
from mgf_engine.mesh.screening import screen
from mgf_engine.mesh.surface_field import SurfaceField
from mgf_engine.mesh.trusted_views import TrustedViews
from mgf_engine.mesh.wall_openings import edge_photos, find_wall_openings
from mgf_engine.messages import Reporter
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.model.masks import MaskSet, building
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Scene, View
from mgf_engine.scene.crop import CropBox, crop_of
from mgf_engine.scene.gravity import find_up
from mgf_engine.start.surface import StartSurface
from mgf_engine.system.timing import PartTimes

log = logging.getLogger("mgf")

#: Progress of the stage (0..1) after cleaning, refinement and colours.
_CLEANED, _REFINED, _COLORED = 0.6, 0.75, 0.8


def extract_mesh(
    gaussians: Gaussians,
    scene: Scene,
    masks: MaskSet,
    options: ExtractionOptions,
    reporter: Reporter,
    times: PartTimes | None = None,
    start: StartSurface | None = None,
) -> Mesh:
    """Extract the building's surface as a coloured triangle mesh in the normalised frame.

    Args:
        gaussians: the trained field.
        scene: photos, cameras and sparse points.
        masks: label maps of the photos.
        options: of all steps.
        reporter: for progress, warnings and the request to cancel.
        times: records the time of each step.
        start: the starting surface of the training, used where photos cannot be matched (``surface=fused`` only).

    Raises:
        BadInput: no surface is left; the message names the step.
        Cancelled: the user asked to stop.
    """
    times = times or PartTimes()

    def part(name: str) -> AbstractContextManager[None]:
        reporter.check()
        return timed_part(times, name)

    trusted = find_trusted_views(scene, masks, options)
    reporter.progress(0.0)
    box = crop_of(options.crop_box, scene)
    with part("points"):
        kept = screen(gaussians, scene, masks, options.screening, reporter.warning)
    start = start if trusted.photos is not None else None
    reporter.check()
    mesh, field = raw_surface(kept, SurfaceInputs(scene, masks, trusted, start, box), options, reporter, times)
    reporter.progress(RAW_SURFACE_DONE, faces=len(mesh.faces))
    with part("cleaning"):
        merged = options.blocks > 1  # then flat areas have been merged in each block
        mesh = clean_level_set(mesh, field, trusted, replace(options, merge_flat=options.merge_flat and not merged))
        if options.drop_unseen:
            mesh = keep_clicked_parts(mesh, scene, masks, reporter, options.components)
    reporter.progress(_CLEANED, faces=len(mesh.faces))
    with part("refinement"):
        mesh = refine_mesh(move_onto_depth_maps(mesh, field, trusted, options), trusted, options, reporter)
    if options.flatten:
        with part("planes"):
            flat = flatten_mesh(mesh, trusted, options, reporter.check, known_planes(start))
            mesh = flat.mesh
        if options.openings:
            with part("openings"):
                up = None if masks.up is None else masks.up.vector
                mesh = cut_wall_openings(flat, scene, trusted, options, up, reporter.check)
    if options.drop_unseen:
        with part("borders"):
            mesh = trim_mesh(mesh, field, trusted, options)
    with part("colours"):
        mesh = color_mesh(crop_mesh(mesh, options.close_bottom, box), scene, trusted, options.colors, reporter)
    log.info("mesh: %d of %d Gaussians, %d faces", len(kept), len(gaussians), len(mesh.faces))
    with part("reduction"):
        return finish_mesh(simplify_mesh(mesh, trusted.views, options, reporter), field, options)


def move_onto_depth_maps(mesh: Mesh, field: SurfaceField, trusted: TrustedViews, options: ExtractionOptions) -> Mesh:
    """Move the level set of an opacity field onto the matched depth maps; a fused surface is returned unchanged.

    Args:
        mesh: the level set, normalised frame.
        field: the field that it was extracted from.
        trusted: photos and masks.
        options: of the extraction.
    """
    if not (options.match_photos and isinstance(field, OpacityField) and field.evidence is not None):
        return mesh
    reach = RefinementOptions(reach=options.opacity_reach)
    return project_onto_surface(mesh, vertex_normals(mesh), field.evidence, ground_pixels(mesh, trusted.views), reach)


def color_mesh(mesh: Mesh, scene: Scene, trusted: TrustedViews, options: ColorOptions, reporter: Reporter) -> Mesh:
    """Colour the vertices of a mesh from the photos.

    Args:
        mesh: normalised frame.
        scene: photos, cameras and sparse points.
        trusted: the photos that colours are taken from.
        options: of the colours.
        reporter: for progress, warnings and the request to cancel.
    """
    return color_from_photos(
        mesh, trusted.views, lambda i: scene.photo(trusted.indices[i]), [building(label) for label in trusted.labels],
        lambda share: reporter.progress(_REFINED + (_COLORED - _REFINED) * share), options,
    )  # fmt: skip


def finish_mesh(mesh: Mesh, field: SurfaceField, options: ExtractionOptions) -> Mesh:
    """Attach confidence and number of views to the simplified mesh, and fill dents that no photo confirms."""
    values = {name: v for name, v in field.observations(mesh.vertices).items() if name != "confirmed"}
    planar = mesh.values.get(ON_PLANE, np.zeros(len(mesh.vertices), np.uint8)) > 0
    mesh = replace(mesh, values=values)
    if not (options.span_dents and "confidence" in mesh.values):
        return mesh
    return fill_low_confidence(mesh, np.where(planar, 1.0, mesh.values["confidence"]), options.fill)


def keep_clicked_parts(
    mesh: Mesh,
    scene: Scene,
    masks: MaskSet,
    reporter: Reporter,
    options: ComponentFilterOptions = ComponentFilterOptions(),
) -> Mesh:
    """Remove the parts that were not clicked and are not near a clicked part; keep all if there are no clicks.

    Args:
        mesh: normalised frame.
        scene: photos, cameras and sparse points.
        masks: with the clicks that they were made from.
        reporter: for progress, warnings and the request to cancel.
        options: maximum distance from a clicked part.
    """
    if not masks.clicks:
        return mesh
    kept = faces_near_clicks(mesh, scene.views, masks.clicks, options)
    if kept.all():
        return mesh
    areas = clean.face_areas(mesh)
    reporter.warning(
        f"A part of the mesh ({areas[~kept].sum() / areas.sum():.1%} of it) is apart from everything that was "
        "clicked and was removed; if it belongs to the building, click it as well."
    )
    return clean.with_faces(mesh, mesh.faces[kept])


def refine_mesh(mesh: Mesh, trusted: TrustedViews, options: ExtractionOptions, reporter: Reporter) -> Mesh:
    """Move the vertices to where patches of the photos correlate best (photometric mesh refinement).

    Args:
        mesh: normalised frame.
        trusted: photos and masks; without photos to match, the mesh is returned unchanged.
        options: rounds, matching and refinement.
        reporter: for progress, warnings and the request to cancel.
    """
    return refine(
        mesh, trusted, options.refine_rounds,
        lambda share: reporter.progress(_CLEANED + (_REFINED - _CLEANED) * share), options.fusion,
        options.refinement,
    )  # fmt: skip


class FlatMesh(NamedTuple):
    """A mesh whose planar regions lie in their planes.

    Attributes:
        mesh: normalised frame.
        pixel: size of a ground pixel at each vertex, [N].
        planes: None where there are none.
    """

    mesh: Mesh
    pixel: NDArray[np.float64]
    planes: Planes | None


def known_planes(start: StartSurface | None) -> list[Plane]:
    """Return the planes of the starting surface, strongest first; none without one."""
    return [] if start is None else [Plane(plane[:3], -float(plane[3])) for plane in start.planes]


def flatten_mesh(
    mesh: Mesh,
    trusted: TrustedViews,
    options: ExtractionOptions,
    check: Callable[[], None] = lambda: None,
    known: Sequence[Plane] = (),
) -> FlatMesh:
    """Project the planar regions of a mesh onto their planes, and extend the planes unless the photos contradict.

    Args:
        mesh: normalised frame.
        trusted: photos and masks; without photos to match, planes are not extended.
        options: of the planes, the patches and the labels.
        check: called between the steps; raises to stop.
        known: planes that edges in the photos lie on, strongest first.
    """
    pixel = ground_pixels(mesh, trusted.views).astype(np.float64)
    if trusted.photos is None:
        flat = flatten_planes(mesh, pixel, options.planes, known=known)
        return FlatMesh(flat.mesh, pixel, flat.planes)
    # Relief is measured twice: within the planes that region growing finds, and then within those that the vertices are
    # labelled with, which reach farther.
    photos = see_vertices(mesh, pixel, trusted.views, trusted.photos.grey, options.patches)
    relief = Relief(photos, options.relief)
    check()
    flat = flatten_planes(mesh, pixel, options.planes, relief, known)
    check()
    result = extend_planes(mesh, flat, pixel, photos, options.extension, relief)
    check()
    inside = flat.inside | (result.values[ON_PLANE] > 0)
    moves = fade_moves(mesh, result.vertices - mesh.vertices, inside, options.extension.borders)
    return FlatMesh(replace(result, vertices=mesh.vertices + moves), pixel, flat.planes)


def cut_wall_openings(
    flat: FlatMesh,
    scene: Scene,
    trusted: TrustedViews,
    options: ExtractionOptions,
    up: NDArray[np.float64] | None = None,
    check: Callable[[], None] = lambda: None,
) -> Mesh:
    """Cut windows, doors and niches of flat walls, level or arched; their edges are taken from the photos.

    Args:
        flat: the mesh and its planes.
        scene: photos and cameras.
        trusted: photos whose masks are reliable.
        options: of walls, openings and cuts.
        up: direction up, unit [3], normalised frame; None to find it by the scene.
        check: called between the steps; raises to stop.
    """
    mesh, pixel, planes = flat
    if planes is None:
        return mesh
    photos = edge_photos(mesh, trusted.views, lambda i: scene.photo(trusted.indices[i]), options.patches)
    check()
    if up is None:
        up = find_up(scene, options=options.gravity).vector
        check()
    walls = find_wall_openings(mesh, pixel, planes, up, photos, options.wall_openings)
    check()
    result, count = cut_openings(mesh, walls, options.wall_openings.cut)
    log.info("mesh: %d openings in walls, %d of them cut", sum(len(wall.boxes) for wall in walls), count)
    return result


def trim_mesh(mesh: Mesh, field: SurfaceField, trusted: TrustedViews, options: ExtractionOptions) -> Mesh:
    """Remove faces along the border of a mesh that no photo shows, and small parts that this cuts off.

    The border is then smoothed.

    Args:
        mesh: normalised frame.
        field: counts the photos that show a vertex.
        trusted: photos and masks; without photos to match the mesh is returned unchanged, since then the counts come
            from the Gaussians alone.
        options: of the border, and which holes are small.
    """
    if trusted.photos is None or options.borders.photos == 0:
        return mesh
    known = field.observations(mesh.vertices)
    if "views" not in known:
        return mesh
    pixel = ground_pixels(mesh, trusted.views)
    mesh = trim_border(mesh, known["views"], pixel, options.small_hole * pixel, options.borders)
    mesh = drop_unconfirmed_parts(mesh, field, options)
    return smooth_border(mesh, options.small_hole * ground_pixels(mesh, trusted.views), options.borders)


def simplify_mesh(mesh: Mesh, views: Sequence[View], options: ExtractionOptions, reporter: Reporter) -> Mesh:
    """Simplify the coloured mesh within the bounds of the options.

    Args:
        mesh: with colours.
        views: cameras of the photos, for the size of a pixel on the surface.
        options: ``max_faces``, ``face_error`` and ``color_error``.
        reporter: for progress, warnings and the request to cancel.
    """
    result = reduce_faces(
        mesh, options.max_faces, options.face_error * ground_pixels(mesh, views),
        options.color_error if options.color_error < 256 else -1.0,
        lambda share: reporter.progress(_COLORED + (1 - _COLORED) * share),
    )  # fmt: skip
    log.info("mesh: reduced to %d faces", len(result.faces))
    return result


def crop_mesh(mesh: Mesh, close_bottom: bool, box: CropBox | None = None) -> Mesh:
    """Clip the mesh to the crop box, and close its bottom with ``close_bottom``.

    Raises:
        BadInput: no surface lies in the box.
    """
    if box is not None:
        mesh = clip(mesh, box.planes())
        if len(mesh.faces) == 0:
            raise BadInput("No surface lies in the crop box; enlarge it or move it over the building.")
    return cap_rims(mesh) if close_bottom else mesh
