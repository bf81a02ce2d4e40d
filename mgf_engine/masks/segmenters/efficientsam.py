# SPDX-License-Identifier: GPL-3.0-or-later
"""EfficientSAM through ONNX Runtime: one embedding per photo, many cheap prompts on it.

The model takes at most six points (more are silently dropped) and was not trained on negative ones. Several prompts of
up to six points are tried; negative clicks and rejected points enter only the score that selects among the candidates.
"""

from __future__ import annotations

import hashlib
import logging
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.atomic import atomic_path
from mgf_engine.files.safe_npz import read_array
from mgf_engine.masks.segmenters.base import Hints, Points, Segment, agreement
from mgf_engine.masks.segmenters.network import Network
from mgf_engine.masks.segmenters.random_walker import MaskDrawingOptions, clean

#: The graph resizes to 1024 x 1024 itself; larger photos only cost memory.
LONGEST_SIDE = 1024
MAX_POINTS = 6
POINT, BOX_START, BOX_END = 1.0, 2.0, 3.0
ENCODER_INPUT, ENCODER_OUTPUT = "batched_images", "image_embeddings"
DECODER_INPUTS = ("image_embeddings", "batched_point_coords", "batched_point_labels", "orig_im_size")
DECODER_OUTPUTS = ("output_masks", "iou_predictions")
EMBEDDING = (1, 256, 64, 64)
NO_POINT = -1.0  # label, and both coordinates, of the model's own padding

log = logging.getLogger("mgf")


