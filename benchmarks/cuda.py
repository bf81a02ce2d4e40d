# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks and times the CUDA rasterizer on the GPU of this machine, in one call of a few minutes.

``python -m benchmarks.cuda`` prints the GPU, compiles every kernel for it, compares a rendering, its gradients
and the training loss with the CPU kernels, renders and trains twice to see the same bits, runs whole iterations without
waiting, and times them. ``--racecheck`` does the comparison again under every tool of compute-sanitizer where that is
installed. Figures go to standard output as Markdown, or as JSON with ``--json``; the exit code is 1 when a check fails.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from typing import Any

import torch

from benchmarks.arguments import picture_size
from mgf_engine.errors import BadInput
from mgf_engine.field.cuda_compare import Training, beyond_limits, compare, same_training
from mgf_engine.field.optimiser import TRAINED
from mgf_engine.field.synthetic import corner_view
from mgf_engine.model.gaussians import Gaussians
from mgf_engine.native.cuda import compiler
from mgf_engine.native.cuda.gpu import find_gpu
from mgf_engine.native.cuda.sources import programs
from mgf_engine.raster.api import Camera
from mgf_engine.raster.cuda import rasterizer_on

_TOOLS = ("racecheck", "memcheck", "initcheck", "synccheck")
_TOOL_SECONDS = 500.0
_BUSY = 200  # products of matrices of 4096 x 4096: about half a second on a data-centre GPU


def same_bits(n: int, width: int, height: int) -> bool:
    """Does the GPU give the same gradients twice?"""
    found: list[Gaussians] = []
    for _ in range(2):
        side = Training(n, width, height, torch.device("cuda"))
        side.forward(wait=True)[1].total.backward()
        found.append(side.optimiser.field)
    return all(torch.equal(getattr(found[0], name).grad, getattr(found[1], name).grad) for name in TRAINED)


def milliseconds(work: Any, rounds: int) -> float:
    """Return per call, from the first start to the end of the last, after a warm-up."""
    for _ in range(5):
        work()
    torch.cuda.synchronize()
    started = time.perf_counter()
    for _ in range(rounds):
        work()
    torch.cuda.synchronize()
    return 1e3 * (time.perf_counter() - started) / rounds


def timings(n: int, width: int, height: int, rounds: int) -> dict[str, float]:
    """Milliseconds of an iteration and of its forward half, entries per Gaussian, and memory."""
    torch.cuda.reset_peak_memory_stats()
    side = Training(n, width, height, torch.device("cuda"))
    with torch.no_grad():
        forward = milliseconds(lambda: side.forward(wait=False), rounds)
    iteration = milliseconds(side.iterate, rounds)
    step = side.optimiser
    bytes_moved = sum(getattr(step.field, name).numel() for name in TRAINED) * 4 * 9  # see docs/cuda.md
    room = rasterizer_on("cuda").capacity
    return {
        "iteration ms": iteration,
        "forward ms": forward,
        "GB/s of parameters, gradients and moments alone": bytes_moved / iteration / 1e6,
        "peak MiB": torch.cuda.max_memory_allocated() / 2**20,
        "iterations lost for want of room": float(room.lost),
    }


def check_waiting(n: int, camera: Camera) -> bool:
    """Does an iteration never wait for what was queued before it, but for the rendering before the last one?

    torch raises an error where one of its own operations would wait. The rest is seen on a GPU that is busy with
    something long: the host must be through with an iteration before the GPU is through with that.
    """
    side = Training(n, camera.width, camera.height, torch.device("cuda"))
    for _ in range(5):
        side.iterate()
    torch.cuda.synchronize()
    keep_busy()
    before = torch.cuda.Event()
    before.record()
    torch.cuda.set_sync_debug_mode("error")
    try:
        side.iterate()
    except RuntimeError as error:
        print(f"An iteration waits for the GPU: {error}", file=sys.stderr)
        return False
    finally:
        torch.cuda.set_sync_debug_mode("default")
    if before.query():
        print("An iteration waits for the GPU: it ended after what was queued before it.", file=sys.stderr)
        return False
    return True


