# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare a rendering, its gradients and a short training on the GPU with the CPU kernels."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from mgf_engine.field.losses import LossOptions, total_loss
from mgf_engine.field.optimiser import TRAINED, Optimiser
from mgf_engine.field.schedule import rates_at
from mgf_engine.field.synthetic import corner_view, noise_target, synthetic_building
from mgf_engine.field.targets import Target
from mgf_engine.raster.api import Rendering, RenderStats, render
from mgf_engine.raster.cuda import rasterizer_on

OUTPUTS = ("color", "alpha", "depth", "normal", "distortion")  # the median jumps where rounding moves it over 1/2
#: Two float32 renderings differ by yes-or-no rules that rounding decides in single pixels: so quantiles, not maxima.
IMAGE_LIMIT, GRADIENT_LIMIT, LOSS_LIMIT = 1e-4, 5e-3, 1e-5
_QUANTILE = 0.999
_ITERATIONS = 20


class Training:
    """A field and a target on one device, and training iterations on them."""

    def __init__(self, n: int, width: int, height: int, device: torch.device) -> None:
        self.device, self.camera = device, corner_view(width, height)
        self.target: Target = noise_target(self.camera).to(device)
        self.optimiser = Optimiser(synthetic_building(n).to(device))
        self.stats = RenderStats.zeros(n, device)

    def forward(self, wait: bool) -> tuple[Rendering, Any]:
        error = torch.zeros(self.camera.height, self.camera.width, device=self.device)
        seen = render(
            self.optimiser.leaves(), self.camera, sh_degree=3, tile_mask=self.target.tile_mask, stats=self.stats,
            error_map=error, wait=wait,
        )  # fmt: skip
        return seen, total_loss(seen, self.target, LossOptions(), torch.tensor([0.2, 0.5, 0.8]), True, error)

    def iterate(self) -> None:
        seen, terms = self.forward(wait=False)
        terms.total.backward()
        self.optimiser.step(rates_at(0.5), seen.visible, 0.05)


def relative_difference(a: Tensor, b: Tensor) -> float:
    """Measure the difference of two tensors, nearly its largest, relative to the largest value of the first."""
    difference = (a.detach().cpu() - b.detach().cpu()).abs().flatten()
    rank = max(1, int(_QUANTILE * len(difference)))
    return float(difference.kthvalue(rank).values / a.detach().abs().max().clamp_min(1e-12).cpu())


def compare(n: int, width: int, height: int) -> dict[str, float]:
    """Measure the differences of a forward and backward pass on the GPU from the same on the CPU."""
    found: dict[str, float] = {}
    sides = [Training(n, width, height, torch.device(name)) for name in ("cpu", "cuda")]
    passes = [side.forward(wait=True) for side in sides]
    for name in OUTPUTS:
        found[name] = relative_difference(getattr(passes[0][0], name), getattr(passes[1][0], name))
    found["loss"] = abs(float(passes[0][1].total.detach()) / float(passes[1][1].total.detach()) - 1)
    for _, terms in passes:
        terms.total.backward()
    fields = [side.optimiser.field for side in sides]
    for name in TRAINED:
        found[f"gradient of {name}"] = relative_difference(*(getattr(f, name).grad for f in fields))
    for _ in range(2):  # the first of its kind still waits, to learn how long the lists get
        unawaited, _ = sides[1].forward(wait=False)
    for name in OUTPUTS:
        found[f"{name} without waiting"] = relative_difference(getattr(passes[0][0], name), getattr(unawaited, name))
    sides[1].optimiser.step(rates_at(0.5), passes[1][0].visible, 0.05)  # for compute-sanitizer to look at
    return found


def same_training(n: int, width: int, height: int) -> bool:
    """Tell whether the GPU trains the same field twice, with the same iterations lost for lack of capacity."""
    capacity, found, lost = rasterizer_on("cuda").capacity, [], []
    for _ in range(2):
        capacity.restore()
        side = Training(n, width, height, torch.device("cuda"))
        for _ in range(_ITERATIONS):
            side.iterate()
        found.append(side.optimiser.field)
        lost.append(capacity.lost)
    return lost[0] == lost[1] and all(torch.equal(*(getattr(f, name) for f in found)) for name in TRAINED)


def beyond_limits(differences: dict[str, float]) -> list[str]:
    """Return the figures of :func:`compare` that are beyond their limits, or not numbers."""
    limits = {"loss": LOSS_LIMIT}
    return [
        name
        for name, value in differences.items()
        if not value <= limits.get(name, GRADIENT_LIMIT if name.startswith("gradient") else IMAGE_LIMIT)
    ]
