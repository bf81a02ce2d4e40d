# SPDX-License-Identifier: GPL-3.0-or-later
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.mesh import delaunay
from mgf_engine.mesh.delaunay import begun


def nothing() -> None:
    pass


def points(count: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, 3))


def worker(folder: Path, code: str) -> tuple[str, str]:
    """A command that does something else instead."""
    path = folder / "worker.py"
    path.write_text(code)
    return sys.executable, str(path)


def test_the_process_makes_the_same_tetrahedra() -> None:
    with begun(points(500)) as made:
        assert np.array_equal(made(nothing), delaunay.delaunay(points(500)))


def test_flat_points_are_refused_before_a_process_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delaunay, "COMMAND", ("no such program",))
    with pytest.raises(BadInput, match="no surface"), begun(points(50) * [1, 1, 0]):
        pass


@pytest.mark.parametrize(
    ("code", "sentence"),
    [("import sys; print('tetgen gave up.', file=sys.stderr); sys.exit(2)", "^tetgen gave up.$"),
     ("import os; os._exit(9)", "code 9.*lower max_gaussians")],
)  # fmt: skip
def test_a_process_that_fails_says_why(tmp_path, monkeypatch, code, sentence) -> None:
    monkeypatch.setattr(delaunay, "COMMAND", worker(tmp_path, code))
    with begun(points(50)) as made, pytest.raises(BadInput, match=sentence):
        made(nothing)


def test_cancelling_ends_the_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delaunay, "COMMAND", worker(tmp_path, "import time; time.sleep(60)"))
    started = time.monotonic()

    def check() -> None:
        raise Cancelled("enough")

    with pytest.raises(Cancelled), begun(points(50)) as made:
        made(check)
    assert time.monotonic() - started < 20
