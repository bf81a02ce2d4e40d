# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the device (CPU or CUDA) of training and rendering, and explain the choice."""

from __future__ import annotations

import shutil
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
        device: ``cpu`` or the GPU.
        text: one sentence that says what was chosen and why.
        surprising: the machine has a GPU that torch sees, and still it is not used.
    """

    device: torch.device
    text: str
    surprising: bool = False


@cache
def choose_device(wanted: str) -> Choice:
    """Choose the device for ``--device auto``, ``cpu`` or ``cuda``; the same answer all through the process.

    Raises:
        BadInput: ``cuda``, and no GPU can be used; one sentence says why.
    """
    if wanted == "cpu":
        return Choice(torch.device("cpu"), "Device: CPU, as asked for.")
    from mgf_engine.native.cuda.checked_gpus import is_approved
    from mgf_engine.native.cuda.gpu import find_gpu

    try:
        found = find_gpu()
    except BadInput as error:
        if wanted == "cuda":
            raise BadInput(f"{error} Or train without a GPU: --device cpu.") from error
        if not torch.cuda.is_available() and shutil.which("nvidia-smi") is None:  # nothing that one could mend
            return Choice(torch.device("cpu"), "Device: CPU; no NVIDIA driver was found.")
        return Choice(torch.device("cpu"), f"Device: CPU. {error}", torch.cuda.is_available())
    if wanted == "auto" and not is_approved(found):
        text = (
            f"Device: CPU. Found the GPU {found.name}: run 'mgf doctor --gpu' (a minute) so that auto uses it, "
            "or use it unchecked by '--device cuda'."
        )
        return Choice(torch.device("cpu"), text, surprising=True)
    memory = f"{found.memory / 2**30:.0f} GiB"
    why = "as asked for" if wanted == "cuda" else "because it passed the check"
    return Choice(torch.device("cuda", 0), f"Device: {found.name}, {memory}, {why}.")


def each_view(
    work: Callable[[int], T], views: Iterable[int], device: torch.device, bytes_each: float = 0.0
) -> Iterator[T]:
    """Do the work of each view and yield the results in order: in parallel on the CPU, one after another on a GPU.

    Args:
        work: index of a view -> result.
        views: indices.
        device: that the work runs on; a GPU has one queue.
        bytes_each: as :func:`mgf_engine.native.parallel.parallel_map` takes it.
    """
    return parallel_map(work, views, bytes_each=bytes_each) if device.type == "cpu" else map(work, views)


def lost_renderings(device: torch.device) -> int:
    """Return the number of renderings on a GPU so far that drew nothing, since their tile lists were too short."""
    capacity = _capacity(device)
    return 0 if capacity is None else capacity.lost


def capacity_state(device: torch.device) -> dict[str, Any] | None:
    """Return the state of the tile-list capacity as plain numbers, for a checkpoint; None on the CPU."""
    capacity = _capacity(device)
    return None if capacity is None else capacity.state()


def restore_capacity(device: torch.device, state: dict[str, Any] | None) -> None:
    """Restore the tile-list capacity from :func:`capacity_state`; None starts it anew."""
    capacity = _capacity(device)
    if capacity is not None:
        capacity.restore(state)


def _capacity(device: torch.device) -> TileListCapacity | None:
    backend = "cuda" if device.type == "cuda" else CPU_BACKEND
    if backend == "cpu":
        return None
    from mgf_engine.raster.cuda import rasterizer_on

    return rasterizer_on(backend).capacity
