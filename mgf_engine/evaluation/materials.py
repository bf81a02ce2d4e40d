# SPDX-License-Identifier: GPL-3.0-or-later
"""The material of each face of a true mesh, where it is known.

Beside a true mesh ``truth.ply`` lie ``truth_materials.json``, a list of names, and ``truth_materials.npy``, for each
face of the mesh, in its order, an index into that list. Scenes of the benchmark have both.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mgf_engine.errors import BadInput, reason


@dataclass(frozen=True)
class Materials:
    """Names, and for each face of a mesh an index into them, int64 [F]."""

    names: tuple[str, ...]
    faces: NDArray[np.int64]


def read_materials(truth: Path, faces: int) -> Materials | None:
    """Read the materials beside a true mesh; None where there are none.

    Args:
        faces: how many faces the mesh has.

    Raises:
        BadInput: one of the files is missing or damaged, or they are not those of this mesh.
    """
    listed, of_faces = (truth.with_name(f"{truth.stem}_materials.{end}") for end in ("json", "npy"))
    if not listed.exists() and not of_faces.exists():
        return None
    try:
        names = json.loads(listed.read_text(encoding="utf-8"))
        index = np.load(of_faces, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise BadInput(
            f"Cannot read the materials of '{truth}' ({reason(error)}); write '{listed.name}' and '{of_faces.name}' "
            "again, or remove both."
        ) from error
    named = isinstance(names, list) and all(isinstance(name, str) for name in names)
    fits = index.shape == (faces,) and index.dtype.kind in "iu"
    if not named or not fits or index.min() < 0 or index.max() >= len(names):
        raise BadInput(
            f"The materials beside '{truth}' are not those of its {faces} faces; write '{listed.name}' and "
            f"'{of_faces.name}' again, or remove both."
        )
    return Materials(tuple(names), index.astype(np.int64))
