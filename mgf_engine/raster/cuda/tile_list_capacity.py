# SPDX-License-Identifier: GPL-3.0-or-later
"""Predict the capacity of tile lists on the GPU, before their length is known.

The number of entries is computed on the GPU; waiting for it in the same iteration would leave the GPU idle. The host
predicts the capacity instead, from the entries that earlier renderings with the same number of tiles needed. A
rendering that needs more draws nothing and has no gradients (``csrc/cuda/lists.cu``); the next but one gets more.

A prediction uses the results of all earlier renderings but the last, whether or not that has arrived: the same
iterations are lost in every run with one seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mgf_engine.raster.cpu import MAX_ENTRIES

_SPARE = 2.0  # times what was needed most
_KEPT = 0.999  # of that, from one rendering to the next: a photo comes again within some hundred, and half is spare
_STEP = 1 << 14  # capacities are multiples of it, so that memory of one iteration fits the next
_AHEAD = 1  # number of last renderings whose results are not used


@dataclass(frozen=True)
class _Asked:
    """A rendering that was started: a function that waits for (entries needed, entries listed), and its capacity."""

    answer: Callable[[], Sequence[int]]
    capacity: int
    gaussians: int
    tiles: int

    @property
    def needed(self) -> int:
        """Number of entries needed; waits for it."""
        return self.answer()[0]


class TileListCapacity:
    """Predicts the capacity of renderings that do not wait; others neither use nor change it."""

    def __init__(self) -> None:
        self._lost = 0
        self._per_gaussian: dict[int, float] = {}  # entries that a Gaussian needs at most, by number of tiles
        self._asked: list[_Asked] = []

    @property
    def lost(self) -> int:
        """Number of renderings so far that drew nothing for lack of capacity; waits for those in progress."""
        return self._lost + sum(asked.needed > asked.capacity for asked in self._asked)

    def take(self, gaussians: int, tiles: int) -> int:
        """Return the capacity of the lists for a rendering of N Gaussians into T tiles; 0: not known, wait."""
        self._collect_results()
        if tiles not in self._per_gaussian:
            return 0
        steps = int(_SPARE * self._per_gaussian[tiles] * gaussians) // _STEP + 1
        return min(steps * _STEP, MAX_ENTRIES)

    def learn(self, needed: int, gaussians: int, tiles: int) -> None:
        """Learn how many entries a rendering of N Gaussians into T tiles needed."""
        before = self._per_gaussian.get(tiles, 0.0)
        self._per_gaussian[tiles] = max(_KEPT * before, needed / max(gaussians, 1))

    def learn_later(self, answer: Callable[[], Sequence[int]], capacity: int, gaussians: int, tiles: int) -> None:
        """Learn from a rendering that was started, when its result is there.

        Args:
            answer: waits for entries needed and entries listed.
            capacity: of its lists, entries.
            gaussians: their number.
            tiles: their number.
        """
        self._asked.append(_Asked(answer, capacity, gaussians, tiles))

    def state(self) -> dict[str, Any]:
        """Return all it knows, as plain numbers for a checkpoint; waits for answers that are on their way."""
        asked = [[a.needed, a.capacity, a.gaussians, a.tiles] for a in self._asked]
        return {"per_gaussian": list(map(list, self._per_gaussian.items())), "asked": asked, "lost": self._lost}

    def restore(self, state: dict[str, Any] | None = None) -> None:
        """Go on from a state; None: from nothing, as a run does that is to be like the first one of a process.

        Raises:
            ValueError, TypeError, KeyError, OverflowError: it is no such state; nothing is changed.
        """
        found = state or {"per_gaussian": [], "asked": [], "lost": 0}
        most = {int(tiles): float(entries) for tiles, entries in found["per_gaussian"]}
        asked = [[int(number) for number in numbers] for numbers in found["asked"]]
        possible = all(0 <= entries <= MAX_ENTRIES for entries in most.values())
        if not possible or any(len(numbers) != 4 for numbers in asked):
            raise ValueError("no state of a tile-list capacity")
        self._lost, self._per_gaussian = int(found["lost"]), most
        self._asked = [_Asked(partial(tuple, numbers[:1]), *numbers[1:]) for numbers in asked]

    def _collect_results(self) -> None:
        """Learn from all results but the last.

        Waiting for them does not leave the GPU idle: the host is a rendering and its gradients ahead, which the GPU
        computes meanwhile.
        """
        while len(self._asked) > _AHEAD:
            first = self._asked.pop(0)
            self._lost += first.needed > first.capacity
            self.learn(first.needed, first.gaussians, first.tiles)
