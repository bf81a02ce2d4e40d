# SPDX-License-Identifier: GPL-3.0-or-later
"""Work loops wake as many threads as there are pieces of work, and no more."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from rendered import camera, gaussians, random_weights, run

from mgf_engine.geometry.rasterize import corners, draw_triangles
from mgf_engine.model.scene import View
from mgf_engine.model.topology import Adjacency
from mgf_engine.native import build, library
from mgf_engine.raster.adam import AdamStep, adam_step
from mgf_engine.raster.api import Rendering
from mgf_engine.raster.loss import LossWeights, image_loss
from mgf_engine.raster.loss_photo import prepare_photo
from mgf_engine.raster.points import INSIDE, PointOpacity

MANY = 1000
WEIGHTS = LossWeights(
    plain=0.3, multilevel=0.5, labels=np.array([0.0, 1.0]), boundary=0.2, edge=2.0, l1=0.8, ssim=0.2, background=0.1,
    distortion=1.0, normals=0.1,
)  # fmt: skip


class Woken:
    """Stands for the pool: what is woken works at once, and is counted by work loop."""

    def __init__(self) -> None:
        self.loops: dict[str, list[tuple[int, Any]]] = {}

    def submit(self, function: Any, counter: Any, *arguments: Any) -> Any:
        calls = self.loops.setdefault(function.__name__, [])
        if calls and calls[-1][1] is counter:
            calls[-1] = (calls[-1][0] + 1, counter)
        else:
            calls.append((2, counter))  # this one and the caller
        function(counter, *arguments)
        return self

    def result(self) -> None:
        pass


@pytest.fixture
def woken(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, list[tuple[int, Any]]]]:
    library.set_threads(2)
    pool = Woken()
    monkeypatch.setattr(library, "_threads", MANY)
    monkeypatch.setattr(library, "_pool", pool)
    yield pool.loops
    monkeypatch.undo()
    library.set_threads(0)


def test_pieces_are_as_large_as_the_kernels_say() -> None:
    for name, items in library.ITEMS_PER_PIECE.items():
        (source,) = [text for p in build.KERNELS.rglob("*.c") if re.search(rf"\b{name}\(", text := p.read_text())]
        said = re.search(r"enum { PIECE = (\d+)", source)
        if said is None:
            assert name == "mgf_match_photos" and "take_work(next) * GROUPS * VECTOR" in source
            assert "GROUPS = 4" in source and "VECTOR = 16" in (build.KERNELS / "common" / "vector.h").read_text()
        assert items == (int(said[1]) if said else 4 * 16), name


def view() -> View:
    where = np.array([0.0, 0.0, 4.0])
    return View("a", "a.png", 600, 150, 300.0, 300.0, 301.3, 74.0, np.eye(3), where, 600, 150)


def render() -> None:
    field, seen = gaussians(700, seed=1), camera(200, 100)
    weights = random_weights(seen, ("color", "alpha"), 0, torch.ones(100, 200, dtype=torch.bool))
    run(field, seen, "cpu", weights, torch.zeros(100, 200), sh_degree=1)


def step() -> None:
    parameter, gradient, first, second = (torch.ones(5000, 3) for _ in range(4))
    adam_step(parameter, gradient, (first, second), AdamStep(0.1, 1), backend="cpu")


def opacity() -> None:
    points = np.random.default_rng(0).normal(size=(9000, 3)).astype(np.float32)
    mask = np.full((150, 600), INSIDE, np.uint8)
    PointOpacity(gaussians(300, log_scale=-3.0), "cpu").lower(np.full((9000, 2), 2.0, np.float32), points, view(), mask)


def around() -> None:
    grid = np.arange(100 * 100, dtype=np.int32).reshape(100, 100)
    one = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:]], -1).reshape(-1, 3)
    faces = np.concatenate([one, np.stack([grid[:-1, :-1], grid[1:, 1:], grid[:-1, 1:]], -1).reshape(-1, 3)])
    found = Adjacency.of(faces, 10000)
    found.open_edges()
    found.fans()


def triangles() -> None:
    corners(np.random.default_rng(0).normal(size=(20000, 3)), view())


def comparison() -> None:
    height, width = 150, 600
    labels = torch.zeros(height, width, dtype=torch.uint8)
    labels[20:140, 30:590] = 1
    none, maps = torch.zeros(height, width, dtype=torch.bool), torch.rand(10, height, width)
    photo = prepare_photo(torch.zeros(3, height, width, dtype=torch.uint8), labels, none, none, 2, 1, (0, 0))
    assert len(photo.levels) > 1
    drawn = Rendering(maps[:3], maps[3], maps[4], maps[5], maps[6:9], maps[9], torch.ones(1, dtype=torch.bool))
    image_loss(drawn, photo, WEIGHTS, torch.zeros(3), view(), torch.zeros(height, width), "cpu")


WORK: dict[str, tuple[Callable[[], None], dict[str, int]]] = {
    "rendering": (render, {"mgf_project": 3, "mgf_blend": 13 * 7, "mgf_bin_count": 16, "mgf_project_backward": 3}),
    "a step": (step, {"mgf_adam": 3}),
    "points": (opacity, {"mgf_locate_points": 3, "mgf_point_opacity": 38 * 10}),
    "topology": (around, {"mgf_open_edges": 3, "mgf_vertex_fans": 3}),
    "losses": (comparison, {"mgf_loss_prepare": 15, "mgf_loss_normals": 10, "mgf_loss_finish": 20}),
    "corners": (triangles, {"mgf_project_vertices": 3}),
}


@pytest.mark.parametrize("name", WORK)
def test_as_many_threads_as_pieces(name: str, woken: dict[str, list[tuple[int, Any]]]) -> None:
    work, expected = WORK[name]
    work()
    assert {loop: calls[0][0] for loop, calls in woken.items() if loop in expected} == expected
    for loop, calls in woken.items():
        for threads, counter in calls:  # each thread takes one piece that is not there, and stops
            assert counter._obj.value - threads == threads, loop


def test_bands_of_triangles_are_as_many_as_threads_may_take(woken: dict[str, list[tuple[int, Any]]]) -> None:
    draw_triangles(np.array([[[0.0, 0.0], [90.0, 0.0], [0.0, 70.0]]]), 100, 100)
    ((threads, counter),) = woken["mgf_zbuffer"]
    assert counter._obj.value - threads <= threads
