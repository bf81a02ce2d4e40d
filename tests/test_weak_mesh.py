# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh that the photos hardly confirm is not handed over in silence."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mgf_engine.messages import Reporter
from mgf_engine.model.mesh import Mesh
from mgf_engine.model.scene import Similarity
from mgf_engine.options.config import make_config
from mgf_engine.runners import mesh as mesh_runner


@pytest.mark.parametrize(
    ("confidence", "said"),
    [
        ([0.2] * 3, True),
        ([0.49] * 3, True),
        ([0.52] * 3, True),  # nowhere do the photos agree
        ([0.52, 0.52, 0.7], True),  # they agree on a third of it
        ([0.52, 0.6, 0.6], False),
        ([0.7] * 3, False),
    ],
)
def test_a_weak_mesh_is_spoken_of(
    confidence: list[float], said: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))
    mesh.values.update(confidence=np.array(confidence, np.float32), views=np.array([0, 3, 4], np.int32))
    scene = SimpleNamespace(to_normalised=Similarity(1.0, np.eye(3), np.zeros(3)))
    monkeypatch.setattr(mesh_runner, "load_inputs", lambda job: (scene, None))
    monkeypatch.setattr(mesh_runner, "load_field", lambda job: None)
    monkeypatch.setattr(mesh_runner, "extract_mesh", lambda *args: mesh)
    monkeypatch.setattr(mesh_runner, "named_parts", lambda *args: {})
    job = SimpleNamespace(path=lambda *parts: tmp_path.joinpath(*parts), config=make_config({}))
    reporter = Reporter()
    mesh_runner.run_mesh(job, reporter)  # type: ignore[arg-type]
    assert bool(reporter.warnings) == said
    if said:
        assert "33% of it seen by no photo" in reporter.warnings[0]
