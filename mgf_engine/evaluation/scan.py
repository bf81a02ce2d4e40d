# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare a mesh with a laser scan: registration by ICP, then the distance of each scan point from the mesh."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.align import align_points
from mgf_engine.evaluation.scores import check_thresholds
from mgf_engine.evaluation.surfaces import Points, Surface


@dataclass(frozen=True)
class ScanOptions:
    """How a mesh is compared with a scan.

    Attributes:
        reach: distance beyond which scan points belong to something else, units of the mesh; None takes the next.
        reach_share: the same as a share of the mesh's size.
        first_reach: the same while the scan is being registered.
        icp_points: maximum number of scan points that it is registered by.
        aligned: median distance beyond which the registration failed, as a share of the reach.
        least_points: minimum number of scan points on the mesh.
        samples: points on the mesh that tell how much of it the scan covers.
    """

    reach: float | None = None
    reach_share: float = 0.02
    first_reach: float = 0.1
    icp_points: int = 20_000
    aligned: float = 0.5
    least_points: int = 100
    samples: int = 20_000


@dataclass(frozen=True)
class ScanScores:
    """What a scan says about a mesh; lengths in the mesh's unit.

    Attributes:
        alignment: [4, 4], moves the scan onto the mesh.
        used: scan points that belong to the mesh, ``left_out`` those farther away than ``reach``.
        mean: signed, positive where the mesh lies outside the scan; rms, median, p90, p95: of the amounts.
        within: share of the used points within each threshold.
        covered: share of the mesh's area with a scan point within ``reach``.
    """

    alignment: list[list[float]]
    used: int
    left_out: int
    reach: float
    mean: float
    rms: float
    median: float
    p90: float
    p95: float
    thresholds: list[float]
    within: list[float]
    covered: float

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class ScanDistances:
    """Scan points on the mesh: where they are [N, 3] after alignment, and how far the mesh is outside of them, [N]."""

    points: Points
    outside: NDArray[np.float64]


def compare_with_scan(
    mesh: Surface, scan: Points, align: str, thresholds: list[float], options: ScanOptions = ScanOptions()
) -> tuple[ScanScores, ScanDistances]:
    """Register a scan with a mesh and measure the distances of its points.

    Args:
        mesh: in the coordinates of the scan, or near them where it is registered.
        scan: [N, 3].
        align: ``none``, ``rigid`` or ``similarity``.
        thresholds: distances that scores are wanted for, units of the mesh.
        options: which points belong to the mesh, and how they are registered.

    Raises:
        BadInput: a threshold is no distance, or the scan does not lie on the mesh.
    """
    check_thresholds(thresholds)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    size = float(np.linalg.norm(high - low))
    reach = options.reach_share * size if options.reach is None else options.reach
    moved, total = scan, np.eye(4)
    if align != "none":
        near = _within_box(moved, low, high, options.first_reach * size)
        if len(near) >= options.least_points:
            some = near[np.random.default_rng(0).permutation(len(near))[: options.icp_points]]
            total = align_points(some, mesh, align == "similarity")
            moved = scan @ total[:3, :3].T + total[:3, 3]
    near = _within_box(moved, low, high, reach)
    squared, face, spot = mesh.closest(near) if len(near) else (np.zeros(0), np.zeros(0, np.int64), near)
    kept = squared < reach**2
    if kept.sum() < options.least_points or np.sqrt(np.median(squared[kept])) > options.aligned * reach:
        raise BadInput(
            "The scan does not lie on the mesh; both need the same coordinates to within a tenth of the building "
            "(mgf georef), or a registration by hand first."
        )
    near, spot, normal = near[kept], spot[kept], mesh.normals(face[kept])
    outside = np.sqrt(squared[kept]) * -np.sign(((near - spot) * normal).sum(1))
    away = np.abs(outside)
    median, p90, p95 = np.percentile(away, (50, 90, 95)).tolist()
    scores = ScanScores(
        total.tolist(), len(near), len(scan) - len(near), reach, float(outside.mean()),
        float(np.sqrt((outside**2).mean())), median, p90, p95, thresholds,
        [float((away < t).mean()) for t in thresholds], _covered_share(mesh, near, reach, options.samples),
    )  # fmt: skip
    return scores, ScanDistances(near, outside)


def _within_box(points: Points, low: Points, high: Points, margin: float) -> Points:
    return points[((points > low - margin) & (points < high + margin)).all(1)]


def _covered_share(mesh: Surface, points: Points, reach: float, samples: int) -> float:
    """Return the share of the mesh's area that lies near scan points."""
    from scipy.spatial import cKDTree

    places = mesh.sample(samples, np.random.default_rng(0))[0]
    return float((cKDTree(points).query(places, distance_upper_bound=reach)[0] < reach).mean())


def scan_table(scores: ScanScores) -> str:
    """Return the scores as people read them."""
    rows = [
        f"{scores.used} scan points on the mesh, {scores.left_out} farther away than {scores.reach:.3g}; "
        f"{100 * scores.covered:.1f}% of the mesh has scan points near it",
        f"mesh outside the scan by {scores.mean:+.4g} on average; RMS {scores.rms:.4g}, median "
        f"{scores.median:.4g}, 90% below {scores.p90:.4g}, 95% below {scores.p95:.4g}",
    ]
    rows += [f"within {t:g}: {100 * w:.2f}%" for t, w in zip(scores.thresholds, scores.within, strict=True)]
    return "\n".join(rows)
