# SPDX-License-Identifier: GPL-3.0-or-later
"""How near the blending kernels come to what the processor can do: ``python -m benchmarks.roofline``.

Both limits are measured: multiply-adds on registers alone (``csrc/common/peak.c``), and reading and writing large
arrays. Operations are counted from the source, per pixel of a block in which something was blended (``OPERATIONS``);
pixels of blocks that a footprint touches in vain are work, but no use, and do not count. All rates are per second of
CPU time of one core, so that they hold on a busy machine.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
import torch

from benchmarks.arguments import picture_size
from mgf_engine.field.synthetic import corner_view, synthetic_building
from mgf_engine.native import library
from mgf_engine.raster import cpu

#: Additions, multiplications and the like per pixel and Gaussian with all outputs, as ``blend.c`` and
#: ``blend_backward.c`` write them; a reciprocal counts as three, 2^x as fourteen; comparisons and masks not at all.
OPERATIONS = {"blend": 80, "blend backward": 137}
PIXELS_PER_BLOCK = 16
_PEAK_PIECES = 400
_COPY_BYTES = 1 << 28


@dataclass(frozen=True)
class Kernel:
    """One kernel on one picture.

    Attributes:
        cpu_ms: CPU milliseconds of all threads.
        pairs: pairs of Gaussian and pixel in blocks where something was blended.
        operations, bytes: of these pairs; read and written once each.
        gflops, share: operations per nanosecond of CPU time, and their share of what the roofline allows.
    """

    name: str
    cpu_ms: float
    pairs: int
    operations: int
    bytes: int
    gflops: float
    share: float


@dataclass(frozen=True)
class Roofline:
    """Limits of one core: operations per nanosecond, bytes per nanosecond; and the kernels below them."""

    variant: str
    peak: float
    bandwidth: float
    kernels: list[Kernel]


def measure(gaussians: int, width: int, height: int, rounds: int = 5) -> Roofline:
    """Measure the roofline of the loaded kernel variant on a synthetic building seen by one camera."""
    peak, bandwidth = _peak(rounds), _bandwidth(rounds)
    field, camera = synthetic_building(gaussians), corner_view(width, height)
    raw = cpu.Parameters.of_field(field)
    lists = cpu.list_tiles(raw, camera, 2, None)
    image, hits = cpu.blend(lists, geometry=True)
    outputs = _gradients(width, height)
    pairs = PIXELS_PER_BLOCK * int(np.bitwise_count(hits.numpy().view(np.uint16)).sum(dtype=np.int64))
    planes = 4 * image.numel()
    per_entry = 4 * cpu.RECORD + 4 + 4 + 2
    moved = {
        "blend": lists.entries * per_entry + planes,
        "blend backward": lists.entries * (per_entry + 4 * cpu.SUMS) + planes + 4 * 10 * width * height,
    }
    work: dict[str, Callable[[], object]] = {
        "blend": lambda: cpu.blend(lists, geometry=True),
        "blend backward": lambda: cpu.blend_backward(lists, image, hits, outputs, None, False),
    }
    kernels = []
    for name, run in work.items():
        seconds = _fastest(run, rounds)
        operations = OPERATIONS[name] * pairs
        rate = operations / seconds / 1e9
        limit = min(peak, bandwidth * operations / moved[name])
        kernels.append(Kernel(name, 1e3 * seconds, pairs, operations, moved[name], rate, rate / limit))
    return Roofline(library.variant(), peak, bandwidth, kernels)


def _gradients(width: int, height: int) -> cpu.OutputGradients:
    planes = torch.randn(10, height, width, generator=torch.Generator().manual_seed(0))
    alpha, depth, median, distortion = planes[3], planes[4], planes[5], planes[9]
    return cpu.OutputGradients(planes[0:3].contiguous(), alpha, depth, median, planes[6:9].contiguous(), distortion)


def _peak(rounds: int) -> float:
    result = np.zeros(1, np.float32)
    operations = library.call("mgf_peak_operations") * _PEAK_PIECES
    return operations / _fastest(lambda: library.parallel("mgf_peak", _PEAK_PIECES, result), rounds) / 1e9


def _bandwidth(rounds: int) -> float:
    """Bytes read and written per nanosecond by a large copy."""
    source, target = (np.ones(_COPY_BYTES // 4, np.float32) for _ in range(2))
    return 2 * _COPY_BYTES / _fastest(lambda: np.copyto(target, source), rounds) / 1e9


def _fastest(run: Callable[[], object], rounds: int) -> float:
    """Least CPU seconds of several runs."""
    best = np.inf
    for _ in range(rounds):
        started = time.process_time()
        run()
        best = min(best, time.process_time() - started)
    return float(best)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--size", type=picture_size, default="750x500", help="size of the picture")
    parser.add_argument("--rounds", type=int, default=7, help="the fastest of so many counts")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    width, height = given.size
    found = []
    for name in library.runnable_variants():
        library.use_variant(name)
        found.append(measure(given.gaussians, width, height, given.rounds))
    library.use_variant("")
    if given.json:
        print(json.dumps([asdict(roofline) for roofline in found], indent=1))
        return 0
    for roofline in found:
        print(f"\n{roofline.variant}, one core: {roofline.peak:.0f} operations/ns, {roofline.bandwidth:.1f} bytes/ns")
        for k in roofline.kernels:
            print(
                f"  {k.name:15s} {k.cpu_ms:6.1f} ms  {k.pairs / 1e6:.1f} M pairs  {k.operations / k.bytes:4.1f} "
                f"operations/byte  {k.gflops:5.1f} operations/ns  {k.share:.0%} of the roofline"
            )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
