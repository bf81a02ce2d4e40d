# SPDX-License-Identifier: GPL-3.0-or-later
"""Which device the field is trained and rendered on, and why that one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import torch
from torch import Tensor

from mgf_engine.errors import BadInput
from mgf_engine.native.parallel import parallel_map

if TYPE_CHECKING:
    from mgf_engine.raster.cuda.tile_list_capacity import TileListCapacity

T = TypeVar("T")

#: What draws Gaussians that lie on the CPU; tests put the CUDA sources here.
CPU_BACKEND = "cpu"


def backend_for(tensor: Tensor, wanted: str | None = None) -> str:
    """Return the name of the backend that works where a tensor lies, unless one is wanted."""
    return wanted or ("cuda" if tensor.is_cuda else CPU_BACKEND)


@dataclass(frozen=True)
class Choice:
    """The device that was chosen.

    Attributes:
        device: ``cpu`` or the card.
        text: one sentence that says what was chosen and why.
        surprising: the machine has a card that torch sees, and still it is not used.
    """

    device: torch.device
    text: str
    surprising: bool = False


@cache
def choose_device(wanted: str) -> Choice:
    """Choose the device for ``--device auto``, ``cpu`` or ``cuda``; the same answer all through the process.

    Raises:
        BadInput: ``cuda``, and no card can be used; one sentence says why.
    """
    if wanted == "cpu":
        return Choice(torch.device("cpu"), "Device: CPU, as asked for.")
    from mgf_engine.native.cuda.card import find_card
    from mgf_engine.native.cuda.checked_cards import is_approved

    try:
        found = find_card()
    except BadInput as error:
        if wanted == "cuda":
            raise BadInput(f"{error} Or train without a card: --device cpu.") from error
        return Choice(torch.device("cpu"), f"Device: CPU. {error}", torch.cuda.is_available())
    if wanted == "auto" and not is_approved(found):
        text = (
            f"Device: CPU. Found the card {found.name}: run 'mgf doctor --card' (a minute) so that auto uses it, "
            "or use it unchecked by '--device cuda'."
        )
        return Choice(torch.device("cpu"), text, surprising=True)
    memory = f"{found.memory / 2**30:.0f} GiB"
    why = "as asked for" if wanted == "cuda" else "because it passed the check"
    return Choice(torch.device("cuda", 0), f"Device: {found.name}, {memory}, {why}.")


def each_view(
    work: Callable[[int], T], views: Iterable[int], device: torch.device, bytes_each: float = 0.0
) -> Iterator[T]:
    """``work`` of each view, in order: side by side on the CPU, one after another on a card, which has one queue.

    Args:
        bytes_each: as :func:`mgf_engine.native.parallel.parallel_map` takes it.
    """
    return parallel_map(work, views, bytes_each=bytes_each) if device.type == "cpu" else map(work, views)


def rendered_nothing(device: torch.device) -> int:
    """Renderings on a card so far that drew nothing, because their lists had less room than they needed."""
    room = _room(device)
    return 0 if room is None else room.lost


def room_state(device: torch.device) -> dict[str, Any] | None:
    """Return the state of the tile-list capacity as plain numbers, for a checkpoint; None on the CPU."""
    room = _room(device)
    return None if room is None else room.state()


def restore_room(device: torch.device, state: dict[str, Any] | None) -> None:
    """Begin with the room that :func:`room_state` told of; None: as the first run of a process."""
    room = _room(device)
    if room is not None:
        room.restore(state)


def _room(device: torch.device) -> TileListCapacity | None:
    backend = "cuda" if device.type == "cuda" else CPU_BACKEND
    if backend == "cpu":
        return None
    from mgf_engine.raster.cuda import rasterizer_on

    return rasterizer_on(backend).room
