# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes for the rasterizer's tests, and the comparison of a backend with the reference."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from mgf_engine.errors import BadInput
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.native.cuda.gpu import find_gpu
from mgf_engine.raster import reference
from mgf_engine.raster.api import Camera, Rendering, RenderStats, render

TRAINED = ("positions", "log_scales", "rotations", "opacity_logits", "sh")
OUTPUTS = ("color", "alpha", "depth", "median", "normal", "distortion")


@dataclass(frozen=True)
class Tolerance:
    """Largest differences allowed between a float32 backend and the float64 reference.

    Attributes:
        margin: pixels where the reference is this close (relative) to a yes-or-no rule are left out of the comparison.
        image: of every output, relative to max(1, largest value of that output).
        gradient: of every parameter's gradient, relative to its largest value.

    A gradient that should vanish (the rotation of a sphere) is the rounding of terms that cancel; so 1e-6 of the
    largest gradient of any parameter is allowed on top.
    """

    margin: float
    image: float
    gradient: float


#: One place for all tolerances.
TOLERANCES = {
    # All but needles. float32 carries 6e-8; a response is exp of a quotient of quadratics in pixels, with exponents up
    # to 11, and up to a hundred of them meet in a pixel. Measured: images 4e-6, gradients 3e-5.
    "plain": Tolerance(margin=1e-3, image=3e-5, gradient=2e-4),
    # Needles a thousand times longer than wide and 1/200 pixel thick: inside the footprint q cancels down to the square
    # of that ratio. Measured: images 3e-3 (3e-4 with fused multiply-add), gradients 2e-2.
    "needle": Tolerance(margin=3e-2, image=1e-2, gradient=6e-2),
}


def camera(width: int = 45, height: int = 35, seed: int = 1, focal: float = 42.0, near: float = 0.2) -> Camera:
    """A camera 5 units from the origin, looking at it, turned at random; principal point off the middle."""
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    centre = (0.48 * width, 0.49 * height)
    return Camera(width, height, focal, 1.05 * focal, *centre, rotation, np.array([0.0, 0.0, 5.0]), near)


def gaussians(
    n: int,
    seed: int = 0,
    spread: float = 1.0,
    log_scale: float = -2.0,
    log_spread: float = 0.7,
    logit_spread: float = 2.0,
    filter_3d: float = 0.003,
) -> Gaussians:
    """n random Gaussians around the origin."""
    g = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g)

    return Gaussians(
        positions=spread * normal(n, 3),
        log_scales=log_spread * normal(n, 3) + log_scale,
        rotations=normal(n, 4),
        opacity_logits=logit_spread * normal(n),
        sh=0.3 * normal(n, 16, 3),
        filter_3d=torch.full((n,), filter_3d),
    )


def leaves(field: Gaussians, dtype: torch.dtype = torch.float32) -> Gaussians:
    """A copy whose trained parameters gather gradients."""
    values = {name: value.detach().clone().to(dtype) for name, value in vars(field).items()}
    for name in TRAINED:
        values[name].requires_grad_()
    return Gaussians(**values)


@dataclass
class Result:
    """Outputs, gradients and statistics of one rendering and its backward pass."""

    rendering: Rendering
    gradients: dict[str, Tensor]
    stats: RenderStats


def device_of(backend: str) -> torch.device:
    """Where a backend's Gaussians and statistics lie."""
    return torch.device("cuda", 0) if backend == "cuda" else torch.device("cpu")


def skip_without_gpu(backend: str) -> None:
    """Skips the running test where the backend is ``cuda`` and no GPU can be used; the reason says why."""
    if backend == "cuda":
        try:
            find_gpu()
        except BadInput as error:
            pytest.skip(str(error))


def draw(field: Gaussians, view: Camera, *, backend: str, error_map: Tensor | None = None, **options) -> Rendering:
    """Render on the backend's device; Gaussians and outputs are on the CPU, and gradients find their way."""
    device = device_of(backend)
    error_map = None if error_map is None else error_map.to(device)
    return render(field.to(device), view, backend=backend, error_map=error_map, **options).cpu()


