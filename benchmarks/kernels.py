# SPDX-License-Identifier: GPL-3.0-or-later
"""Times the rasterizer's kernels part by part, and against the plain torch reference.

``python -m benchmarks.kernels`` prints, for every kernel variant of this machine, the milliseconds of each part
of one training iteration on a synthetic building, and the ratio to the reference on a scene small enough for it. Wall
time is that of all threads together working; CPU time is what they used: on a busy machine only that means something.
The best of several rounds counts; variants take turns, so that a change of the machine's pace hits all of them.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import torch

from benchmarks import torch_tiles
from benchmarks.arguments import picture_size
from mgf_engine.field import reference_losses
from mgf_engine.field.losses import LossOptions, LossTerms, total_loss
from mgf_engine.field.optimiser import TRAINED
from mgf_engine.field.synthetic import corner_view, noise_target, synthetic_building
from mgf_engine.field.targets import Target
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.native import library
from mgf_engine.raster import cpu
from mgf_engine.raster.adam import AdamStep, adam_step
from mgf_engine.raster.api import Camera, Rendering, render
from mgf_engine.raster.camera import TILE

T = TypeVar("T")

PARTS = ("project", "sort, bin", "blend", "losses", "blend backward", "project backward", "adam")


@dataclass
class Clock:
    """Smallest wall and CPU milliseconds per named part."""

    wall: dict[str, float] = field(default_factory=dict)
    cpu: dict[str, float] = field(default_factory=dict)

    def time(self, part: str, work: Callable[[], T]) -> T:
        wall, used = time.perf_counter(), time.process_time()
        result = work()
        wall, used = 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - used)
        self.wall[part] = min(wall, self.wall.get(part, np.inf))
        self.cpu[part] = min(used, self.cpu.get(part, np.inf))
        return result


class Iteration:
    """The kernels of one training iteration, run part by part.

    Attributes:
        pairs: of a listed Gaussian and a pixel of its tile, in the last run.
    """

    def __init__(self, n: int, width: int, height: int, outputs: str, sh_degree: int, share: float = 1.0) -> None:
        self.field, self.camera, self.degree = synthetic_building(n), corner_view(width, height), sh_degree
        self.geometry = outputs == "all"
        self.raw = cpu.Parameters.of_field(self.field)
        self.moments = [torch.zeros(2, *t.shape) for t in self.raw.all[:5]]
        g = torch.Generator().manual_seed(0)
        planes = torch.randn(10, height, width, generator=g)
        rest = (planes[5], planes[6:9], planes[9]) if self.geometry else (None, None, None)
        depth = planes[4] if self.geometry else None
        self.outputs = cpu.OutputGradients(planes[0:3].contiguous(), planes[3], depth, *rest)
        self.target = noise_target(self.camera, share)
        self.pairs = 0

    def run(self, clock: Clock) -> None:
        mask = self.target.tile_mask
        seen = clock.time("project", lambda: cpu.project(self.raw, self.camera, self.degree, mask))
        lists = clock.time("sort, bin", lambda: cpu.bin_tiles(seen))
        self.pairs = lists.entries * TILE**2
        image, hits = clock.time("blend", lambda: cpu.blend(lists, self.geometry))
        clock.time("losses", lambda: self._losses(image))
        sums = clock.time("blend backward", lambda: cpu.blend_backward(lists, image, hits, self.outputs, None, False))
        back = (self.raw, self.degree, lists, hits, sums, self.outputs.level, None)
        gradients = clock.time("project backward", lambda: cpu.project_backward(*back))
        clock.time("adam", lambda: self._adam(gradients, lists.tile_counts > 0))

    def _losses(self, image: torch.Tensor) -> None:
        planes = image[:, : self.camera.height, : self.camera.width]
        losses_and_gradients(total_loss, planes, self.target, self.geometry)

    def _adam(self, gradients: tuple[torch.Tensor, ...], visible: torch.Tensor) -> None:
        active = 3 * (self.degree + 1) ** 2
        for i, (parameter, moments) in enumerate(zip(self.raw.all[:5], self.moments, strict=True)):
            columns = active if i == 4 else None
            adam_step(parameter, gradients[i], (moments[0], moments[1]), AdamStep(1e-6, 1), visible, active=columns)


def parts_table(n: int, width: int, height: int, outputs: str, rounds: int) -> dict[str, Clock]:
    """Clocks of every variant for one scene."""
    names = library.runnable_variants()
    clocks = {name: Clock() for name in names}
    iteration = Iteration(n, width, height, outputs, 3)
    for _ in range(rounds):
        for name in names:
            library.use_variant(name)
            iteration.run(clocks[name])
    library.use_variant("")
    return clocks


def ratio_to_reference(n: int, width: int, height: int) -> float:
    """How many times longer the torch reference takes than the best variant, forward and backward, one small scene."""
    gaussians, camera = synthetic_building(n, size=0.1), corner_view(width, height)
    for name in TRAINED:
        getattr(gaussians, name).requires_grad_()
    used = {}
    for backend, rounds in (("cpu", 20), ("reference", 2)):
        clock = Clock()
        for _ in range(rounds):
            clock.time("all", lambda: _forward_and_backward(gaussians, camera, backend))  # noqa: B023
        used[backend] = clock.cpu["all"]
    return used["reference"] / used["cpu"]


def ratio_to_torch_tiles(n: int, width: int, height: int) -> float:
    """Return how many times longer blending takes in torch, tile by tile with autograd, forward and backward."""
    raw, camera = cpu.Parameters.of_field(synthetic_building(n)), corner_view(width, height)
    lists, clock = cpu.list_tiles(raw, camera, 3, None), Clock()
    ones = torch.ones(height, width)
    outputs = cpu.OutputGradients(torch.ones(3, height, width), ones, ones, None, torch.ones(3, height, width), ones)

    def kernels() -> None:
        image, hits = cpu.blend(lists, geometry=True)
        cpu.blend_backward(lists, image, hits, outputs, None, False)

    def tiles() -> None:
        records = lists.records.clone().requires_grad_()
        torch_tiles.blend(lists, records, camera.near, camera.far).sum().backward()

    for _ in range(5):
        clock.time("kernels", kernels)
    clock.time("torch", tiles)
    return clock.cpu["torch"] / clock.cpu["kernels"]


def losses_and_gradients(loss: Callable[..., LossTerms], planes: torch.Tensor, target: Target, geometry: bool) -> None:
    """One evaluation of a loss on rendered planes [10, H, W], and its gradient in the colours."""
    median, normal, distortion = (planes[5], planes[6:9], planes[9]) if geometry else (None, None, None)
    color, visible = planes[0:3].detach().requires_grad_(), torch.ones(1, dtype=torch.bool)
    shown = Rendering(color, planes[3], planes[4], median, normal, distortion, visible)
    loss(shown, target, LossOptions(), torch.zeros(3), geometry).total.backward()


def losses_ratio_to_reference(width: int, height: int) -> float:
    """Return how many times longer the losses take in plain torch (float32, SSIM above all), forward and backward."""
    planes = torch.rand(10, height, width, generator=torch.Generator().manual_seed(0))
    target, clock = noise_target(corner_view(width, height)), Clock()
    for _ in range(5):
        clock.time("kernels", lambda: losses_and_gradients(total_loss, planes, target, geometry=False))
        clock.time(
            "reference", lambda: losses_and_gradients(reference_losses.total_loss, planes, target, geometry=False)
        )
    return clock.cpu["reference"] / clock.cpu["kernels"]


def _forward_and_backward(gaussians: Gaussians, camera: Camera, backend: str) -> None:
    seen = render(gaussians, camera, sh_degree=3, backend=backend)
    assert seen.normal is not None and seen.distortion is not None
    total = seen.color.sum() + seen.depth.sum() + seen.normal.sum() + seen.distortion.sum()
    total.backward()


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gaussians", type=int, nargs="+", default=[50_000, 100_000], help="numbers of Gaussians")
    parser.add_argument(
        "--sizes", type=picture_size, nargs="+", default=[(750, 500), (375, 250)], help="sizes of the picture"
    )
    parser.add_argument("--outputs", nargs="+", default=["all", "basic"], choices=["all", "basic"], help="outputs")
    parser.add_argument("--rounds", type=int, default=5, help="the fastest of so many counts")
    parser.add_argument("--threads", type=int, default=0, help="0 takes every core")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    given = parser.parse_args(arguments)
    library.set_threads(given.threads)
    torch.set_num_threads(1)  # waiting threads would count as CPU time
    results: list[dict[str, Any]] = []
    for n in given.gaussians:
        for width, height in given.sizes:
            size = f"{width}x{height}"
            for outputs in given.outputs:
                clocks = parts_table(n, width, height, outputs, given.rounds)
                results.append({"gaussians": n, "size": size, "outputs": outputs, "variants": clocks})
                if not given.json:
                    _print_table(f"{n} Gaussians, {size}, {outputs} outputs, {library.threads()} threads", clocks)
    ratio, losses = ratio_to_reference(300, 96, 64), losses_ratio_to_reference(750, 500)
    n, (width, height) = given.gaussians[0], given.sizes[0]
    tiles = ratio_to_torch_tiles(n, width, height)
    if given.json:
        plain = [{**r, "variants": {k: vars(v) for k, v in r["variants"].items()}} for r in results]
        ratios = {"ratio_to_reference": ratio, "ratio_to_torch_tiles": tiles, "losses_ratio_to_reference": losses}
        print(json.dumps({"scenes": plain, **ratios}, indent=1))
    else:
        print(
            f"\nThe torch reference takes {ratio:.0f} times the CPU time (300 Gaussians, 96x64, forward and backward)."
        )
        print(f"Blending in torch, tile by tile, takes {tiles:.0f} times ({n} Gaussians, {width}x{height}, both ways).")
        print(f"The losses take {losses:.0f} times the CPU time in plain torch (750x500, forward and backward).")
    return 0


def _print_table(title: str, clocks: dict[str, Clock]) -> None:
    print(f"\n{title}: milliseconds, CPU (wall)")
    print(f"{'':18s}" + "".join(f"{name:>20s}" for name in clocks))
    for part in PARTS:
        print(f"{part:18s}" + "".join(f"{c.cpu[part]:10.1f} ({c.wall[part]:7.1f})" for c in clocks.values()))
    totals = [(sum(c.cpu.values()), sum(c.wall.values())) for c in clocks.values()]
    print(f"{'together':18s}" + "".join(f"{used:10.1f} ({wall:7.1f})" for used, wall in totals))


if __name__ == "__main__":
    sys.exit(main())
