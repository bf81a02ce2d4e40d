# SPDX-License-Identifier: GPL-3.0-or-later
"""An iteration reads nothing back from the GPU: no operation of torch in it moves a number between host and device."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from rendered import camera, gaussians
from torch.utils._python_dispatch import TorchDispatchMode

from mgf_engine.field.losses import LossOptions, loss_weights
from mgf_engine.field.synthetic import noise_target
from mgf_engine.raster.api import RenderStats
from mgf_engine.raster.cpu import OutputGradients, Parameters
from mgf_engine.raster.cuda import launcher_on
from mgf_engine.raster.cuda.blending import Rasterizer
from mgf_engine.raster.cuda.loss import DevicePass

SOURCE = "cuda-source-on-cpu"
READS = ("_local_scalar_dense", "is_nonzero", "nonzero", "equal", "masked_select", "index")  # index: masks, or tensors


class Watch(TorchDispatchMode):
    """Notes operations on a GPU's tensors that read a value, or that copy a number of the host into one of them.

    ``x[0] = 0.0`` on a GPU is such a copy: the number becomes a tensor on the host, and a place of just its shape
    takes it with ``copy_``, which waits. ``x[:1] = 0.0`` fills, and does not.
    """

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def __torch_dispatch__(self, call: Any, types: Any, given: Any = (), named: Any = None) -> Any:
        name = call.overloadpacket.__name__
        if name in READS or (name == "copy_" and given[1].dim() == 0):
            self.found.append(name)
        return call(*given, **(named or {}))


def test_the_watch_sees_what_waits() -> None:
    for number, work in enumerate([
        lambda x: x.__setitem__(0, 0.0), lambda x: float(x[0]), lambda x: bool((x > 0).all()), lambda x: x[x > 0],
        lambda x: x.max().item(), lambda x: torch.equal(x, x),
    ]):  # fmt: skip
        with Watch() as watch:
            work(torch.ones(3))
        assert watch.found, number
    with Watch() as watch:
        x = torch.ones(3)
        x[:1] = 0.0
        x[:1].zero_()
    assert watch.found == []


def test_rendering_and_gradients_read_nothing_back() -> None:
    own = Rasterizer(launcher_on(SOURCE))
    raw, view = Parameters.of_field(gaussians(100)), camera()
    statistics = RenderStats.zeros(100).all
    slope = torch.ones(3, view.height, view.width)
    mask = torch.ones(view.tiles, dtype=torch.uint8)
    own.list_tiles(raw, view, 3, mask, wait=False)  # the first one waits
    with Watch() as watch:
        lists = own.list_tiles(raw, view, 3, mask, wait=False)
        image, hits = own.blend(lists, True)
        outputs = OutputGradients(slope, None, None, None, slope, None)
        own.backward(raw, 3, lists, image, hits, outputs, slope[0], statistics)
    assert watch.found == []
    with Watch() as watch:
        own.list_tiles(raw, view, 3, mask, wait=True)
    assert watch.found == ["_local_scalar_dense"]


@pytest.mark.parametrize("geometry", [False, True])
def test_loss_and_gradients_read_nothing_back(geometry: bool) -> None:
    view = camera(70, 50)
    target = noise_target(view)
    weights = loss_weights(target, LossOptions(), geometry)
    maps = list(torch.rand(9, 64, 80)[:, :50, :70].split((3, 1, 1, 1, 3)))
    maps = [maps[0], maps[1][0], *([maps[2][0], maps[3][0], maps[4]] if geometry else [])]
    error = target.crop(torch.zeros(50, 70))

    def compare() -> None:
        backdrop = (0.2, 0.5, 0.8)  # on the host in training, too
        compared = DevicePass(launcher_on(SOURCE), target.loss_photo, weights, backdrop, error, maps)
        compared.run(view)
        assert len(compared.gradients()) == len(maps)

    compare()  # uploads the photo
    with Watch() as watch:
        compare()
    assert watch.found == []
