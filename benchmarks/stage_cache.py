# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that runs have in common is done once: a shelf keeps the first stages of one run for the next of the same scene.

A shelf is a job folder without options. Which of its stages a run may use is the engine's own decision
(:class:`mgf_engine.job.Job` compares keys), so a variant never gets what its options would have changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from itertools import takewhile
from pathlib import Path
from typing import Any

from mgf_engine.config import as_dict, make_config, option_fields
from mgf_engine.stages import STAGES
from mgf_engine.system import write_json

Stages = dict[str, dict[str, Any]]
#: Stages that are kept; the mesh and the report are what a suite measures.
_FIRST = tuple(takewhile(lambda stage: stage.name != "mesh", STAGES))
KEPT = tuple(stage.name for stage in _FIRST)
_LATE = {section for stage in STAGES if stage not in _FIRST for section in stage.sections}


def lend(shelf: Path, job: Path) -> Stages:
    """Copy a shelf's stages into a job folder that does not exist yet; what they cost, empty without a shelf.

    A run whose own shelf (last part of the path: its seed) is missing takes what another seed left beside it.
    """
    found = next((path for path in (shelf, *sorted(shelf.parent.glob("*"))) if (path / "job.json").exists()), None)
    if found is None:
        return {}
    shutil.copytree(found, job)
    return stages_of(job)


def shelf_of(
    shelves: Path, scene: Path, masks: str, poses: str, seed: int, options: Mapping[str, Any] | None = None
) -> Path:
    """Where runs leave their stages that agree in these and in all ``options`` but those of the mesh and later."""
    config = as_dict(make_config(dict(options or {})))
    late = {f.name for f in option_fields() if f.metadata["section"] in _LATE} | {"preset"}
    kept = {name: value for name, value in sorted(config.items()) if name not in late}
    key = hashlib.sha256(json.dumps(kept).encode()).hexdigest()[:10]
    return shelves / f"{scene.name}-{poses}-{masks}" / f"seed{seed}-{key}"


def keep(job: Path, shelf: Path) -> None:
    """Make a shelf of a finished job, unless there is one."""
    if shelf.exists():
        return
    shelf.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=shelf.parent, prefix=".part-") as name:
        part = Path(name) / "job"
        part.mkdir()
        for output in (output for stage in _FIRST for output in stage.written):
            source = job / output
            if source.is_dir():
                shutil.copytree(source, part / output)
            elif source.exists():
                shutil.copy2(source, part / output)
        record = json.loads((job / "job.json").read_text(encoding="utf-8"))
        record["given"] = {}
        record["stages"] = {name: entry for name, entry in record["stages"].items() if name in KEPT}
        write_json(part / "job.json", record)
        if not shelf.exists():
            os.rename(part, shelf)


def saved(lent: Stages, job: Path) -> dict[str, float]:
    """What the stages cost that a finished job took from its shelf: ``seconds``, ``cpu_seconds``, ``peak_memory``."""
    stages = stages_of(job)
    used = [entry for name, entry in lent.items() if stages.get(name) == entry]
    return {
        "seconds": sum(entry["seconds"] for entry in used),
        "cpu_seconds": sum(entry["cpu_seconds"] for entry in used),
        "peak_memory": max((float(entry["peak_memory"]) for entry in used), default=0.0),
    }


def stages_of(job: Path) -> Stages:
    """Return the record of a job's finished stages."""
    stages: Stages = json.loads((job / "job.json").read_text(encoding="utf-8"))["stages"]
    return stages
