# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the pairs of photos to match in structure from motion: all, or sequential and most similar ones.

Similarity is that of VLAD vectors over the photos' own SIFT descriptors (Jegou et al. 2010), so that a walk
around a building closes its loop, and photos in no order at all still find each other, without a vocabulary file.
"""

from __future__ import annotations

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

#: Size of the VLAD vectors, descriptors of each photo, and those that the words are learnt from: enough to rank photos.
_WORDS, _PER_PHOTO, _TRAINING = 64, 600, 30_000


def choose_pairs(
    database: pycolmap.Database, ids: list[int], exhaustive: bool, seed: int, neighbours: int = 10, similar: int = 10
) -> list[tuple[int, int]]:
    """Choose the pairs of photos to match.

    Args:
        database: with the features of the photos.
        ids: image ids in the order of the photos' names.
        exhaustive: match every pair.
        seed: of the clustering.
        neighbours: number of following photos that each photo is matched with.
        similar: number of most similar photos that each photo is matched with.

    Returns:
        Sorted pairs of positions in ``ids``, the lower one first.
    """
    count = len(ids)
    if exhaustive:
        return [(i, j) for i in range(count) for j in range(i + 1, count)]
    pairs = {(i, j) for i in range(count) for j in range(i + 1, min(count, i + 1 + neighbours))}
    step = 2 * neighbours
    while step < count // 2:  # further and further neighbours tie the sequence together
        pairs |= {(i, i + step) for i in range(count - step)}
        step *= 2
    alike = similarities(vlad(database, ids, seed))
    np.fill_diagonal(alike, -np.inf)
    for i, row in enumerate(alike):
        pairs |= {(min(i, int(j)), max(i, int(j))) for j in np.argsort(-row, kind="stable")[:similar]}
    return sorted(pairs)


def vlad(database: pycolmap.Database, ids: list[int], seed: int) -> NDArray[np.float32]:
    """Compute a unit vector [64 * 128] per photo; zeros for photos without features."""
    random = np.random.default_rng(seed)
    samples = [_descriptors(database, image_id) for image_id in ids]
    everything = np.concatenate(samples)
    if len(everything) < _WORDS:
        return np.zeros((len(ids), _WORDS * 128), np.float32)
    chosen = random.permutation(len(everything))[:_TRAINING]
    words, _ = kmeans2(everything[chosen], _WORDS, iter=10, minit="points", rng=random)
    return np.stack([_vlad_of(sample, words.astype(np.float32)) for sample in samples])


def similarities(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the cosine similarity of every pair, [N, N]."""
    return vectors @ vectors.T


def _descriptors(database: pycolmap.Database, image_id: int) -> NDArray[np.float32]:
    """Read the descriptors of the photo's largest features, float32 [N, 128] in 0..1."""
    if not database.exists_descriptors(image_id) or not database.exists_keypoints(image_id):
        return np.empty((0, 128), np.float32)
    data = np.asarray(database.read_descriptors(image_id).data)
    shape = np.asarray(database.read_keypoints(image_id))  # x, y and the affine shape, or x, y, scale, orientation
    scale = np.hypot(shape[:, 2], shape[:, -2]) if shape.shape[1] == 6 else shape[:, 2]
    order = np.argsort(-scale, kind="stable")[:_PER_PHOTO]
    return data[order].astype(np.float32) / 512.0


def _vlad_of(sample: NDArray[np.float32], words: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the VLAD vector of descriptors [N, 128] over visual words [64, 128], unit [64 * 128]."""
    result = np.zeros_like(words)
    if len(sample):
        distance = (words**2).sum(1) - 2.0 * sample @ words.T
        nearest = distance.argmin(1)
        np.add.at(result, nearest, sample - words[nearest])
    result /= np.linalg.norm(result, axis=1, keepdims=True) + 1e-9  # within a word: bursts count once
    flat = result.ravel()
    return flat / (np.linalg.norm(flat) + 1e-9)
