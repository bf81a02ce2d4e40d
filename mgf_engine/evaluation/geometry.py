# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry metrics: accuracy, completeness and F1 against a true mesh (eq. 30-32), normals, and mask IoU.

Points are sampled uniformly by area on both meshes; each is measured to the other *surface*, so the truth against
itself gives 100 at every threshold. True points that no camera saw are left out of completeness. A point of the mesh is
of the material of the true face nearest to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.align import align_to
from mgf_engine.evaluation.materials import Materials
from mgf_engine.evaluation.scores import GeometryScores, MaterialScores, check_thresholds
from mgf_engine.evaluation.surfaces import Faces, Hygiene, MaskedView, Points, Surface

MOST_SAMPLES = 100_000_000  # of a mesh: some 10 GB


@dataclass(frozen=True)
class Comparison:
    """Points sampled on a mesh and on its truth, and how far each lies from the other surface.

    Attributes:
        errors, gaps: distances of ``points`` [N, 3] to the truth, and of the seen ``true_points`` [M, 3] to the mesh.
        turns: [N], angle between the mesh's face and the nearest true one, degrees.
        faces, true_faces: [N] the true face nearest to each point, and [M] the one each true point lies on.
        truth: the true mesh. The others: as in :class:`GeometryScores`.
    """

    truth: Surface
    points: Points
    errors: Points
    turns: Points
    faces: Faces
    true_points: Points
    true_faces: Faces
    gaps: Points
    samples: int
    truth_seen: float
    outside_crop: float
    hygiene: Hygiene
    alignment: Points

    def without(self, part: Surface) -> Comparison:
        """Return the points of both meshes whose nearest part of the truth is not this one.

        Raises:
            BadInput: no true point is left.
        """
        rounding = 1e-6 * float(np.ptp(self.truth.vertices, axis=0).max())  # the part may come from a file of its own
        found = _distances(part, self.points) > self.errors + rounding
        return self._select(found, part.distances(self.true_points) > rounding)

    def inside(self, crop: Points) -> Comparison:
        """Return the points of both meshes inside a crop, [2, 3] low and high corner.

        Raises:
            BadInput: no true point is left.
        """
        return self._select(*(_in_crop(points, crop) for points in (self.points, self.true_points)))

    def _select(self, found: NDArray[np.bool_], true: NDArray[np.bool_]) -> Comparison:
        """Return some points of the mesh, bool [N], and some true ones, bool [M]."""
        _check_any(self.true_points[true])
        return replace(
            self, points=self.points[found], errors=self.errors[found], turns=self.turns[found],
            faces=self.faces[found], true_points=self.true_points[true], true_faces=self.true_faces[true],
            gaps=self.gaps[true],
        )  # fmt: skip

    def scores(self, thresholds: Sequence[float], materials: Materials | None = None) -> GeometryScores:
        """Compute accuracy, completeness, F1 and normals at distances, in the units of the meshes.

        Args:
            materials: of the truth's faces; None for no scores by material.
        """
        errors, gaps = self.errors if len(self.errors) else np.full(1, np.inf), self.gaps
        whole = self._part(thresholds, np.ones(len(self.errors), bool), np.ones(len(gaps), bool))
        return GeometryScores(
            thresholds=tuple(float(t) for t in thresholds), accuracy=whole.accuracy, completeness=whole.completeness,
            f1=whole.f1, normal_median=whole.normal_median, normal_90=whole.normal_90,
            materials={} if materials is None else self._by_material(thresholds, materials),
            mean_error=float(errors.mean()), median_error=float(np.median(errors)),
            mean_gap=float(gaps.mean()), median_gap=float(np.median(gaps)), samples=self.samples,
            truth_seen=self.truth_seen, outside_crop=self.outside_crop, hygiene=self.hygiene,
            alignment=tuple(tuple(float(v) for v in row) for row in self.alignment),
        )  # fmt: skip

    def _by_material(self, thresholds: Sequence[float], materials: Materials) -> dict[str, MaterialScores]:
        """Return the scores of each material that some true point is of, the largest first."""
        of_points, of_true = materials.faces[self.faces], materials.faces[self.true_faces]
        count = np.bincount(of_true, minlength=len(materials.names))
        order = [k for k in np.argsort(-count, kind="stable").tolist() if count[k]]
        return {materials.names[k]: self._part(thresholds, of_points == k, of_true == k) for k in order}

    def _part(self, thresholds: Sequence[float], mine: NDArray[np.bool_], true: NDArray[np.bool_]) -> MaterialScores:
        """Return the scores of some points of the mesh [N] and some true ones [M]; what is not there is not
        accurate."""
        errors, gaps = self.errors[mine] if mine.any() else np.full(1, np.inf), self.gaps[true]
        accuracy = [100.0 * float((errors <= t).mean()) for t in thresholds]
        completeness = [100.0 * float((gaps <= t).mean()) for t in thresholds]
        turns = self.turns[mine & (self.errors <= max(thresholds))]
        turns = turns[np.isfinite(turns)]
        return MaterialScores(
            100.0 * float(true.mean()), tuple(accuracy), tuple(completeness),
            tuple(_harmonic(a, c) for a, c in zip(accuracy, completeness, strict=True)),
            float(np.median(turns)) if len(turns) else None,
            float(np.percentile(turns, 90)) if len(turns) else None,
        )  # fmt: skip


