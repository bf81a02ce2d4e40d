# SPDX-License-Identifier: GPL-3.0-or-later
"""Farthest-point sampling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def farthest_point_sampling(features: NDArray[np.floating], count: int, first: Sequence[int]) -> list[int]:
    """Choose points one by one, each the farthest from all chosen before; ties go to the lower index.

    Fewer are among the first of more.

    Args:
        features: [N, D]; their Euclidean distance counts.
        count: how many to choose, with the first ones; at most N are.
        first: those that are chosen in any case, at least one.

    Returns:
        Indices in the order of choice, the first ones as given.
    """
    chosen = list(first)
    distance = np.full(len(features), np.inf)
    for index in chosen[:-1]:
        distance = np.minimum(distance, np.linalg.norm(features - features[index], axis=1))
    while len(chosen) < min(count, len(features)):
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return chosen
