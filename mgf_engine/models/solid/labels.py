# SPDX-License-Identifier: GPL-3.0-or-later
"""Assign a roof plane to each cell of the ground plan, or none outside of the building, by minimum energy.

The energy is the volume between the plane of each cell and the heights of the mesh, plus the area of steps and the
length of borders, each times a fraction of the detail. It is minimised by alpha expansion (Boykov, Veksler, Zabih
2001).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from mgf_engine.models.solid.cells import Cells
from mgf_engine.models.solid.evidence import SolidEvidence
from mgf_engine.models.solid.model import Array, signed_ring_area
from mgf_engine.options.algorithms import parameter

#: Costs of the borders between labels [E] and labels [E].
Border = Callable[[NDArray[np.int64], NDArray[np.int64]], Array]

WHOLE = 5e8  # capacities are whole numbers up to this, all together


@dataclass(frozen=True)
class LabelOptions:
    """Options of the energy and of alpha expansion."""

    cap: float = parameter(
        0.25, "Largest difference of heights that counts, as a share of the building's height", high=1
    )
    step_weight: float = parameter(0.25, "Weight of the area of steps, in details")
    length_weight: float = parameter(0.125, "Weight of the length of borders, in squared details")
    rounds: int = parameter(5, "Maximum number of rounds of alpha expansion", low=1)


def choose_planes(
    cells: Cells,
    owner: NDArray[np.int32],
    evidence: SolidEvidence,
    slopes: Array,
    options: LabelOptions = LabelOptions(),
) -> NDArray[np.int64]:
    """Choose the label of each cell: 0 outside, k + 1 the k-th of ``slopes``; [C].

    Args:
        cells: of the ground plan.
        owner: the cell of each pixel.
        evidence: heights of the mesh, and where it stands.
        slopes: [P, 3], planes ``z = a x + b y + c``.
        options: weights of volume and borders.
    """
    cap = max(options.cap * (evidence.top - evidence.ground), 3 * evidence.detail)
    cost = _volumes(cells, owner, evidence, slopes, cap)
    u, v, first, second = np.array([b for b in cells.borders() if b[3] >= 0], np.int64).reshape(-1, 4).T
    nodes = np.array(cells.nodes)
    ends = np.stack([nodes[u], 0.5 * (nodes[u] + nodes[v]), nodes[v]], 1)  # [E, 3, 2]
    ground = np.full((1, *ends.shape[:2]), evidence.ground)
    heights = np.concatenate([ground, np.einsum("pk,enk->pen", slopes[:, :2], ends) + slopes[:, 2, None, None]])
    length = np.linalg.norm(nodes[v] - nodes[u], axis=1)

    def border(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        rows = np.arange(len(length))
        step = np.minimum(np.abs(heights[a, rows] - heights[b, rows]), cap).mean(1)
        steps = evidence.detail * (options.step_weight * step + options.length_weight * evidence.detail)
        return np.asarray(np.where(a == b, 0.0, length * steps))

    label = cost.argmin(1)
    energy = np.inf
    for _ in range(options.rounds):
        for alpha in range(len(slopes) + 1):
            label = _expand(label, alpha, cost, first, second, border)
        now = float(cost[np.arange(len(label)), label].sum() + border(label[first], label[second]).sum())
        if now >= energy * (1 - 1e-6):
            break
        energy = now
    return np.asarray(label, np.int64)


def _volumes(cells: Cells, owner: NDArray[np.int32], evidence: SolidEvidence, slopes: Array, cap: float) -> Array:
    """Return volume between each cell's mesh and each label's plane, [C, P + 1]."""
    count, square = len(cells.rings), evidence.grid.resolution**2
    flat = owner.ravel()
    used = np.flatnonzero(flat >= 0)
    cell, inside = flat[used], evidence.inside.ravel()[used]
    height, at = evidence.height.ravel()[used], evidence.pixels().reshape(-1, 2)[used]
    known = np.isfinite(height) & inside
    cost = np.zeros((count, len(slopes) + 1))
    cost[:, 0] = np.bincount(cell, inside * cap * square, count)
    nodes = np.array(cells.nodes)
    total = np.array([signed_ring_area(nodes[ring]) for ring in cells.rings])
    beyond = np.maximum(total - np.bincount(cell, minlength=count) * square, 0)  # where the grid ends
    beside = np.bincount(cell, ~inside * cap * square, count) + beyond * cap
    for k, (a, b, c) in enumerate(slopes):
        off = np.minimum(np.abs(at[known] @ (a, b) + c - height[known]), cap)
        cost[:, k + 1] = np.bincount(cell[known], off * square, count) + beside
    return cost + _forbidden(cells, evidence, slopes, float(cost.sum()) + 1)


def _forbidden(cells: Cells, evidence: SolidEvidence, slopes: Array, much: float) -> Array:
    """Return a large cost where a plane would lie below the ground or above all that was seen, [C, P + 1]."""
    nodes = np.array(cells.nodes)
    heights = nodes @ slopes[:, :2].T + slopes[:, 2]
    highest = float(np.nanmax(evidence.height)) if np.isfinite(evidence.height).any() else evidence.top
    wrong = (heights < evidence.ground + evidence.detail) | (heights > highest + 2 * evidence.detail)
    result = np.zeros((len(cells.rings), len(slopes) + 1))
    for k, ring in enumerate(cells.rings):
        result[k, 1:] = much * wrong[ring].any(0)
    return result


def _expand(
    label: NDArray[np.int64],
    alpha: int,
    cost: Array,
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    border: Border,
) -> NDArray[np.int64]:
    """Find the best labelling in which each cell keeps its label or takes ``alpha``."""
    count = len(label)
    same = np.full(len(first), alpha)
    keep = border(label[first], label[second])
    one, other = border(label[first], same), border(same, label[second])  # only the second, only the first changes
    change = cost[:, alpha] - cost[np.arange(count), label]
    change = change + np.bincount(first, other - keep, count) - np.bincount(second, other, count)
    source, sink = count, count + 1
    nodes = np.arange(count)
    rows = np.concatenate([first, np.full(count, source), nodes])
    columns = np.concatenate([second, nodes, np.full(count, sink)])
    capacity = np.concatenate([np.maximum(one + other - keep, 0), np.maximum(change, 0), np.maximum(-change, 0)])
    # what is more than all that could be gained is as good as endless
    limit = float(np.abs(change[change < 0]).sum()) + 1e-12
    capacity = np.minimum(capacity, limit)
    scale = WHOLE / max(float(capacity.sum()), 1e-12)
    graph = csr_array((np.rint(capacity * scale).astype(np.int32), (rows, columns)), (count + 2, count + 2))
    graph.sum_duplicates()
    residual = graph - maximum_flow(graph, source, sink).flow
    residual.data = np.maximum(residual.data, 0)
    residual.eliminate_zeros()
    kept = np.zeros(count + 2, bool)
    kept[breadth_first_order(csr_array(residual), source, return_predecessors=False)] = True
    return np.where(kept[:count], label, alpha)
