# SPDX-License-Identifier: GPL-3.0-or-later
"""Segment the elements of the building in one photo (second level: windows, doors, parts of walls, roof faces).

They are segmented by colour or by EfficientSAM; clicks on parts take precedence.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from mgf_engine.masks.image_ops import dilate, dilate_square, rgb_to_lab
from mgf_engine.masks.part_options import PartOptions
from mgf_engine.masks.prompts import Points
from mgf_engine.masks.segmenters.efficientsam import POINT, EfficientSam
from mgf_engine.model.masks import BUILDING, FIRST_ELEMENT, IGNORE, building
from mgf_engine.model.pixels import pixel_at

LAST_ELEMENT = IGNORE - 1
_BILATERAL = 7, 30, 5  # diameter in px, and the sigmas in grey levels and px, of the filter before the segmentation
_FEWEST_PIXELS = 12  # of a segment, however small the building is in the photo
_RIM = 3  # px around a segment that its colour is compared with
_QUALITY_WEIGHT = 0.1  # of the model's own estimate, beside the share of the clicks that a mask holds


@dataclass(frozen=True)
class Element:
    """Pixels of one photo: a box of it, and which of the box's pixels, bool [h, w]."""

    box: tuple[slice, slice]
    mask: NDArray[np.bool_]


def add_elements(
    labels: NDArray[np.uint8],
    photo: NDArray[np.uint8],
    clicks: dict[str, Points],
    sam: EfficientSam | None,
    options: PartOptions = PartOptions(),
) -> tuple[NDArray[np.uint8], dict[int, str]]:
    """Return the label map with elements as labels from 2 on, and the user's names of clicked elements.

    Args:
        labels: level one [H, W].
        photo: RGB uint8 [H, W, 3].
        clicks: name of a part -> clicks; these take precedence over automatic segmentation.
        sam: prompted with a grid of points; None segments by colour.
        options: of the segmentation by colour, the grid of points, and the least size of an element.
    """
    inside = building(labels)
    if not inside.any():
        return labels, {}
    if sam is None:
        segments = segment_by_color(photo, inside, options)
        found = select_segments(photo, inside, segments, options)
        named = [(name, _clicked_segments(points, segments)) for name, points in sorted(clicks.items())]
    else:
        found = [Element((slice(None), slice(None)), mask) for mask in sam_elements(photo, inside, sam, options)]
        named = [(name, _sam_part(points, photo, inside, sam, options)) for name, points in sorted(clicks.items())]
    result = np.where(inside, BUILDING, labels).astype(np.uint8)
    number = FIRST_ELEMENT
    # Small ones are drawn over the large ones they lie on; named ones over all.
    largest = sorted(found, key=lambda e: -int(e.mask.sum()))
    for element in largest[: LAST_ELEMENT - FIRST_ELEMENT + 1 - len(named)]:
        result[element.box][element.mask & inside[element.box]] = number
        number += 1
    names: dict[int, str] = {}
    for name, mask in named:
        if mask.any():
            result[mask & inside] = number
            names[number] = name
            number += 1
    return _renumber(result, names)


def segment_by_color(
    photo: NDArray[np.uint8], inside: NDArray[np.bool_], options: PartOptions = PartOptions()
) -> NDArray[np.int32]:
    """Segment the building by colour (Felzenszwalb and Huttenlocher 2004): labels from 0, -1 outside, int32 [H, W]."""
    count, result = 0, np.full(inside.shape, -1, np.int32)
    around = _padded_box(inside, options.margin)
    held, building_here = np.ascontiguousarray(photo[around]), inside[around]
    lab = np.asarray(cv2.cvtColor(cv2.bilateralFilter(held, *_BILATERAL), cv2.COLOR_RGB2LAB))
    lab[~dilate(building_here, options.margin)] = 0  # one segment, quickly found
    smallest = max(_FEWEST_PIXELS, round(options.smallest * int(inside.sum())))
    graph = cv2.ximgproc.segmentation.createGraphSegmentation(options.sigma, options.scale, smallest)
    segments = graph.processImage(lab).astype(np.int32)
    segments[~building_here] = -1
    # A segment cut in two by the outline or an occluder is two segments.
    for value, box in _boxes(segments).items():
        pieces, here = cv2.connectedComponents((segments[box] == value).astype(np.uint8), connectivity=4)
        where = here > 0
        result[around][box][where] = here[where] - 1 + count
        count += pieces - 1
    return result