@dataclass(frozen=True)
class ComparisonOptions:
    """How a mesh is compared with the truth.

    Attributes:
        samples: number of points sampled on each of both.
        cameras: true points none of them sees are left out; None keeps all.
        crop: [2, 3] low and high corner; points outside are left out on both sides (for reconstructions that hold more
            than the truth does).
        align: ``none``, ``rigid`` or ``similarity``: register the mesh first.
        seed: of the samples.
    """

    samples: int = 1_000_000
    cameras: Sequence[MaskedView] | None = None
    crop: Points | None = None
    align: str = "none"
    seed: int = 0


def score_surface(
    mesh: Surface,
    truth: Surface,
    thresholds: Sequence[float] = (0.05,),
    options: ComparisonOptions = ComparisonOptions(),
    leave_out: Surface | None = None,
    materials: Materials | None = None,
) -> GeometryScores:
    """Score a mesh against the truth: accuracy, completeness and F1 (eq. 30-32).

    Args:
        mesh: to be scored.
        truth: what it is compared with.
        thresholds: distances that count as right, in the units of the meshes.
        options: samples, and what is left out on both sides.
        leave_out: a part of the truth that is not scored: points of both meshes that it is the nearest part to are left
            out (the paper leaves out Dortmund's steel framework so, section 4.3.1).
        materials: of the truth's faces; None for no scores by material.

    Raises:
        BadInput: thresholds or samples that are not positive, nothing inside the crop, or no true point left to score.
    """
    check_thresholds(thresholds)
    found = compare_surfaces(mesh, truth, options)
    return (found if leave_out is None else found.without(leave_out)).scores(thresholds, materials)


def compare_surfaces(mesh: Surface, truth: Surface, options: ComparisonOptions = ComparisonOptions()) -> Comparison:
    """Measure the distances between a mesh and the truth, which :func:`score_surface` takes its scores from.

    Raises:
        BadInput: an impossible number of samples, nothing inside the crop, or no true point seen.
    """
    samples, crop = options.samples, options.crop
    if not 1 <= samples <= MOST_SAMPLES:
        raise BadInput(f"The number of samples must be 1 to {MOST_SAMPLES}, not {samples}.")
    rng = np.random.default_rng(options.seed)
    matrix = np.eye(4)
    hygiene = mesh.hygiene()
    if options.align != "none":
        matrix = align_to(mesh, truth, scale=options.align == "similarity")
        mesh = transform_mesh(mesh, matrix)
    true_points, true_faces = _inside(*truth.sample(samples, rng), crop)
    points, own = _inside(*mesh.sample(samples, rng), crop)
    inside = len(true_points)
    if options.cameras is not None:
        seen = truth.seen_by(true_points, options.cameras)
        true_points, true_faces = true_points[seen], true_faces[seen]
    _check_any(true_points)
    errors, faces = _nearest(truth, points)
    return Comparison(
        truth, points, errors, _turns(mesh.normals(own), truth.normals(faces)), faces, true_points, true_faces,
        mesh.distances(true_points), samples,
        truth_seen=100.0 * len(true_points) / max(inside, 1), outside_crop=100.0 * (1.0 - len(points) / samples),
        hygiene=hygiene, alignment=matrix,
    )  # fmt: skip


def mask_iou(found: NDArray[np.bool_], true: NDArray[np.bool_], valid: NDArray[np.bool_] | None = None) -> float:
    """Intersection over union of two masks [height, width] in percent, over the valid pixels; 100 if both are empty."""
    if valid is not None:
        found, true = found & valid, true & valid
    union = int((found | true).sum())
    return 100.0 if union == 0 else 100.0 * int((found & true).sum()) / union


def transform_mesh(mesh: Surface, matrix: Any) -> Surface:
    """Return the mesh after a similarity [4, 4]."""
    matrix = np.asarray(matrix, dtype=np.float64)
    return Surface(mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3], mesh.faces)


def _inside(points: Points, faces: Faces, crop: Points | None) -> tuple[Points, Faces]:
    """Return points [N, 3] and their faces [N], those in the crop alone."""
    if crop is None:
        return points, faces
    kept = _in_crop(points, crop)
    return points[kept], faces[kept]


def _in_crop(points: Points, crop: Points) -> NDArray[np.bool_]:
    """Tell which points [N, 3] lie in a crop, bool [N]."""
    return np.asarray(((points >= crop[0]) & (points <= crop[1])).all(axis=1))


def _nearest(surface: Surface, points: Points) -> tuple[Points, Faces]:
    """Return the distance of points [N, 3], which may be none, to a surface [N], and the face it is taken to [N]."""
    if not len(points):
        return np.zeros(0), np.zeros(0, np.int64)
    squared, face, _ = surface.closest(points)
    return np.sqrt(squared), face.astype(np.int64)


def _distances(surface: Surface, points: Points) -> Points:
    return _nearest(surface, points)[0]


def _turns(normals: Points, others: Points) -> Points:
    """Return angles between unit normals [N, 3] of either sign, degrees [N]; NaN where one is zero."""
    known = (np.abs(normals).sum(1) > 0) & (np.abs(others).sum(1) > 0)
    # From the chord: near zero the arc cosine would lose half of the digits.
    sign = np.where(np.einsum("ni,ni->n", normals, others) < 0, -1.0, 1.0)
    chord = np.linalg.norm(normals - sign[:, None] * others, axis=1)
    return np.where(known, np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1.0))), np.nan)


def _check_any(true_points: Points) -> None:
    if len(true_points) == 0:
        raise BadInput(
            "No point of the true mesh is inside the crop, seen by a camera and to be scored; check that all share one "
            "frame."
        )


def _harmonic(a: float, b: float) -> float:
    return 0.0 if a + b == 0 else 2 * a * b / (a + b)
