# SPDX-License-Identifier: GPL-3.0-or-later
"""What both makers of tetrahedra, the kernel and tetgen, promise about work that is begun beside other work."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest

from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.geometry import delaunay, tetgen
from mgf_engine.system import memory
from mgf_engine.system.subprocesses import RUNNING


@dataclass(frozen=True)
class Maker:
    """A module that makes tetrahedra; ``work``: name of its function that begins; ``made``: makes them at once."""

    module: ModuleType
    work: str
    made: Callable[[np.ndarray], np.ndarray]

    def background_delaunay(self, points: np.ndarray) -> AbstractContextManager[Callable[..., np.ndarray]]:
        found: AbstractContextManager[Callable[..., np.ndarray]] = self.module.background_delaunay(points)
        return found


@pytest.fixture(
    params=[
        Maker(delaunay, "_made", delaunay.delaunay),
        Maker(tetgen, "_started", lambda points: tetgen.tetrahedralize(delaunay.scaled(points, points))),
    ],
    ids=["kernel", "tetgen"],
)
def maker(request: pytest.FixtureRequest) -> Maker:
    found: Maker = request.param
    return found


@pytest.fixture
def limit():
    """Sets the user's limit of memory, and takes it back."""
    yield memory.allow
    memory.allow(0.0)


def nothing() -> None:
    pass


def random_points(count: int) -> np.ndarray:
    return np.random.default_rng(0).random((count, 3))


@pytest.mark.parametrize("points", [random_points(3), random_points(50) * [1, 1, 0]], ids=["three", "plane"])
def test_flat_points_are_refused_before_work_begins(
    maker: Maker, points: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(maker.module, maker.work, lambda *given: pytest.fail("began"))
    with pytest.raises(BadInput, match="no surface"), maker.background_delaunay(points):
        pass


def test_work_that_was_begun_gives_the_same(maker: Maker) -> None:
    with maker.background_delaunay(random_points(500)) as made:
        assert np.array_equal(made(nothing), maker.made(random_points(500)))


def test_cancelling_stops_the_work(maker: Maker) -> None:
    def check() -> None:
        raise Cancelled("enough")

    with pytest.raises(Cancelled), maker.background_delaunay(random_points(300_000)) as made:  # seconds of work
        made(check)
    assert not RUNNING and not any(thread.name.startswith("mgf-delaunay") for thread in threading.enumerate())


def test_what_does_not_fit_below_the_users_limit_is_refused(maker: Maker, limit) -> None:
    limit(1e6, strict=True)
    words = r"tetrahedra of 500 points need about 0.0 GB .* lower max_gaussians or resolution, or allow more"
    with maker.background_delaunay(random_points(500)) as made, pytest.raises(BadInput, match=words):
        made(nothing)


@pytest.mark.parametrize("short", [False, True])
def test_where_memory_is_short_the_work_begins_when_it_is_asked_for(
    maker: Maker, short: bool, limit, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, work = threading.Event(), getattr(maker.module, maker.work)
    monkeypatch.setattr(maker.module, maker.work, lambda *given: (began.set(), work(*given))[1])
    limit(1.0 if short else 1e12)
    with maker.background_delaunay(random_points(500)) as made:
        assert began.wait(0.2 if short else 10) != short
        assert np.array_equal(made(nothing), maker.made(random_points(500)))
    assert not RUNNING
