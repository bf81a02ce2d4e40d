# SPDX-License-Identifier: GPL-3.0-or-later
"""The fused training loss against its float64 reference: value, every gradient, the error map."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from mgf_engine.errors import BadInput
from mgf_engine.field import reference_losses
from mgf_engine.field.losses import LossOptions, total_loss
from mgf_engine.field.targets import Target, make_target
from mgf_engine.model.masks import BACKGROUND
from mgf_engine.model.scene import View
from mgf_engine.native import buffers, library
from mgf_engine.native.buffers import lasting_array
from mgf_engine.native.cuda.gpu import find_gpu
from mgf_engine.raster.api import Rendering

MAPS = ("color", "alpha", "depth", "normal", "distortion")
VALUE_TOLERANCE = 2e-6  # sums of float32 terms near 1
# Moments in float32 carry errors of about 1e-7 that C2 = 9e-4 divides; differences of neighbouring depths cancel.
GRADIENT_TOLERANCE = {"color": 5e-5, "alpha": 5e-5, "depth": 2e-4, "normal": 5e-5, "distortion": 1e-6}
OPTIONS = replace(LossOptions(), multilevel_loss=True, boundary_loss=True)  # every term there is


@pytest.fixture(autouse=True, scope="module")
def _one_thread_for_torch():
    """The reference works on small tensors, where torch's own threads cost more than they bring."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def view(height: int, width: int) -> View:
    return View(
        name="a", file="a.jpg", width=width, height=height, fx=0.9 * width, fy=0.9 * width, cx=0.52 * width,
        cy=0.47 * height, rotation=np.eye(3), translation=np.zeros(3), original_width=width, original_height=height,
    )  # fmt: skip


