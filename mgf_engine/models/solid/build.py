# SPDX-License-Identifier: GPL-3.0-or-later
"""The solid of a job: as much roof as was seen, a block where it was not, and how far either lies from the mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from mgf_engine.drawings.model import Survey
from mgf_engine.evaluation.surfaces import Surface
from mgf_engine.models.lod import deviation_of
from mgf_engine.models.solid.cells import cell_of_pixels, cut_into_cells
from mgf_engine.models.solid.checks import faults_of, triangles, volume_of
from mgf_engine.models.solid.evidence import SolidEvidence, detail_of, gather_solid_evidence
from mgf_engine.models.solid.evidence_options import EvidenceOptions
from mgf_engine.models.solid.labels import LabelOptions, choose_planes
from mgf_engine.models.solid.model import ROOF, WALL, Array, Solid
from mgf_engine.models.solid.party_walls import PartyWallOptions, find_party_walls
from mgf_engine.models.solid.plan_lines import wall_lines
from mgf_engine.models.solid.polyhedron import PolyhedronOptions, make_polyhedron
from mgf_engine.options.algorithms import parameter


@dataclass(frozen=True)
class SolidOptions:
    """Options of the solid as a whole."""

    margin: float = parameter(3.0, "Margin of the ground plan around what is seen from above, in details")
    roof_seen: float = parameter(0.5, "Share of the footprint in roof planes below which the solid is a block", high=1)
    trials: int = parameter(3, "Number of attempts, each with a coarser detail", low=1)
    coarser: float = parameter(1.5, "Factor on the detail from attempt to attempt", low=1)
    unseen_walls: float = parameter(
        0.4, "Share of the walls that no photo showed, above which there is no solid", high=1
    )
    facing: float = parameter(
        0.5, "Smallest cosine between the normals of the solid and of the mesh that shows it", high=1
    )
    seen_distance: float = parameter(2.0, "Largest distance between the solid and the mesh that shows it, in details")
    samples: int = parameter(100000, "Number of points that the solid is compared with the mesh at", low=100)
    evidence: EvidenceOptions = EvidenceOptions()
    labels: LabelOptions = LabelOptions()
    faces: PolyhedronOptions = PolyhedronOptions()
    party_walls: PartyWallOptions = PartyWallOptions()


#: What helps where the mesh shows too little.
_MORE_PHOTOS = "take photos from all sides"


class NoSolid(Exception):
    """The mesh does not enclose a building; the message says why.

    Attributes:
        cure: what to do, in the imperative.
    """

    def __init__(self, reason: str, cure: str) -> None:
        super().__init__(reason)
        self.cure = cure


def build_solid(
    survey: Survey,
    detail: float | None = None,
    options: SolidOptions = SolidOptions(),
    taken: shapely.Geometry | None = None,
) -> Solid:
    """Build the solid of a survey, checked and measured.

    Args:
        survey: mesh in the local frame, and what is known of it.
        detail: steps and offsets below this size are left out; None takes it from photos and size.
        options: what is too little evidence, and of every step.
        taken: ground of the neighbours and so much around it as their walls may lie beside the map, local frame. What
            lies there is a party wall, which nobody can see, and no reason to refuse the solid. None where no map
            tells; those party walls that the mesh shows are found then.

    Raises:
        NoSolid: there is none.
    """
    if taken is None and options.party_walls.found:
        fine = detail_of(survey, options.evidence) if detail is None else detail
        taken = find_party_walls(survey, wall_lines(survey, fine, options.evidence), fine, options.party_walls)
    evidence = gather_solid_evidence(survey, detail, options.evidence, taken)
    if evidence.inside.sum() * evidence.grid.resolution**2 < 4 * evidence.detail**2:
        cure = _MORE_PHOTOS if detail is None else f"give a --detail below {100 * detail:.6g}, or {_MORE_PHOTOS}"
        raise NoSolid("the mesh covers no ground", cure)
    level = 2 if evidence.roof_seen >= options.roof_seen else 1
    for _ in range(options.trials):
        solid = _make(evidence, level, options)
        faults = faults_of(solid, 0.1 * evidence.detail)
        if not faults:
            return _checked(_measured(solid, survey, evidence, level, options, taken), options)
        evidence = gather_solid_evidence(survey, options.coarser * evidence.detail, options.evidence, taken)
    if level == 2:
        solid = _make(evidence, 1, options)
        faults = faults_of(solid, 0.1 * evidence.detail)
        if not faults:
            return _checked(_measured(solid, survey, evidence, 1, options, taken), options)
    coarser = f", or give a --detail above {100 * evidence.detail:.3g}" if solid.faces else ""  # of nothing: nothing
    raise NoSolid(faults[0], _MORE_PHOTOS + coarser)


def _make(evidence: SolidEvidence, level: int, options: SolidOptions) -> Solid:
    """Make the solid: of the roof planes at level 2, a block with a level top at level 1."""
    slopes = evidence.slopes if level == 2 else np.array([[0.0, 0.0, evidence.block]])
    row, column = np.nonzero(evidence.inside)
    at = evidence.grid.places(np.stack([column, row], 1).astype(np.float64) + 0.5)
    around = options.margin * evidence.detail
    cells = cut_into_cells(evidence.lines, at.min(0) - around, at.max(0) + around)
    owner = cell_of_pixels(cells, evidence.grid)
    label = choose_planes(cells, owner, evidence, slopes, options.labels)
    return make_polyhedron(cells, label, slopes, evidence.ground, evidence.lines, options.faces)


def _measured(
    solid: Solid,
    survey: Survey,
    evidence: SolidEvidence,
    level: int,
    options: SolidOptions,
    taken: shapely.Geometry | None,
) -> Solid:
    """Measure the solid against the mesh, and return it with what is known about it."""
    faces, owner = triangles(solid)
    surface, mesh = Surface(solid.vertices, faces.astype(np.int64)), _mesh_surface(survey)
    rng = np.random.default_rng(0)
    points = mesh.sample(options.samples, rng)[0]
    points = points[points[:, 2] > evidence.ground + 0.5 * evidence.detail]
    on_solid, triangle = surface.sample(options.samples, rng)
    squared, nearest, _ = mesh.closest(on_solid)
    turned = (mesh.normals(nearest) * surface.normals(triangle)).sum(1) < options.facing
    far = turned | (squared > (options.seen_distance * evidence.detail) ** 2)
    kinds = np.array([face.kind for face in solid.faces])[owner[triangle]]
    party = (kinds == WALL) & (False if taken is None else shapely.contains_xy(taken, on_solid[:, :2]))
    unseen = {str(kind): _mean(far[(kinds == kind) & ~party]) for kind in (ROOF, WALL)}
    return replace(
        solid, level=level, ground=evidence.ground, ground_from=evidence.ground_from, detail=evidence.detail,
        volume=volume_of(solid), deviation=deviation_of(_distances(surface, points)), unseen=unseen,
        party=_mean(party[kinds == WALL], 0.0),
    )  # fmt: skip


def _mean(values: NDArray[np.bool_], of_none: float = 1.0) -> float:
    return round(float(values.mean()), 4) if len(values) else of_none


def _checked(solid: Solid, options: SolidOptions) -> Solid:
    """Refuse a solid most of whose walls are made up.

    Raises:
        NoSolid: they are.
    """
    if solid.unseen.get(WALL, 1.0) > options.unseen_walls:
        free = "its walls" if solid.party == 0 else f"its walls beside the {solid.party:.0%} against neighbours"
        raise NoSolid(
            f"the mesh has {1 - solid.unseen.get(WALL, 1.0):.0%} of {free}",
            f"{_MORE_PHOTOS}; a house in a row gets one from 'mgf town', whose map tells which walls stand against "
            "neighbours",
        )
    return solid


def _mesh_surface(survey: Survey) -> Surface:
    return Surface(survey.mesh.vertices, survey.mesh.faces.astype(np.int64))


def _distances(surface: Surface, points: Array) -> NDArray[np.float64]:
    return surface.distances(points) if len(points) else np.zeros(1)
