# SPDX-License-Identifier: GPL-3.0-or-later
"""How right a mesh is: accuracy, completeness and F1 against a true mesh (eq. 30-32), and mask IoU.

Points are sampled uniformly by area on both meshes; each is measured to the other *surface*, so the truth against
itself gives 100 at every threshold. True points that no camera saw are left out of completeness.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.evaluate.align import align_to
from mgf_engine.evaluate.surfaces import Hygiene, Points, SeeingCamera, Surface

MOST_SAMPLES = 100_000_000  # of a mesh: some 10 GB


@dataclass(frozen=True)
class GeometryScores:
    """Scores of one mesh; percentages per threshold, distances in the units of the meshes.

    Attributes:
        accuracy: share of the mesh's points within the threshold of the truth, eq. 30.
        completeness: share of the seen true points within the threshold of the mesh, eq. 31.
        f1: harmonic mean of both, eq. 32.
        mean_error, median_error: mesh to truth; mean_gap, median_gap: seen truth to mesh.
        truth_seen: percentage of the truth that at least one camera saw.
        outside_crop: percentage of the mesh's points left out because they lie outside the crop box.
        alignment: 4x4 matrix that moved the mesh onto the truth before scoring.
    """

    thresholds: tuple[float, ...]
    accuracy: tuple[float, ...]
    completeness: tuple[float, ...]
    f1: tuple[float, ...]
    mean_error: float
    median_error: float
    mean_gap: float
    median_gap: float
    samples: int
    truth_seen: float
    outside_crop: float
    hygiene: Hygiene
    alignment: tuple[tuple[float, ...], ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Comparison:
    """Points sampled on a mesh and on its truth, and how far each lies from the other surface.

    Attributes:
        errors, gaps: distances of ``points`` [N, 3] to the truth, and of the seen ``true_points`` [M, 3] to the mesh.
        truth: the true mesh. The others: as in :class:`GeometryScores`.
    """

    truth: Surface
    points: Points
    errors: Points
    true_points: Points
    gaps: Points
    samples: int
    truth_seen: float
    outside_crop: float
    hygiene: Hygiene
    alignment: Points

    def without(self, part: Surface) -> Comparison:
        """The points of both meshes whose nearest part of the truth is not this one.

        Raises:
            BadInput: no true point is left.
        """
        rounding = 1e-6 * float(np.ptp(self.truth.vertices, axis=0).max())  # the part may come from a file of its own
        found = _distances(part, self.points) > self.errors + rounding
        true = part.distances(self.true_points) > rounding
        _check_any(self.true_points[true])
        return replace(
            self, points=self.points[found], errors=self.errors[found], true_points=self.true_points[true],
            gaps=self.gaps[true],
        )  # fmt: skip

    def scores(self, thresholds: Sequence[float]) -> GeometryScores:
        """Accuracy, completeness and F1 at distances, in the units of the meshes."""
        errors, gaps = self.errors if len(self.errors) else np.full(1, np.inf), self.gaps
        accuracy = [100.0 * float((errors <= t).mean()) for t in thresholds]
        completeness = [100.0 * float((gaps <= t).mean()) for t in thresholds]
        return GeometryScores(
            thresholds=tuple(float(t) for t in thresholds), accuracy=tuple(accuracy), completeness=tuple(completeness),
            f1=tuple(_harmonic(a, c) for a, c in zip(accuracy, completeness, strict=True)),
            mean_error=float(errors.mean()), median_error=float(np.median(errors)),
            mean_gap=float(gaps.mean()), median_gap=float(np.median(gaps)), samples=self.samples,
            truth_seen=self.truth_seen, outside_crop=self.outside_crop, hygiene=self.hygiene,
            alignment=tuple(tuple(float(v) for v in row) for row in self.alignment),
        )  # fmt: skip


def score_surface(
    mesh: Surface,
    truth: Surface,
    thresholds: Sequence[float] = (0.05,),
    samples: int = 1_000_000,
    cameras: Sequence[SeeingCamera] | None = None,
    crop: Points | None = None,
    align: str = "none",
    seed: int = 0,
    leave_out: Surface | None = None,
) -> GeometryScores:
    """Accuracy, completeness and F1 (eq. 30-32).

    Args:
        thresholds: distances that count as right, in the units of the meshes.
        samples: points sampled on each mesh.
        cameras: true points none of them sees are left out; None keeps all.
        crop: [2, 3] low and high corner; points outside are left out on both sides (for reconstructions that hold
            more than the truth does).
        align: ``none``, ``rigid`` or ``similarity``: register the mesh first.
        leave_out: a part of the truth that is not judged: points of both meshes that it is the nearest part to are left
            out (the paper leaves out Dortmund's steel framework so, section 4.3.1).

    Raises:
        BadInput: thresholds or samples that are not positive, nothing inside the crop, or no true point left to judge.
    """
    if samples < 1 or not thresholds or not all(0 < t < math.inf for t in thresholds):
        raise BadInput("Thresholds and the number of samples must be finite and larger than 0.")
    found = compare_surfaces(mesh, truth, samples, cameras, crop, align, seed)
    return (found if leave_out is None else found.without(leave_out)).scores(thresholds)


def compare_surfaces(
    mesh: Surface,
    truth: Surface,
    samples: int = 1_000_000,
    cameras: Sequence[SeeingCamera] | None = None,
    crop: Points | None = None,
    align: str = "none",
    seed: int = 0,
) -> Comparison:
    """What :func:`score_surface` takes its scores from; arguments as there.

    Raises:
        BadInput: too many samples, nothing inside the crop, or no true point seen.
    """
    if samples > MOST_SAMPLES:
        raise BadInput(f"The number of samples must be at most {MOST_SAMPLES}, not {samples}.")
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    hygiene = mesh.hygiene()
    if align != "none":
        matrix = align_to(mesh, truth, scale=align == "similarity")
        mesh = moved(mesh, matrix)
    true_points, _ = truth.sample(samples, rng)
    points, _ = mesh.sample(samples, rng)
    true_points, points = _inside(true_points, crop), _inside(points, crop)
    inside = len(true_points)
    if cameras is not None:
        true_points = true_points[truth.seen_by(true_points, cameras)]
    _check_any(true_points)
    return Comparison(
        truth, points, _distances(truth, points), true_points, mesh.distances(true_points), samples,
        truth_seen=100.0 * len(true_points) / max(inside, 1), outside_crop=100.0 * (1.0 - len(points) / samples),
        hygiene=hygiene, alignment=matrix,
    )  # fmt: skip


def mask_iou(found: NDArray[np.bool_], true: NDArray[np.bool_], valid: NDArray[np.bool_] | None = None) -> float:
    """Intersection over union of two masks [height, width] in percent, over the valid pixels; 100 if both are empty."""
    if valid is not None:
        found, true = found & valid, true & valid
    union = int((found | true).sum())
    return 100.0 if union == 0 else 100.0 * int((found & true).sum()) / union


def colmap_cameras(scene: Path) -> list[SeeingCamera]:
    """The registered cameras of a COLMAP model.

    Raises:
        BadInput: no model is found or it has no registered image.
    """
    for place in (scene, scene / "sparse/0", scene / "sparse", scene / "sparse_truth"):
        if any((place / f"cameras{end}").exists() for end in (".bin", ".txt")):
            break
    else:
        raise BadInput(f"There is no COLMAP model in '{scene}'; give the folder that holds 'sparse/0'.")
    return cameras_of(place)


def cameras_of(
    model: Path, mask_of: Callable[[str], NDArray[np.bool_] | None] = lambda name: None
) -> list[SeeingCamera]:
    """The registered cameras of the COLMAP model in a folder, in the order of their photos' names.

    Args:
        mask_of: name of a photo -> its mask, see :class:`SeeingCamera`.

    Raises:
        BadInput: the model cannot be read or has no registered image.
    """
    import pycolmap

    try:
        whole = pycolmap.Reconstruction(model)  # owns its images
    except Exception as error:  # pycolmap raises several kinds
        raise BadInput(f"Cannot read the COLMAP model in '{model}' ({error}); export it again.") from error
    images = sorted((i for i in whole.images.values() if i.has_pose), key=lambda i: str(i.name))
    if not images:
        raise BadInput(f"The COLMAP model in '{model}' has no registered image; run structure from motion again.")
    return [SeeingCamera.of_image(image, mask_of(str(image.name))) for image in images]


def moved(mesh: Surface, matrix: Any) -> Surface:
    """The mesh after a similarity [4, 4]."""
    matrix = np.asarray(matrix, dtype=np.float64)
    return Surface(mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3], mesh.faces)


def _inside(points: Points, crop: Points | None) -> Points:
    if crop is None:
        return points
    return points[((points >= crop[0]) & (points <= crop[1])).all(axis=1)]


def _distances(surface: Surface, points: Points) -> Points:
    """Of points [N, 3], which may be none, to a surface, [N]."""
    return surface.distances(points) if len(points) else np.zeros(0)


def _check_any(true_points: Points) -> None:
    if len(true_points) == 0:
        raise BadInput(
            "No point of the true mesh is inside the crop, seen by a camera and to be judged; check that all share one "
            "frame."
        )


def _harmonic(a: float, b: float) -> float:
    return 0.0 if a + b == 0 else 2 * a * b / (a + b)