def keep_busy() -> None:
    """Queue something on the GPU that takes long."""
    factor = torch.ones(4096, 4096, device="cuda")
    product = torch.empty_like(factor)
    for _ in range(_BUSY):
        torch.mm(factor, factor, out=product)


def sanitize(tool: str) -> str:
    """Runs the comparison under a tool of compute-sanitizer; returns its last line, or why there is none."""
    sanitizer = shutil.which("compute-sanitizer")
    if sanitizer is None:
        return "compute-sanitizer is not installed"
    command = [sys.executable, "-m", "benchmarks.cuda", "--only-compare", "--gaussians", "2000"]
    code, said = _run_for([sanitizer, "--tool", tool, *command], _TOOL_SECONDS)
    if code is None:
        return f"{tool} was stopped, since it took longer than {_TOOL_SECONDS:.0f} seconds; run it by itself"
    lines = [line for line in said.splitlines() if re.search(r"\b(RACECHECK|ERROR) SUMMARY:", line)]
    return lines[-1].strip("= ") if lines else f"compute-sanitizer ended with code {code}"


def found_nothing(line: str) -> bool:
    """Tell whether a line of :func:`sanitize` tells of no error, or that there is nothing that could look for one."""
    return "not installed" in line or re.search(r"SUMMARY: 0 (hazards|errors)\b", line) is not None


def _run_for(command: list[str], seconds: float) -> tuple[int | None, str]:
    """Exit code and words of a command; None for the code if it took too long, and then all of it is ended.

    Memory comes from the driver piece by piece: tools cannot look into what torch cuts up by itself.
    """
    environment = {**os.environ, "PYTORCH_NO_CUDA_MEMORY_CACHING": "1"}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment, start_new_session=True
    )
    try:
        said, _ = process.communicate(timeout=seconds)
        return process.returncode, said
    except subprocess.TimeoutExpired:
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)  # the sanitizer, and the process that it looks at
        process.wait()
        return None, ""


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--size", type=picture_size, default="750x500", help="size of the picture")
    parser.add_argument("--rounds", type=int, default=100)
    parser.add_argument("--only-compare", action="store_true", help="compare with the CPU, and nothing else")
    parser.add_argument("--racecheck", action="store_true", help="compare again under compute-sanitizer's tools")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    given = parser.parse_args(arguments)
    try:
        found = find_gpu()
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    width, height = given.size
    figures: dict[str, Any] = {"gpu": vars(found)}
    figures["differences from the CPU"] = compare(given.gaussians, width, height)
    failed = beyond_limits(figures["differences from the CPU"])
    if not given.only_compare:
        started = time.perf_counter()
        usage = [u for p in programs() for u in compiler.compile_program(p, found.architecture).usage]
        figures["seconds to compile"] = time.perf_counter() - started
        figures["kernels"] = [vars(u) for u in usage]
        figures["same bits twice"] = same_bits(given.gaussians, width, height)
        figures["same training twice"] = same_training(given.gaussians, width, height)
        figures["never waits"] = check_waiting(given.gaussians, corner_view(width, height))
        figures["timings"] = timings(given.gaussians, width, height, given.rounds)
        failed += [name for name in ("same bits twice", "same training twice", "never waits") if not figures[name]]
    if given.racecheck:
        figures["compute-sanitizer"] = {tool: sanitize(tool) for tool in _TOOLS}
        failed += [tool for tool, line in figures["compute-sanitizer"].items() if not found_nothing(line)]
    _print(figures, given.json)
    for name in failed:
        print(f"Failed: {name}", file=sys.stderr)
    return 1 if failed else 0


def _print(figures: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(figures, indent=1))
        return
    for name, value in figures.items():
        if name == "kernels":
            continue
        if not isinstance(value, dict):
            print(f"- {name}: {value}")
            continue
        print(f"\n| {name} | |\n|---|---|")
        for key, entry in value.items():
            print(f"| {key} | {entry if not isinstance(entry, float) else f'{entry:.4g}'} |")


if __name__ == "__main__":
    sys.exit(main())
