# SPDX-License-Identifier: GPL-3.0-or-later
"""How much memory tile lists get before anybody knows how long they are.

The number of entries is found on the card; to wait for it in every training iteration would leave the card idle. So
the host takes room from what earlier renderings of as many tiles needed, and looks at each number when it has arrived
by itself. A rendering that needs more than its room draws nothing and has no gradients (``kernels/cuda/lists.cu``); the
next has more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

_SPARE = 2.0  # times what was needed most
_LEAST = 1 << 14
MOST = 2**31 - 2  # entries have 32-bit numbers


@dataclass(frozen=True)
class _Asked:
    """A rendering whose need is on its way: what will tell (entries needed, entries listed), and what it was given."""

    answer: Callable[[], list[int] | None]
    room: int
    gaussians: int
    tiles: int


class Room:
    """Chooses the room of renderings that do not wait.

    Attributes:
        lost: renderings so far that drew nothing for want of room.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._per_gaussian: dict[int, float] = {}  # most entries a Gaussian needed, by number of tiles
        self._asked: list[_Asked] = []

    def take(self, gaussians: int, tiles: int) -> int:
        """Room for a rendering of so many Gaussians into so many tiles; 0: not known, wait."""
        self._look()
        if tiles not in self._per_gaussian:
            return 0
        return min(max(int(_SPARE * self._per_gaussian[tiles] * gaussians), _LEAST), MOST)

    def learn(self, needed: int, gaussians: int, tiles: int) -> None:
        """A rendering of so many Gaussians into so many tiles needed so many entries."""
        before = self._per_gaussian.get(tiles, 0.0)
        self._per_gaussian[tiles] = max(before, needed / max(gaussians, 1))

    def learn_later(self, answer: Callable[[], list[int] | None], room: int, gaussians: int, tiles: int) -> None:
        """A rendering was started with ``room``; ``answer`` will tell (entries needed, entries listed)."""
        self._asked.append(_Asked(answer, room, gaussians, tiles))

    def _look(self) -> None:
        while self._asked:
            first = self._asked[0]
            found = first.answer()
            if found is None:
                return
            self._asked.pop(0)
            self.lost += found[0] > first.room
            self.learn(found[0], first.gaussians, first.tiles)
