# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels for another processor family, run in an emulator and compared with the twin.

Needs ``qemu-aarch64`` (Debian: ``apt install qemu-user``); skipped where it is missing.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from rendered import OUTPUTS, TOLERANCES, TRAINED, camera, gaussians, random_weights, run

from mgf_engine.raster import build, reference

KERNELS = ("project", "bin", "blend", "blend_backward", "project_backward")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("qemu-aarch64") is None, reason="needs qemu-aarch64 (apt install qemu-user)")
def test_neon_agrees_with_the_twin(tmp_path: Path) -> None:
    program = tmp_path / "driver"
    sources = [str(build.KERNELS / f"{name}.c") for name in KERNELS]
    flags = [f for f in build.FLAGS if f not in ("-shared", "-fPIC")]
    target = ["-static", "-target", "aarch64-linux-musl", f"-mcpu={build.VARIANTS['aarch64']['neon']}"]
    driver = str(Path(__file__).parent / "foreign" / "driver.c")
    subprocess.run(
        [sys.executable, "-m", "ziglang", "cc", *flags, *target, "-o", str(program), *sources, driver], check=True
    )

    field, view = gaussians(150, seed=1), camera()
    certain = ~reference.uncertain(field, view, 3, None, TOLERANCES["plain"].margin)
    weights = random_weights(view, OUTPUTS, 0, certain)
    expected = run(field, view, "reference", weights, torch.zeros(view.height, view.width), sh_degree=3)
    tiles_y, tiles_x = view.tiles
    header = np.array([150, view.width, view.height, 3, tiles_x, tiles_y], np.int64)
    arrays = [view.packed(), *vars(field).values(), *(weights[name].float() for name in OUTPUTS)]
    given = header.tobytes() + b"".join(a.contiguous().numpy().tobytes() for a in arrays)
    done = subprocess.run(["qemu-aarch64", str(program)], input=given, capture_output=True, check=True)

    found = torch.from_numpy(np.frombuffer(done.stdout, np.float32).copy())
    image = found[: 12 * 256 * tiles_x * tiles_y].view(12, 16 * tiles_y, 16 * tiles_x)[:, : view.height, : view.width]
    planes = {"color": image[0:3], "alpha": image[3], "depth": image[4], "median": image[5], "normal": image[6:9]}
    for name, plane in {**planes, "distortion": image[9]}.items():
        a = getattr(expected.rendering, name).detach()
        assert ((a - plane).abs() * certain).max() <= TOLERANCES["plain"].image * a.abs().max().clamp_min(1.0), name
    gradients = found[12 * 256 * tiles_x * tiles_y :].split([450, 450, 600, 150, 7200])
    for name, gradient in zip(TRAINED, gradients, strict=True):
        a = expected.gradients[name]
        assert (a - gradient.view(a.shape)).abs().max() <= TOLERANCES["plain"].gradient * a.abs().max(), name
