# SPDX-License-Identifier: GPL-3.0-or-later
"""Read ``models.json``, the list of what ``mgf models`` made."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..common.errors import UserError

FOLDER, FILE = "models", "models.json"


@dataclass(frozen=True)
class Levels:
    """The levels of detail of a job.

    Attributes:
        files: GLB of each level, the finest first.
        to_scene: float64 [4, 4], their coordinates -> those of the job's scene.
    """

    files: tuple[Path, ...]
    to_scene: np.ndarray


def read_levels(job: Path) -> Levels:
    """Read the levels of detail in a job folder.

    Raises:
        UserError: there are none, or the file cannot be used.
    """
    path = job / FOLDER / FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        levels = [(int(f["level"]), name) for name, f in dict(data["files"]).items() if f.get("kind") == "lod"]
        to_scene = np.array(data["to_scene"], np.float64)
        if to_scene.shape != (4, 4) or not np.isfinite(to_scene).all():
            raise ValueError("to_scene")
    except FileNotFoundError as error:
        raise UserError("The job has no models; press Make Models first.") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise UserError("'{path}' cannot be read; make the models again.", path=path) from error
    files = [path.parent / name for _, name in sorted(levels) if Path(name).name == name]
    missing = next((file.name for file in files if not file.is_file()), "mesh_lod0.glb" if not files else None)
    if missing is not None:
        raise UserError("The models lack '{name}'; choose Levels of Detail and make them again.", name=missing)
    return Levels(tuple(files), to_scene)
