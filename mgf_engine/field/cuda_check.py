# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf doctor --gpu``: forward, gradients and a short training on this machine's GPU against the CPU, in a minute.

A GPU that passes is remembered, and ``--device auto`` takes it from then on; see ``docs/cuda.md``.
"""

from __future__ import annotations

import time

import torch

from mgf_engine.errors import EXIT_DONE, EXIT_FAULT
from mgf_engine.field import cuda_compare
from mgf_engine.field.schedule import rates_at
from mgf_engine.native.cuda.checked_gpus import approve, driver_version, withdraw
from mgf_engine.native.cuda.gpu import find_gpu

GAUSSIANS, WIDTH, HEIGHT, ROUNDS = 20_000, 480, 320, 100
#: Difference of the last loss on GPU and CPU, as a share of what the training took off the first.
TRAINING_LIMIT = 0.02


def check_gpu() -> int:
    """Check the GPU and print what was found; returns 0 if it passed and was remembered, else 1.

    Raises:
        BadInput: there is no GPU that can be used.
    """
    found, started = find_gpu(), time.perf_counter()
    print(f"GPU: {found.name}, {found.memory / 2**30:.0f} GiB, driver {driver_version()}")
    try:
        failed = differences(GAUSSIANS, WIDTH, HEIGHT, ROUNDS)
    except RuntimeError as error:  # torch's and the driver's way to say that a kernel failed
        words = str(error).strip().splitlines() or [type(error).__name__]
        failed = [f"it stopped ({words[0].rstrip('.')})"]
    seconds = time.perf_counter() - started
    if failed:
        withdraw(found)
        print(f"Problem: The GPU did not pass: {'; '.join(failed)}. '--device auto' keeps using the CPU.")
        return EXIT_FAULT
    approve(found)
    print(f"The GPU passed in {seconds:.0f} s; '--device auto' uses it from now on.")
    return EXIT_DONE


def differences(n: int, width: int, height: int, rounds: int) -> list[str]:
    """Compare GPU and CPU and print every figure; returns the differences in words, none if all is well.

    Args:
        n: number of Gaussians.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        rounds: iterations of the training.
    """
    figures = cuda_compare.compare(n, width, height)
    for name, value in figures.items():
        print(f"  {name:<32} {value:.2g}")
    failed = [f"{name} differs from the CPU's by {figures[name]:.2g}" for name in cuda_compare.beyond_limits(figures)]
    apart = compare_trainings(n, width, height, rounds)
    print(f"  {f'training, {rounds} iterations':<32} {apart:.2g}")
    if not apart <= TRAINING_LIMIT:
        text = f"after {rounds} iterations its training differs from the CPU's by {apart:.0%} of what was learned"
        failed.append(text)
    if not cuda_compare.same_training(n, width, height):
        failed.append("the same training twice gives two results")
    return failed


def compare_trainings(n: int, width: int, height: int, rounds: int) -> float:
    """Measure the difference of the losses at the end of one training on the GPU and on the CPU, per loss taken off
    there.

    Args:
        n: number of Gaussians.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
        rounds: iterations of the training.
    """
    first, last = zip(*(_train(n, width, height, rounds, name) for name in ("cpu", "cuda")), strict=True)
    return abs(last[0] - last[1]) / max(first[0] - last[0], 1e-12)


def _train(n: int, width: int, height: int, rounds: int, device: str) -> tuple[float, float]:
    side = cuda_compare.Training(n, width, height, torch.device(device))
    losses = []
    for _ in range(rounds):
        seen, terms = side.forward(wait=True)
        terms.total.backward()
        side.optimiser.step(rates_at(0.5), seen.visible, 0.05)
        losses.append(terms.total.detach())
    return float(losses[0]), float(losses[-1])