def make(height: int, width: int, mask: str = "ellipse", seed: int = 0) -> Target:
    """A target of smooth noise whose mask has labels of several sizes."""
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = np.sin(x / 7 + np.array([0, 1, 2])[:, None, None]) * np.cos(y / 9)
    photo = 127 + 60 * waves + generator.normal(0, 20, (3, height, width))
    labels = np.full((height, width), BACKGROUND, np.uint8)
    if mask == "full":
        labels[:] = 1
    elif mask == "ellipse":
        inside = ((x / width - 0.45) / 0.3) ** 2 + ((y / height - 0.55) / 0.3) ** 2 < 1
        labels[inside] = 1
        labels[inside & (x > 0.5 * width)] = 2
        labels[inside & (abs(x - 0.4 * width) < 4) & (abs(y - 0.5 * height) < 4)] = 3
    else:
        labels[height // 2, width // 3] = 1
    target = make_target(np.clip(photo, 0, 255).astype(np.uint8).transpose(1, 2, 0), labels, view(height, width), 1)
    assert target is not None
    return target


def rendering(target: Target, seed: int = 1, far: float = 0.3) -> Rendering:
    """Random maps of the whole frame, not far from the photo, in rows padded to whole tiles."""
    generator = torch.Generator().manual_seed(seed)
    height, width = target.camera.height, target.camera.width
    maps = torch.rand(10, -(-height // 16) * 16, -(-width // 16) * 16, generator=generator)
    maps[3] = 1 - 0.7 * maps[3] ** 2
    y0, y1, x0, x1 = target.box
    maps[:3, y0:y1, x0:x1] = (1 - far) * target.image / 255 + far * maps[:3, y0:y1, x0:x1]
    maps[4] = (2 + 0.3 * torch.sin(torch.arange(maps.shape[2]) * 0.3) + 0.05 * maps[4]) * maps[3]
    maps[6:9] -= 0.5
    maps[9] *= 1e-3
    seen = maps[:, :height, :width]
    return Rendering(seen[0:3], seen[3], seen[4], seen[5], seen[6:9], seen[9], torch.ones(1, dtype=torch.bool))


def differentiate(loss, target, options, geometry, dtype, render, factor=1.0):
    """Terms and gradients by name for one implementation."""
    leaves = {name: getattr(render, name).to(dtype).detach().requires_grad_() for name in MAPS}
    if dtype == torch.float32:  # keep the padded rows
        leaves = {name: getattr(render, name).detach().requires_grad_() for name in MAPS}
    backdrop = torch.tensor([0.2, 0.9, 0.5], dtype=dtype)
    terms = loss(replace(render, **leaves), target, options, backdrop, geometry)
    (factor * terms.total).backward()
    return terms, {name: leaf.grad for name, leaf in leaves.items()}


@pytest.fixture(params=["on the CPU", "cuda"])
def compare(request):
    """Compares kernels with the reference: those that need no GPU, or those on the GPU."""
    if request.param == "cuda":
        try:
            find_gpu()
        except BadInput as error:
            pytest.skip(str(error))
    return partial(compare_backends, ("cuda",) if request.param == "cuda" else ("cpu", "cuda-source-on-cpu"))


def compare_backends(backends, target, options=OPTIONS, geometry=1.0, render=None, factor=1.0):
    """The kernels of the backends agree with the reference."""
    render = render or rendering(target)
    expected = differentiate(reference_losses.total_loss, target, options, geometry, torch.float64, render, factor)
    for backend in backends:
        loss = partial(total_loss, backend=backend)
        seen = on_gpu(render) if backend == "cuda" else render
        assert_agree(differentiate(loss, target, options, geometry, torch.float32, seen, factor), expected)


def on_gpu(render, device="cuda"):
    """The maps on the GPU, their rows as far apart as here."""

    def move(map):
        size = 1 + sum((n - 1) * step for n, step in zip(map.shape, map.stride(), strict=True))
        return torch.zeros(size, device=device).as_strided(map.shape, map.stride()).copy_(map)

    return replace(render, **{name: move(getattr(render, name)) for name in MAPS})


def assert_agree(found, wanted):
    (ours, gradients), (reference, expected) = found, wanted
    for name in ("total", "color", "geometry", "background"):
        difference = abs(getattr(ours, name).item() - getattr(reference, name).item())
        assert difference < VALUE_TOLERANCE * max(1.0, reference.total.item()), name
    assert (ours.error.cpu() - reference.error).abs().max() < 1e-6
    for name, want in expected.items():
        got = gradients[name]
        if want is None or want.abs().max() == 0:
            assert got is None or got.abs().max() == 0, name
            continue
        assert got.shape == want.shape
        assert (got.cpu() - want).abs().max() < GRADIENT_TOLERANCE[name] * want.abs().max(), name


@pytest.mark.parametrize("mask", ["full", "ellipse", "dot"])
@pytest.mark.parametrize("size", [(20, 37), (64, 128), (75, 293), (170, 310)])
def test_terms_and_gradients_match_the_reference(size, mask, compare):
    compare(make(*size, mask))


@pytest.mark.parametrize("size", [(2, 2), (1, 40), (3, 3), (12, 400)])
def test_tiny_and_thin_pictures_match_the_reference(size, compare):
    compare(make(*size, "full"))


SWITCHES = [
    {"multilevel_loss": False},
    {"boundary_loss": False},
    {"multilevel_loss": False, "boundary_loss": False},
    {"ssim_weight": 0.0},
    {"l1_weight": 0.0, "ssim_weight": 1.0},
    {"multilevel_lambda": 0.0},
    {"boundary_lambda": 0.0},
    {"distortion_lambda": 0.0},
    {"normal_lambda": 0.0},
    {"distortion_lambda": 0.0, "normal_lambda": 0.0},
    {"background_lambda": 0.0},
    {"multilevel_lambda": 2.0, "boundary_lambda": 0.3, "l1_weight": 0.1, "normal_lambda": 0.4},
]


@pytest.mark.parametrize("switches", SWITCHES, ids=lambda s: ",".join(s))
def test_every_switch_matches_the_reference(switches, compare):
    compare(make(70, 150), replace(OPTIONS, **switches))


def test_without_geometry_and_with_an_outer_factor(compare):
    target = make(70, 150)
    compare(target, geometry=0.0)
    compare(target, geometry=3.0)
    compare(target, factor=3.0)


def test_poor_similarity_stops_at_its_floor(compare):
    target = make(60, 90, "full")
    render = rendering(target)
    compare(target, render=replace(render, color=1 - render.color))


@pytest.mark.parametrize("variant", library.runnable_variants())
def test_every_kernel_variant_matches_the_reference(variant):
    library.use_variant(variant)
    try:
        compare_backends(("cpu",), make(75, 193))
    finally:
        library.use_variant("")


def test_threads_change_nothing_and_padding_is_no_matter():
    target = make(100, 300)
    render = rendering(target)
    found = []
    for threads in (1, 3, 2):
        library.set_threads(threads)
        found.append(differentiate(total_loss, target, OPTIONS, True, torch.float32, render))
    library.set_threads(0)
    plain = replace(render, **{name: getattr(render, name).contiguous() for name in MAPS})
    found.append(differentiate(total_loss, target, OPTIONS, True, torch.float32, plain))
    for terms, gradients in found[1:]:
        assert terms.total == found[0][0].total and torch.equal(terms.error, found[0][0].error)
        assert all(torch.equal(gradients[name], found[0][1][name]) for name in MAPS)


def test_gradients_outlive_their_graph_and_memory_is_used_again(monkeypatch):
    target = make(40, 60)
    render = rendering(target)
    _, first = differentiate(total_loss, target, OPTIONS, True, torch.float32, render)
    leaf = render.color.detach().requires_grad_()
    terms = total_loss(replace(render, color=leaf), target, OPTIONS, torch.tensor([0.2, 0.9, 0.5]), True)
    (kept,) = torch.autograd.grad(terms.total, [leaf])
    del terms
    for _ in range(3):
        differentiate(total_loss, target, OPTIONS, True, torch.float32, rendering(target, seed=5), factor=2.0)
    assert torch.equal(kept, first["color"])
    monkeypatch.setattr(buffers, "_free", [])  # blocks of other tests would do as well
    block = lasting_array(torch.float32, 3, 1000)
    view, address = block[1], block.data_ptr()
    del block
    other = lasting_array(torch.float32, 3, 1000)
    assert other.data_ptr() != address
    del view
    assert lasting_array(torch.float32, 3, 1000).data_ptr() == address


def test_arrays_that_are_kept_for_later_are_let_go(monkeypatch):
    monkeypatch.setattr(buffers, "_free", [])
    used, spare = (lasting_array(torch.float32, 1000) for _ in range(2))
    used.fill_(3)
    del spare
    buffers.release_buffers()
    assert not buffers._free and buffers._returned.empty()
    assert (used == 3).all()  # those in use stay
    del used
    assert len(lasting_array(torch.float32, 1000)) == 1000 and not buffers._free  # and serve again


def test_error_map_receives_the_error_in_its_box():
    target = make(100, 300)
    frame = torch.zeros(100, 300)
    terms = total_loss(rendering(target), target, OPTIONS, torch.zeros(3), False, frame)
    assert terms.error.data_ptr() == target.crop(frame).data_ptr() and terms.error.max() > 0
    outside = frame.clone()
    target.crop(outside).zero_()
    assert outside.abs().max() == 0


def test_outside_of_mask_and_ring_has_no_gradient():
    target = make(100, 300)
    _, gradients = differentiate(total_loss, target, OPTIONS, True, torch.float32, rendering(target))
    counts = torch.zeros(100, 300, dtype=torch.bool)
    target.crop(counts).copy_((target.labels > 0) | target.background_band)
    assert all(gradients[name][..., ~counts].abs().max() == 0 for name in MAPS)


def test_maps_are_moved_as_they_lie():
    seen = rendering(make(40, 60))
    moved = on_gpu(seen, "cpu")
    for name in MAPS:
        there, here = getattr(moved, name), getattr(seen, name)
        assert torch.equal(there, here) and there.stride() == here.stride() and there.data_ptr() != here.data_ptr()


def test_geometry_needs_all_outputs():
    target = make(40, 40)
    basic = replace(rendering(target), normal=None, distortion=None, median=None)
    with pytest.raises(ValueError, match="all outputs"):
        total_loss(basic, target, OPTIONS, torch.zeros(3), True)
