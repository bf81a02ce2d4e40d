# SPDX-License-Identifier: GPL-3.0-or-later
"""Write and read fields, and checkpoints from which training resumes with the same result."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mgf_engine.errors import BadInput
from mgf_engine.field.optimiser import Optimiser
from mgf_engine.files.atomic import atomic_path
from mgf_engine.files.safe_npz import read_arrays
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.raster.api import RenderStats
from mgf_engine.raster.cuda.tile_list_capacity import TileListCapacity

_NAMES = tuple(f.name for f in fields(Gaussians))
_STATS = tuple(f.name for f in fields(RenderStats))
_UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)


@dataclass
class Checkpoint:
    """State of the training: field and moments, statistics since the last densification, next iteration, figures."""

    optimiser: Optimiser
    stats: RenderStats
    iteration: int
    figures: dict[str, Any]


def write_field(field: Gaussians, path: Path) -> None:
    """Write a field (normalised frame) as an npz archive."""
    arrays = {name: getattr(field, name).detach().cpu().numpy() for name in _NAMES}
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)


def read_field(path: Path) -> Gaussians:
    """Read a field written by :func:`write_field`.

    Raises:
        BadInput: the file is missing or damaged.
    """
    try:
        return _field_of(read_arrays(path), "")
    except _UNREADABLE as error:
        raise BadInput(f"The field '{path}' is missing or damaged; run 'mgf field' again.") from error


def write_checkpoint(checkpoint: Checkpoint, path: Path) -> None:
    """Write a checkpoint atomically."""
    optimiser = checkpoint.optimiser
    arrays = {"field." + name: getattr(optimiser.field, name).detach().cpu().numpy() for name in _NAMES}
    for name, (first, second) in optimiser.moments.items():
        arrays["first." + name], arrays["second." + name] = first.cpu().numpy(), second.cpu().numpy()
    arrays |= {"stats." + name: getattr(checkpoint.stats, name).cpu().numpy() for name in _STATS}
    state = {"iteration": checkpoint.iteration, "step_count": optimiser.step_count, "figures": checkpoint.figures}
    arrays["state"] = np.frombuffer(json.dumps(state).encode(), np.uint8)
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)


def read_checkpoint(path: Path) -> Checkpoint | None:
    """Read the checkpoint at ``path``, or None when there is none or it is damaged (training then starts over).

    Raises:
        ValueError: the file is of another format.
    """
    if not path.exists():
        return None
    try:
        data = read_arrays(path)
        state = json.loads(data["state"].tobytes())
        optimiser = Optimiser(_field_of(data, "field."))
        for name in optimiser.moments:
            pair = (_tensor(data["first." + name]), _tensor(data["second." + name]))
            if any(m.shape != getattr(optimiser.field, name).shape or not m.isfinite().all() for m in pair):
                raise ValueError(name)
            optimiser.moments[name] = pair
        optimiser.step_count, iteration = _count(state["step_count"]), _count(state["iteration"])
        return Checkpoint(optimiser, _stats_of(data, len(optimiser.field)), iteration, _figures_of(state["figures"]))
    except _UNREADABLE:
        return None


def _stats_of(data: dict[str, np.ndarray], count: int) -> RenderStats:
    stats = RenderStats(**{name: torch.from_numpy(data["stats." + name]) for name in _STATS})
    for value, fresh in zip(stats.all, RenderStats.zeros(count).all, strict=True):
        if value.shape != fresh.shape or value.dtype != fresh.dtype or not value.isfinite().all():
            raise ValueError("stats")
    return stats


def _figures_of(figures: Any) -> dict[str, Any]:
    """Return the figures so far, of the types the trainer goes on with."""
    _count(figures["start_gaussians"])
    seconds, curve = figures["seconds"], figures["curve"]
    if not all(isinstance(name, str) and isinstance(value, int | float) for name, value in seconds.items()):
        raise ValueError("seconds")
    if not all(isinstance(point["psnr"], int | float) for point in curve):
        raise ValueError("curve")
    TileListCapacity().restore(figures.get("tile_list_capacity"))
    return dict(figures)


def _count(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 1 << 40:
        raise ValueError(f"{value!r:.40} is no count")
    return value


def _field_of(data: Any, prefix: str) -> Gaussians:
    field = Gaussians(**{name: _tensor(data[prefix + name]) for name in _NAMES})
    count = len(field)
    shapes = {"positions": (3,), "log_scales": (3,), "rotations": (4,), "opacity_logits": (), "sh": (16, 3)}
    for name in _NAMES:
        value = getattr(field, name)
        if tuple(value.shape) != (count, *shapes.get(name, ())) or not bool(torch.isfinite(value).all()):
            raise ValueError(f"bad {name}")
    return field


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