def select_segments(
    photo: NDArray[np.uint8],
    inside: NDArray[np.bool_],
    segments: NDArray[np.int32],
    options: PartOptions = PartOptions(),
) -> list[Element]:
    """Select the segments within the limits of size that contrast with their surroundings.

    Args:
        photo: RGB uint8 [H, W, 3].
        inside: the building, [H, W].
        segments: label of each pixel, [H, W]; -1 for none.
        options: limits of size and contrast.
    """
    around = _padded_box(inside, _RIM + 1)
    lab = rgb_to_lab(photo[around])
    total, sizes = int(inside.sum()), np.bincount(segments[segments >= 0])
    result = []
    for value, (rows, columns) in _boxes(segments).items():
        if not options.smallest * total <= sizes[value] <= options.largest * total:
            continue
        top, bottom = max(0, rows.start - _RIM - 1), rows.stop + _RIM + 1
        left, right = max(0, columns.start - _RIM - 1), columns.stop + _RIM + 1
        box = slice(top, bottom), slice(left, right)
        mask = segments[box] == value
        rim = dilate_square(mask, _RIM) & ~mask
        y, x = around[0].start, around[1].start
        patch = lab[top - y : bottom - y, left - x : right - x]
        if rim.any() and np.linalg.norm(patch[mask].mean(0) - patch[rim].mean(0)) < options.contrast:
            continue
        result.append(Element(box, mask))
    return result


def _padded_box(inside: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Return the box that holds the building and a margin, px."""
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    return (
        slice(max(0, int(rows[0]) - margin), int(rows[-1]) + 1 + margin),
        slice(max(0, int(columns[0]) - margin), int(columns[-1]) + 1 + margin),
    )


def sam_elements(
    photo: NDArray[np.uint8], inside: NDArray[np.bool_], sam: EfficientSam, options: PartOptions = PartOptions()
) -> list[NDArray[np.bool_]]:
    """Segment by a grid of point prompts, as SAM's automatic mask generator: by predicted quality, stability and size.

    Args:
        photo: RGB uint8 [H, W, 3].
        inside: bool [H, W], where the building is.
        sam: the model.
        options: of the grid, and when a mask is good enough.
    """
    embedding = sam.embed(photo)
    ys, xs = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    step = max(4.0, max(ys[-1] - ys[0], xs[-1] - xs[0]) / options.grid)
    grid = np.stack(np.meshgrid(np.arange(xs[0], xs[-1] + 1, step), np.arange(ys[0], ys[-1] + 1, step)), -1)
    grid = grid.reshape(-1, 2) + 0.5
    y, x = pixel_at(inside.shape, grid)
    total, found = int(inside.sum()), []
    for point in grid[inside[y, x]]:
        masks, quality = sam.predict(embedding, photo.shape[:2], point[None], np.array([POINT]))
        for logits, value in zip(masks, quality, strict=True):
            stability = (logits > 1).sum() / max(1, (logits > -1).sum())
            if value < options.quality or stability < options.stability:
                continue
            mask = cv2.resize(logits, (photo.shape[1], photo.shape[0]), interpolation=cv2.INTER_LINEAR) > 0
            mask &= inside
            if options.smallest * total <= mask.sum() <= options.largest * total:
                found.append((float(value), mask))
    kept: list[NDArray[np.bool_]] = []
    for _, mask in sorted(found, key=lambda f: -f[0]):
        if all((mask & other).sum() <= options.overlap * (mask | other).sum() for other in kept):
            kept.append(mask)
    return kept


def _clicked_segments(points: Points, segments: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the segments under the user's clicks, bool [H, W]."""
    hit = segments[pixel_at(segments.shape, points)]
    return np.isin(segments, hit[hit >= 0])


def _sam_part(
    points: Points, photo: NDArray[np.uint8], inside: NDArray[np.bool_], sam: EfficientSam, options: PartOptions
) -> NDArray[np.bool_]:
    """Return the model's answer to the user's clicks that holds most of them, bool [H, W]; no larger than allowed."""
    if not len(points):
        return np.zeros(inside.shape, bool)
    y, x = pixel_at(inside.shape, points)
    masks, quality = sam.predict(sam.embed(photo), photo.shape[:2], points, np.full(len(points), POINT))
    best, best_score = np.zeros(inside.shape, bool), -1.0
    for logits, value in zip(masks, quality, strict=True):
        mask = cv2.resize(logits, (photo.shape[1], photo.shape[0]), interpolation=cv2.INTER_LINEAR) > 0
        score = float(mask[y, x].mean()) + _QUALITY_WEIGHT * float(value)
        if mask.sum() <= options.largest * inside.sum() and score > best_score:
            best, best_score = mask & inside, score
    return best


def _boxes(segments: NDArray[np.int32]) -> dict[int, tuple[slice, slice]]:
    """Return bounding boxes of the values from 0 up."""
    return {value: box for value, box in enumerate(find_objects(segments + 1)) if box is not None}


def _renumber(labels: NDArray[np.uint8], names: dict[int, str]) -> tuple[NDArray[np.uint8], dict[int, str]]:
    """Renumber element ids, without gaps after drawing over each other."""
    table = np.arange(256, dtype=np.uint8)
    used = [int(v) for v in np.flatnonzero(np.bincount(labels.ravel())) if FIRST_ELEMENT <= v <= LAST_ELEMENT]
    for new, old in enumerate(used, FIRST_ELEMENT):
        table[old] = new
    return table[labels], {int(table[old]): name for old, name in names.items() if old in used}