class EfficientSam:
    """The segmenter; safe to call from several threads.

    Args:
        encoder, decoder: ONNX files, see :mod:`mgf_engine.weights`.
        cache: folder for embeddings, kept between runs; 2 MB per photo.
        threads: of ONNX Runtime.
        gpu: use a GPU provider where ONNX Runtime offers one.
        warn: called with one sentence when such a provider fails and the CPU goes on.
        options: which specks and holes are removed from its masks.

    Raises:
        BadInput: a file is no ONNX model or not EfficientSAM.
    """

    name = "efficientsam"

    def __init__(
        self, encoder: Path, decoder: Path, cache: Path, threads: int = 0, gpu: bool = True,
        warn: Callable[[str], None] = log.warning, options: MaskDrawingOptions = MaskDrawingOptions(),
    ) -> None:  # fmt: skip
        self._encoder = Network(encoder, threads, gpu, {ENCODER_INPUT}, {ENCODER_OUTPUT}, warn)
        self._decoder = Network(decoder, threads, gpu, set(DECODER_INPUTS), set(DECODER_OUTPUTS), warn)
        self._model = f"{encoder.name}:{encoder.stat().st_size}"
        self._cache, self._options = cache, options
        self._encoding = threading.Lock()  # one image at a time bounds the memory

    def segment(self, photo: NDArray[np.uint8], hints: Hints, attempt: int = 0) -> Segment:
        """See :class:`mgf_engine.masks.segmenters.base.Segmenter`; a second attempt asks with other points.

        Args:
            photo: RGB uint8 [H, W, 3].
            hints: clicks and points on the building and beside it.
            attempt: 0 for the first; a further one starts from other points.
        """
        size = (photo.shape[0], photo.shape[1])
        best = Segment(np.zeros(size, bool), 0.0)
        prompts = list(point_prompts(hints, attempt))
        if not prompts:
            return best  # the encoder takes seconds
        embedding = self.embed(photo)
        best_score = -1.0
        for points, labels in prompts:
            masks, _ = self.predict(embedding, size, points, labels)
            for logits in masks:
                mask = clean(_enlarge(logits, size) > 0, hints, self._options)
                score = agreement(mask, hints)
                if score > best_score:
                    best, best_score = Segment(mask, score), score
        return best

    def embed(self, photo: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the embedding [1, 256, 64, 64] of a photo RGB uint8 [H, W, 3], from the cache where it is.

        Raises:
            BadInput: the encoder answers in another shape than EfficientSAM's.
        """
        key = hashlib.sha256(self._model.encode() + str(photo.shape).encode() + photo.tobytes()).hexdigest()[:24]
        path = self._cache / f"{key}.npy"
        try:
            kept = read_array(path)
            if kept.shape == EMBEDDING:
                return kept.astype(np.float32)
        except (OSError, ValueError):
            pass
        height, width = _reduced(photo.shape[0], photo.shape[1])
        small = cv2.resize(photo, (width, height), interpolation=cv2.INTER_AREA)
        image = np.ascontiguousarray(small.transpose(2, 0, 1)[None], np.float32) / np.float32(255)
        with self._encoding:
            embedding = self._encoder.run((ENCODER_OUTPUT,), {ENCODER_INPUT: image})[0]
        if embedding.shape != EMBEDDING:
            raise self._encoder.refusal(f"its embeddings have the shape {embedding.shape}")
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.save(stream, embedding.astype(np.float16), allow_pickle=False)
        return embedding.astype(np.float16).astype(np.float32)

    def predict(
        self, embedding: NDArray[np.float32], size: tuple[int, int], points: Points, labels: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Predict candidate masks for up to six points.

        Args:
            embedding: [1, 256, 64, 64].
            size: height and width of the photo the points are in.
            points: [N, 2] pixels; labels: [N], 1 point, 2 and 3 box corners.

        Returns:
            Logits [3, h, w] on the reduced photo (above 0 is inside), and the model's own quality estimates [3].

        Raises:
            BadInput: the decoder answers in another shape than EfficientSAM's.
        """
        height, width = _reduced(*size)
        scaled = points[:MAX_POINTS] * (width / size[1], height / size[0])
        wanted = self._decoder.fixed("batched_point_coords", 2) or len(scaled)
        feed: dict[str, NDArray[Any]] = {
            "image_embeddings": embedding,
            "batched_point_coords": _padded(scaled, wanted)[None, None],
            "batched_point_labels": _padded(labels[:MAX_POINTS], wanted)[None, None],
            "orig_im_size": np.array([height, width], np.int64),
        }
        masks, quality = self._decoder.run(DECODER_OUTPUTS, feed)
        if masks.ndim < 3 or 0 in masks.shape or masks.size // (masks.shape[-1] * masks.shape[-2]) != quality.size:
            raise self._decoder.refusal(f"its masks have the shape {masks.shape} and its scores {quality.shape}")
        return masks.reshape(-1, *masks.shape[-2:]), quality.reshape(-1)


def point_prompts(hints: Hints, attempt: int) -> Iterator[tuple[Points, NDArray[np.float64]]]:
    """Yield prompts of at most six points: the clicks; the box with four points spread out; twice six such points."""
    if len(hints.positive):
        chosen = sample_spread_points(hints.positive, MAX_POINTS, attempt)
        yield chosen, np.full(len(chosen), POINT)
    accepted = hints.accepted if len(hints.accepted) else hints.positive
    if not len(accepted):
        return
    if hints.box is not None:
        corners = np.array(hints.box).reshape(2, 2)
        chosen = sample_spread_points(accepted, MAX_POINTS - 2, attempt)
        labels = np.concatenate([[BOX_START, BOX_END], np.full(len(chosen), POINT)])
        yield np.concatenate([corners, chosen]), labels
    for start in (2 * attempt, 2 * attempt + 1):
        chosen = sample_spread_points(accepted, MAX_POINTS, 2 * start + 1)
        yield chosen, np.full(len(chosen), POINT)


def sample_spread_points(points: Points, count: int, skip: int = 0) -> Points:
    """Choose ``count`` of points [N, 2] by farthest-point sampling that leaves out the farthest 3 % as outliers.

    It starts at the point nearest to the median, or with ``skip`` that many sixteenths of the points farther away.
    """
    if len(points) <= count and not skip:
        return points
    gap = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    chosen = [int(np.argsort(gap, kind="stable")[min(skip * max(1, len(points) // 16), len(points) - 1)])]
    gap = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argsort(gap, kind="stable")[int(0.97 * (len(points) - 1))]))
        gap = np.minimum(gap, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]


def _reduced(height: int, width: int) -> tuple[int, int]:
    factor = min(1.0, LONGEST_SIDE / max(height, width))
    return max(1, round(height * factor)), max(1, round(width * factor))


def _enlarge(logits: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    if logits.shape == size:
        return logits
    return cv2.resize(logits, (size[1], size[0]), interpolation=cv2.INTER_LINEAR).astype(np.float32)


def _padded(rows: NDArray[np.floating], count: int) -> NDArray[np.float32]:
    """Return points or labels as a decoder with a fixed number of points takes them; the rest is the model's own
    padding."""
    result = np.full((count, *rows.shape[1:]), NO_POINT, np.float32)
    result[: len(rows)] = rows[:count]
    return result
