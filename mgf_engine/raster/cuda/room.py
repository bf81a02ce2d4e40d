# SPDX-License-Identifier: GPL-3.0-or-later
"""How much memory tile lists get before anybody knows how long they are.

The number of entries is found on the card; to wait for it in every training iteration would leave the card idle. So
the host takes room from what earlier renderings needed, and looks at each number when it has arrived by itself. A
rendering that needs more than its room draws nothing and has no gradients (``kernels/cuda/lists.cu``); the next has
more.
"""

from __future__ import annotations

from collections.abc import Callable

_SPARE = 1.5  # times what was needed most
_LEAST = 1 << 16
MOST = 2**31 - 2  # entries have 32-bit numbers


class Room:
    """Chooses the room of renderings that do not wait.

    Attributes:
        entries: room of the next rendering; 0 when nothing is known yet, so that the first one has to wait.
        lost: renderings so far that drew nothing for want of room.
    """

    def __init__(self) -> None:
        self.entries = 0
        self.lost = 0
        self._per_gaussian = 0.0
        self._waiting: list[tuple[Callable[[], list[int] | None], int, int]] = []

    def take(self, gaussians: int) -> int:
        """Room for a rendering of so many Gaussians; 0: not known, wait."""
        self._look()
        self.entries = min(max(self.entries, int(_SPARE * self._per_gaussian * gaussians)), MOST)
        return self.entries

    def learn(self, needed: int, gaussians: int) -> None:
        """A rendering of so many Gaussians needed so many entries."""
        self._per_gaussian = max(self._per_gaussian, needed / max(gaussians, 1))
        self.entries = min(max(self.entries, int(_SPARE * needed), _LEAST), MOST)

    def learn_later(self, answer: Callable[[], list[int] | None], room: int, gaussians: int) -> None:
        """A rendering was started with ``room``; ``answer`` will tell (entries needed, entries listed)."""
        self._waiting.append((answer, room, gaussians))

    def _look(self) -> None:
        while self._waiting:
            answer, room, gaussians = self._waiting[0]
            found = answer()
            if found is None:
                return
            self._waiting.pop(0)
            self.lost += found[0] > room
            self.learn(found[0], gaussians)