def run(
    field: Gaussians, view: Camera, backend: str, weights: dict[str, Tensor], error_map: Tensor, **options
) -> Result:
    """Render, then the backward pass of sum(weights[output] * output)."""
    own, stats = leaves(field), RenderStats.zeros(len(field), device_of(backend))
    rendering = draw(own, view, backend=backend, stats=stats, error_map=error_map, **options)
    loss = sum(
        (getattr(rendering, name) * weight.to(getattr(rendering, name).dtype)).sum() for name, weight in weights.items()
    )
    loss.backward()
    given = {name: getattr(own, name) for name in TRAINED}
    gradients = {name: torch.zeros_like(p) if p.grad is None else p.grad for name, p in given.items()}
    return Result(rendering, gradients, stats.to(torch.device("cpu")))


def output_names(outputs: str) -> tuple[str, ...]:
    return OUTPUTS if outputs == "all" else OUTPUTS[:3]


def random_weights(view: Camera, names: tuple[str, ...], seed: int, certain: Tensor) -> dict[str, Tensor]:
    """One random gradient image per output, zero where the comparison is open."""
    g = torch.Generator().manual_seed(seed)
    shapes = {name: (3,) if name in ("color", "normal") else () for name in names}
    return {name: certain * torch.randn(*shape, view.height, view.width, generator=g) for name, shape in shapes.items()}


def assert_finite(result: Result) -> None:
    for name in OUTPUTS:
        value = getattr(result.rendering, name)
        assert value is None or torch.isfinite(value).all(), f"{name} is not finite"
    for name, value in result.gradients.items():
        assert torch.isfinite(value).all(), f"the gradient of {name} is not finite"
    for name, value in vars(result.stats).items():
        assert torch.isfinite(value).all(), f"stats.{name} is not finite"


def assert_gradients_agree(found: Result, expected: Result, tolerance: float) -> None:
    steepest = max((float(g.abs().max()) for g in expected.gradients.values() if g.numel()), default=0.0)
    for name, a in expected.gradients.items():
        if a.numel():
            difference, largest = float((a - found.gradients[name]).abs().max()), float(a.abs().max())
            assert difference <= tolerance * largest + 1e-6 * steepest + 1e-9, f"{name}: {difference} of {largest}"


_references: dict[bytes, Result] = {}


def _reference(field: Gaussians, view: Camera, weights: dict[str, Tensor], error_map: Tensor, options: dict) -> Result:
    """The reference's result, computed once for all backends."""
    inputs = [*vars(field).values(), *weights.values(), error_map]
    key = hashlib.sha256(repr((view, options)).encode())
    for tensor in inputs:
        key.update(tensor.detach().numpy().tobytes())
    if key.digest() not in _references:
        _references[key.digest()] = run(field, view, "reference", weights, error_map, **options)
    return _references[key.digest()]


def assert_agrees(
    field: Gaussians,
    view: Camera,
    backend: str,
    tolerance: str = "plain",
    sh_degree: int = 3,
    tile_mask: Tensor | None = None,
    outputs: str = "all",
    seed: int = 0,
) -> Result:
    """Outputs, gradients and statistics of the backend agree with the reference's; returns the backend's."""
    limit = TOLERANCES[tolerance]
    options = {"sh_degree": sh_degree, "tile_mask": tile_mask, "outputs": outputs}
    certain = ~reference.uncertain(field, view, sh_degree, tile_mask, limit.margin)
    weights = random_weights(view, output_names(outputs), seed, certain)
    error_map = torch.rand(view.height, view.width, generator=torch.Generator().manual_seed(seed)) * certain
    expected = _reference(field, view, weights, error_map, options)
    found = expected if backend == "reference" else run(field, view, backend, weights, error_map, **options)
    assert_finite(expected)
    assert_finite(found)
    for name in output_names(outputs):
        a, b = getattr(expected.rendering, name).detach(), getattr(found.rendering, name).detach()
        assert a.shape == b.shape
        difference, largest = ((a - b).abs() * certain).max(), a.abs().max().clamp_min(1.0)
        assert difference <= limit.image * largest, f"{name}: {difference} of {largest}"
    assert_gradients_agree(found, expected, limit.gradient)
    for name in ("error", "gradient", "absolute_gradient"):
        a, b = getattr(expected.stats, name), getattr(found.stats, name)
        if a.numel():
            assert (a - b).abs().max() <= limit.gradient * a.max() + 1e-9, f"stats.{name}"
    touched = expected.rendering.visible & ~found.rendering.visible
    assert not touched.any(), "a Gaussian that shows is not marked visible"
    return found
