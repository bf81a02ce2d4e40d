# SPDX-License-Identifier: GPL-3.0-or-later
"""Find lines in space from straight edges of three or more photos (after Hofer et al. 2017, Line3D++).

Points are placed on the lines, with the views that saw each.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgf_engine.native.library import by_reference, parallel
from mgf_engine.start.options import SegmentOptions
from mgf_engine.start.segments import Segments

log = logging.getLogger("mgf")
_BATCH = 32_000  # segments that are fitted at a time: bounds the memory


@dataclass(frozen=True)
class Line3D:
    """A line in space.

    Attributes:
        ends: [2, 3], normalised frame.
        views: positions of the views that show it, [M].
        shown: interval of the line that each of them shows, as distances from the first end, [M, 2].
    """

    ends: NDArray[np.float64]
    views: NDArray[np.int64]
    shown: NDArray[np.float64]

    @property
    def direction(self) -> NDArray[np.float64]:
        """Unit vector [3]."""
        d = self.ends[1] - self.ends[0]
        return np.asarray(d / np.linalg.norm(d))


def choose_neighbours(segments: Segments) -> NDArray[np.int32]:
    """Choose the photos each photo is compared with, nearest in angle first, -1 for none, [V, count]."""
    angles, (least, most) = segments.views.angles, segments.options.angles
    fits = np.where((angles > least) & (angles < most), angles, np.inf)
    order = np.argsort(fits, 1, kind="stable")[:, : segments.options.neighbours]
    return np.ascontiguousarray(np.where(np.isfinite(np.take_along_axis(fits, order, 1)), order, -1), np.int32)


def match_segments(
    segments: Segments, neighbours: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find for each segment the line that most neighbours see (kernel ``mgf_match_segments``).

    Returns:
        lines [S, 2, 3], and the sum of their neighbours' supports [S]; 0 for none.
    """
    lines, score = np.zeros((len(segments.ends), 2, 3)), np.zeros(len(segments.ends))
    box = np.ascontiguousarray(np.stack([segments.views.low, segments.views.high]))
    sine = float(np.sin(np.radians(segments.options.angles[0])))
    parallel(
        "mgf_match_segments", len(score), by_reference(segments.table), neighbours, neighbours.shape[1], box, sine,
        lines, score,
    )  # fmt: skip
    return lines, score


def fit_segments(
    segments: Segments, source: NDArray[np.int32], lines: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float32], NDArray[np.float64]]:
    """Fit lines to all segments that support them (kernel ``mgf_fit_segments``).

    Args:
        segments: of all photos.
        source: the segment that each line comes from, [N].
        lines: where the fit begins, [N, 2, 3].

    Returns:
        lines [N, 2, 3]; the segment of each photo that supports each, -1 for none, [N, V]; its residual in px [N, V];
        and the interval of the line that it shows, [N, V, 2].
    """
    count, views = len(source), len(segments.views.views)
    lines, rows = np.ascontiguousarray(lines).copy(), np.zeros((count, views), np.int32)
    residuals, ends = np.zeros((count, views), np.float32), np.zeros((count, views, 2))
    parallel(
        "mgf_fit_segments", count, by_reference(segments.table), source, float(segments.views.pixel), lines, rows,
        residuals, ends,
    )  # fmt: skip
    return lines, rows, residuals, ends


def find_lines(segments: Segments) -> list[Line3D]:
    """Find lines of a building greedily, strongest first: each explains enough segments that no earlier one does."""
    options, lengths = segments.options, segments.lengths
    hypotheses, score = match_segments(segments, choose_neighbours(segments))
    source = np.flatnonzero(score > options.least_score).astype(np.int32)
    source = np.ascontiguousarray(source[np.argsort(-score[source] * lengths[source], kind="stable")])
    used = np.zeros(len(lengths), bool)
    result: list[Line3D] = []
    for start in range(0, len(source), _BATCH):
        batch = source[start : start + _BATCH]
        result += _select_lines(segments, batch, fit_segments(segments, batch, hypotheses[batch]), used)
    log.info("start: %d segments, %d with a line, %d lines", len(score), len(source), len(result))
    return result


def _select_lines(
    segments: Segments,
    source: NDArray[np.int32],
    fitted: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float32], NDArray[np.float64]],
    used: NDArray[np.bool_],
) -> list[Line3D]:
    """Select the fitted lines that explain enough segments that no line before them explains.

    Args:
        segments: of all photos.
        source: the segment that each line comes from, [N].
        fitted: as :func:`fit_segments` returns them.
        used: whether a line explains each segment, bool [S]; those that the kept lines explain are marked.
    """
    options, views = segments.options, segments.views
    lines, rows, residuals, ends = fitted
    good = (rows >= 0) & (residuals < options.residual)
    candidates = (good.sum(1) >= options.least_views) & np.take_along_axis(good, segments.view[source][:, None], 1)[
        :, 0
    ]
    share = np.linspace(0, 1, 9)
    at = lines[:, None, 0] + share[None, :, None] * (lines[:, None, 1] - lines[:, None, 0])
    outside = views.is_outside(at.reshape(-1, 3), options.outside).reshape(len(source), -1)
    candidates &= (outside.mean(1) <= options.outside_share) & (
        np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) > 1e-9
    )
    result = []
    for n in np.flatnonzero(candidates):
        if used[source[n]]:
            continue
        seen = np.flatnonzero(good[n])
        mine = rows[n, seen]
        if (
            np.count_nonzero(~used[mine]) < options.least_views
            or _spread(lines[n], views.centres[seen]) < options.spread
        ):
            continue
        used[mine] = True
        result.append(Line3D(lines[n], seen, ends[n, seen]))
    return result


def _spread(line: NDArray[np.float64], centres: NDArray[np.float64]) -> float:
    """Compute the largest angle between the planes through a line [2, 3] and cameras [M, 3], degrees."""
    d = line[1] - line[0]
    d = d / np.linalg.norm(d)
    to = centres - line.mean(0)
    to = to - (to @ d)[:, None] * d
    to = to / np.maximum(np.linalg.norm(to, axis=1, keepdims=True), 1e-30)
    return float(np.degrees(np.arccos(np.clip((to @ to.T).min(), -1, 1))))


def line_points(
    lines: Sequence[Line3D], pixel: float, options: SegmentOptions
) -> tuple[NDArray[np.float64], list[NDArray[np.int64]]]:
    """Place points every ``options.step`` px where enough views show a line.

    Args:
        lines: normalised frame.
        pixel: size of a pixel at the building.
        options: ``step``, ``least_views`` and ``shortest_line``.

    Returns:
        points [N, 3], and positions of the views that show each.
    """
    points: list[NDArray[np.float64]] = []
    seen: list[NDArray[np.int64]] = []
    step, least = options.step * pixel, options.least_views
    for line in lines:
        low, high = np.sort(line.shown[:, 0])[least - 1], np.sort(line.shown[:, 1])[-least]
        if high - low < options.shortest_line * pixel:
            continue
        at = np.linspace(low, high, max(2, int(np.ceil((high - low) / step)) + 1))
        cover = (line.shown[:, 0] <= at[:, None] + 0.5 * step) & (line.shown[:, 1] >= at[:, None] - 0.5 * step)
        kept = cover.sum(1) >= least
        points.append(line.ends[0] + at[kept, None] * line.direction)
        seen += [line.views[row] for row in cover[kept]]
    return np.concatenate([np.zeros((0, 3)), *points]), seen
