# SPDX-License-Identifier: GPL-3.0-or-later
"""Vote of the masks on which 3D points belong to the building (eq. 3, and eq. 22 for Gaussians).

Taken literally, "inside the mask of every root image" selects nothing: no point lies in the frame of every root image.
Here a photo votes on a point that lies in front of it, in its frame and not on an ignored pixel. On sparse points of
COLMAP only the photos of the track vote, at the observed keypoint: in other photos the point may be occluded.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.masks.image_ops import disc
from mgf_engine.model.masks import IGNORE, MaskSet, building
from mgf_engine.model.pixels import pixel_at
from mgf_engine.model.scene import Scene
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.algorithms import parameter
from mgf_engine.options.config import job_option
from mgf_engine.system.machine import cores

LabelMaps = Sequence[NDArray[np.uint8]]
#: Votes of one view: rows of the points that it votes for, and of those that it votes against.
ViewVotes = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class VoteOptions:
    """Options of the vote of the masks on points and Gaussians."""

    few: int = parameter(4, "Number of votes against a point that are tolerated while no more than half are for it")
    voters: str = job_option("voters")
    strict: bool = job_option("strict_vote")
    tolerance: float = job_option("vote_tolerance")
    dilation: int = job_option("vote_dilation")


@dataclass(frozen=True)
class Votes:
    """Votes for and against each of N points, int32 [N] each."""

    inside: NDArray[np.int32]
    outside: NDArray[np.int32]


def vote(
    points: NDArray[np.float64],
    scene: Scene,
    masks: MaskSet | LabelMaps,
    views: Sequence[int],
    options: VoteOptions = VoteOptions(),
    tracks: NDArray[np.int64] | None = None,
    threads: int = 0,
) -> NDArray[np.bool_]:
    """Find the points on the building by the vote of the masks of ``views`` (eq. 3 and 22).

    Args:
        points: [N, 3], normalised frame.
        scene: cameras, and tracks of the sparse points.
        masks: label maps of all views of the scene, or the set that holds them.
        views: indices of the photos that may vote (the roots, or all with a usable mask).
        options: dilation of the masks and tolerance of the vote.
        tracks: rows of ``scene.points`` [N] if the points are sparse points; then the photos of their tracks vote.
        threads: number of worker threads; 0 uses all cores.

    Returns:
        bool [N].
    """
    labels = masks.labels if isinstance(masks, MaskSet) else masks
    threads = threads or cores()
    if options.strict or tracks is None:
        cast = project_votes(points, scene, labels, views, options.dilation, threads)
        return decide(cast, options, len(views))
    seen = track_votes(scene, labels, views, options.dilation)
    inside, outside = seen.inside[tracks], seen.outside[tracks]
    silent = np.flatnonzero(inside + outside == 0)
    if len(silent):
        cast = project_votes(points[silent], scene, labels, views, options.dilation, threads)
        inside[silent], outside[silent] = cast.inside, cast.outside
    return decide(Votes(inside, outside), options, len(views))


def choose_voters(
    scene: Scene, views: Sequence[int], clicked: Sequence[int], options: VoteOptions = VoteOptions()
) -> list[int]:
    """Choose the views whose masks vote: all of ``views``, or the root photos among them (option ``voters``).

    Args:
        scene: with the suggested root photos.
        views: candidates.
        clicked: photos with clicks, which are the root photos; if empty (given masks), the suggested ones are.
        options: of the vote.
    """
    roots = set(clicked or scene.roots) if options.voters == "roots" else set(views)
    return [i for i in views if i in roots] or list(views)


def decide(votes: Votes, options: VoteOptions, voters: int) -> NDArray[np.bool_]:
    """Accept points with a vote for them and few against: a share of the votes, or at most half of a few; bool [N].

    Args:
        votes: on N points.
        options: what is tolerated; with ``strict`` all must be for a point.
        voters: number of views that may vote.
    """
    if options.strict:
        return (votes.inside == voters) & (votes.outside == 0)
    total = votes.inside + votes.outside
    allowed = np.maximum(options.tolerance * total, np.minimum(options.few, votes.inside * 0.5))
    return (votes.inside > 0) & (votes.outside <= allowed)


def project_votes(
    points: NDArray[np.float64], scene: Scene, labels: LabelMaps, views: Sequence[int], dilation: int, threads: int = 1
) -> Votes:
    """Count votes by projection (eq. 2): of all views with the point in front of them and in their frame.

    Args:
        points: [N, 3], normalised frame.
        scene: cameras.
        labels: label maps of all views, uint8 [H, W] each.
        views: indices of the views that vote.
        dilation: of the masks, px.
        threads: number of worker threads.
    """
    return count_votes(len(points), votes_of_views(points, scene, labels, views, dilation, threads))


def votes_of_views(
    points: NDArray[np.float64], scene: Scene, labels: LabelMaps, views: Sequence[int], dilation: int, threads: int = 1
) -> Iterator[ViewVotes]:
    """Yield what each view votes on the points in front of it and in its frame.

    Args:
        points: [N, 3], normalised frame.
        scene: cameras.
        labels: label maps of all views, uint8 [H, W] each.
        views: indices of the views that vote, in the order of the votes.
        dilation: of the masks, px.
        threads: number of worker threads.
    """

    def cast(index: int) -> ViewVotes:
        uv, _, inside = scene.views[index].project_into_frame(points)
        rows = np.flatnonzero(inside)
        return _cast(labels[index], uv[rows], rows, dilation)

    yield from parallel_map(cast, views, threads)


def count_votes(count: int, cast: Iterable[ViewVotes]) -> Votes:
    """Count the votes of several views on ``count`` points."""
    inside, outside = np.zeros(count, np.int32), np.zeros(count, np.int32)
    for hit, missed in cast:
        inside[hit] += 1
        outside[missed] += 1
    return Votes(inside, outside)


def track_votes(scene: Scene, labels: LabelMaps, views: Sequence[int], dilation: int) -> Votes:
    """Count votes at the observed keypoints: of the photos in the track of each sparse point.

    Args:
        scene: tracks of the sparse points.
        labels: label maps of all views, uint8 [H, W] each.
        views: indices of the views that vote.
        dilation: of the masks, px.
    """
    count = len(scene.points)
    inside, outside = np.zeros(count, np.int32), np.zeros(count, np.int32)
    owner = scene.track_point
    for index in views:
        here = scene.observations(index)
        hit, missed = _cast(labels[index], scene.track_uv[here], owner[here], dilation)
        np.add.at(inside, hit, 1)  # a track may hold a photo twice
        np.add.at(outside, missed, 1)
    return Votes(inside, outside)


def observed_votes(
    scene: Scene, labels: LabelMaps, index: int, dilation: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], Votes]:
    """Count the votes of one photo on the sparse points that it observed.

    Args:
        scene: tracks of the sparse points.
        labels: label maps of all views, uint8 [H, W] each.
        index: of the view that votes.
        dilation: of the mask, px.

    Returns:
        The points, ascending, [N]; the place among them of each observation of the photo, [O]; and the votes on them.
    """
    here = scene.observations(index)
    points, place = np.unique(scene.track_point[here], return_inverse=True)
    hit, missed = _cast(labels[index], scene.track_uv[here], place, dilation)
    inside, outside = (np.bincount(rows, minlength=len(points)).astype(np.int32) for rows in (hit, missed))
    return points, place, Votes(inside, outside)


def observed_pixels(scene: Scene, index: int, points: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the pixels at which a photo observed those of the scene's points [P] that are chosen, [N, 2]."""
    here = scene.observations(index)
    return scene.track_uv[here][points[scene.track_point[here]]]


def _cast(labels: NDArray[np.uint8], uv: NDArray[np.floating], rows: NDArray[np.int64], dilation: int) -> ViewVotes:
    """Return the votes of one view for and against the points seen at uv [N, 2]; ignored pixels do not vote."""
    if not len(rows):
        return rows, rows
    mask = building(labels)
    if dilation > 0:
        mask = cv2.dilate(mask.astype(np.uint8), disc(dilation)).astype(bool)
    y, x = pixel_at(labels.shape, uv)
    hit = mask[y, x]
    return rows[hit], rows[~hit & (labels[y, x] != IGNORE)]
