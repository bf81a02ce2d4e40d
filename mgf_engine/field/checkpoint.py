# SPDX-License-Identifier: GPL-3.0-or-later
"""The field on disk: the finished field, and checkpoints from which training goes on as if never stopped."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mgf_engine.errors import BadInput
from mgf_engine.field.gaussians import Gaussians
from mgf_engine.field.optimiser import Optimiser
from mgf_engine.raster.api import RenderStats
from mgf_engine.system import atomic_path

_NAMES = tuple(f.name for f in fields(Gaussians))
_STATS = tuple(f.name for f in fields(RenderStats))
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, json.JSONDecodeError)


@dataclass
class Checkpoint:
    """Where training stands: field and moments, statistics since the last round, next iteration, figures so far."""

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
        with np.load(path, allow_pickle=False) as data:
            return _field_of(data, "")
    except _UNREADABLE as error:
        raise BadInput(f"The field '{path}' is missing or damaged; run 'mgf field' again.") from error


def write_checkpoint(checkpoint: Checkpoint, path: Path) -> None:
    """Write a checkpoint; a kill leaves the old one or the new one."""
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
    """The checkpoint at ``path``, or None when there is none or it is damaged (training then starts over)."""
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            state = json.loads(data["state"].tobytes())
            optimiser = Optimiser(_field_of(data, "field."))
            for name in optimiser.moments:
                pair = (_tensor(data["first." + name]), _tensor(data["second." + name]))
                if any(m.shape != getattr(optimiser.field, name).shape for m in pair):
                    raise ValueError(name)
                optimiser.moments[name] = pair
            optimiser.step_count = int(state["step_count"])
            stats = RenderStats(**{name: torch.from_numpy(data["stats." + name].copy()) for name in _STATS})
            if any(value.shape != (len(optimiser.field),) for value in stats.all):
                raise ValueError("stats")
            return Checkpoint(optimiser, stats, int(state["iteration"]), dict(state["figures"]))
    except _UNREADABLE:
        return None


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
