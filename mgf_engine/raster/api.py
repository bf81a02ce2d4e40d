# SPDX-License-Identifier: GPL-3.0-or-later
"""Differentiable rendering of Gaussians on a chosen backend; the interface of the rasterizer.

Backends: ``cpu`` (C kernels), ``cuda`` (CUDA kernels on a GPU), ``reference`` (plain float64 torch, slow, for tests)
and ``cuda-source-on-cpu`` (the CUDA kernels built for the CPU, slow, for tests). All follow the same rules:

- A Gaussian is drawn when its centre is deeper than ``camera.near``, its opacity is above 1/255 and its centre does
  not project further than 1e5 pixels from the principal point. Gaussians are ordered by the depth of their centres.
- In each pixel, front to back, it is blended with alpha = min(0.99, response) if its response is above 1/255, the
  depth of the response is above ``camera.near`` and the transmittance before it is above 1e-4.
- Log scales act within ln(1e-6)..ln(1e3); a quaternion of (almost) zero length stands for no rotation.
- The footprint decides which tiles list a Gaussian; it is exact, so it changes no pixel. A Gaussian whose footprint
  is no ellipse (it reaches the plane of the camera, or holds the camera) is listed in every tile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, cast

import torch
from torch import Tensor

from mgf_engine.model.gaussians import Gaussians
from mgf_engine.raster import cpu, reference
from mgf_engine.raster.camera import TILE, Camera
from mgf_engine.raster.cpu import TileLists, build_lists
from mgf_engine.raster.device import backend_for
from mgf_engine.raster.outputs import Rendering, RenderStats

__all__ = ["BACKENDS", "OUTPUTS", "TILE", "Camera", "RenderStats", "Rendering", "TileLists", "build_lists", "render"]

BACKENDS = ("cpu", "cuda", "reference", "cuda-source-on-cpu")
#: ``all`` outputs, or ``basic``: colour, alpha and depth only, which is faster.
OUTPUTS = ("all", "basic")


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    sh_degree: int,
    tile_mask: Tensor | None = None,
    backend: str | None = None,
    stats: RenderStats | None = None,
    error_map: Tensor | None = None,
    outputs: str = "all",
    wait: bool = True,
) -> Rendering:
    """Render Gaussians; differentiable in positions, log_scales, rotations, opacity_logits and sh.

    Args:
        gaussians: N >= 0 Gaussians, float32; the outputs lie on their device.
        camera: the camera.
        sh_degree: degree of the spherical harmonics in use, 0..3.
        tile_mask: [tiles_y, tiles_x] (``camera.tiles``); only tiles with a non-zero entry are drawn. None: all.
        backend: one of :data:`BACKENDS`. None: ``cuda`` for Gaussians on a GPU, else ``cpu``.
        stats: added to by the backward pass.
        error_map: float32 [H, W], per-pixel error that ``stats.error`` gathers; zero if not given.
        outputs: one of :data:`OUTPUTS`.
        wait: on a GPU, whether to wait until it is known how much memory the lists of the tiles need. False, for
            training: earlier renderings tell; one that needs more draws nothing and has no gradients.

    Raises:
        ValueError: an argument of the wrong shape or an unknown name.
    """
    backend = backend_for(gaussians.positions, backend)
    if backend not in BACKENDS or outputs not in OUTPUTS:
        raise ValueError(f"backend is one of {BACKENDS} and outputs one of {OUTPUTS}, not '{backend}' and '{outputs}'")
    wanted = _Request(camera, sh_degree, tile_mask, stats, error_map, outputs == "all", wait)
    _check_shapes(gaussians)
    wanted.check(len(gaussians))
    if backend == "reference":
        return reference.render(gaussians, camera, sh_degree, tile_mask, stats, error_map, wanted.geometry)
    rendered = _Render.apply(
        gaussians.positions,
        gaussians.log_scales,
        gaussians.rotations,
        gaussians.opacity_logits,
        gaussians.sh,
        gaussians.filter_3d,
        _engine(backend),
        wanted,
    )
    return Rendering(*rendered)


@dataclass(frozen=True)
class _Request:
    """What :func:`render` is asked for; ``geometry``: outputs beyond colour, alpha and depth too."""

    camera: Camera
    sh_degree: int
    tile_mask: Tensor | None
    stats: RenderStats | None
    error_map: Tensor | None
    geometry: bool
    wait: bool

    def check(self, n: int) -> None:
        """Check that the arguments fit the camera and N Gaussians.

        Raises:
            ValueError: one does not.
        """
        size = self.camera.height, self.camera.width
        if self.tile_mask is not None and tuple(self.tile_mask.shape) != self.camera.tiles:
            raise ValueError(f"tile_mask must be {self.camera.tiles}, not {tuple(self.tile_mask.shape)}")
        if self.error_map is not None and tuple(self.error_map.shape) != size:
            raise ValueError(f"error_map must be {size}, not {tuple(self.error_map.shape)}")
        if self.stats is not None and len(self.stats.weight) != n:
            raise ValueError(f"stats are for {len(self.stats.weight)} Gaussians, not {n}")
        if self.sh_degree not in (0, 1, 2, 3):
            raise ValueError(f"sh_degree must be 0, 1, 2 or 3, not {self.sh_degree}")


def _check_shapes(gaussians: Gaussians) -> None:
    n = len(gaussians)
    shapes = {"log_scales": (n, 3), "rotations": (n, 4), "opacity_logits": (n,), "sh": (n, 16, 3), "filter_3d": (n,)}
    for name, shape in shapes.items():
        if tuple(getattr(gaussians, name).shape) != shape:
            raise ValueError(f"{name} must be {shape}, not {tuple(getattr(gaussians, name).shape)}")


class _Engine(Protocol):
    """What a backend offers: the functions of :mod:`mgf_engine.raster.cpu`."""

    def list_tiles(
        self, raw: cpu.Parameters, camera: Camera, sh_degree: int, tile_mask: Tensor | None, wait: bool = True
    ) -> Any: ...

    def blend(self, lists: Any, geometry: bool) -> tuple[Tensor, Tensor]: ...

    def backward(
        self,
        raw: cpu.Parameters,
        sh_degree: int,
        lists: Any,
        image: Tensor,
        hits: Tensor,
        gradients: cpu.OutputGradients,
        error_map: Tensor | None,
        statistics: tuple[Tensor, ...] | None,
    ) -> tuple[Tensor, ...]: ...


def _engine(backend: str) -> _Engine:
    if backend == "cpu":
        return cast(_Engine, cpu)
    from mgf_engine.raster.cuda import rasterizer_on

    return rasterizer_on(backend)


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor | None, ...]:
        *tensors, engine, wanted = arguments
        raw = cpu.Parameters.of(*tensors)
        lists = engine.list_tiles(raw, wanted.camera, wanted.sh_degree, wanted.tile_mask, wanted.wait)
        image, hits = engine.blend(lists, wanted.geometry)
        ctx.save_for_backward(image)  # so that a change in place of an output is noticed
        ctx.kept = (engine, raw, wanted, lists, hits)
        ctx.set_materialize_grads(False)
        visible = lists.tile_counts > 0
        ctx.mark_non_differentiable(visible)
        seen = image[:, : wanted.camera.height, : wanted.camera.width]
        if wanted.geometry:
            return seen[0:3], seen[3], seen[4], seen[5], seen[6:9], seen[9], visible
        return seen[0:3], seen[3], seen[4], None, None, None, visible

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        (image,) = ctx.saved_tensors
        engine, raw, wanted, lists, hits = ctx.kept
        given = cpu.OutputGradients(*(None if g is None else g.to(torch.float32).contiguous() for g in gradients[:6]))
        error = None if wanted.error_map is None else wanted.error_map.detach().to(torch.float32).contiguous()
        statistics = None if wanted.stats is None else wanted.stats.all
        found = engine.backward(raw, wanted.sh_degree, lists, image, hits, given, error, statistics)
        return (*found, None, None, None)
