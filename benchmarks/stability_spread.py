# SPDX-License-Identifier: GPL-3.0-or-later
"""How much the result depends on what should not matter: ``python -m benchmarks.stability_spread --seeds 10``.

The painted house is reconstructed with several seeds, with one thread and two, with each kernel variant that this
processor runs, with the CUDA sources built for the CPU, and twice the same way; F1 and PSNR of each, and whether two
equal runs are equal to the bit.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import igl
import numpy as np
import trimesh

from benchmarks.synthetic.house import House, build_house

OPTIONS = ["--iterations", "250", "--max-gaussians", "5000", "--densify-every", "50", "--level-steps", "4"]
CUDA_SOURCE = "cuda-source-on-cpu"
_WITH_CUDA_SOURCE = (
    f"import sys; from mgf_engine.raster import device; device.CPU_BACKEND = {CUDA_SOURCE!r}; "
    "from mgf_engine.cli.main import main; sys.exit(main())"
)
DISTANCE = 0.05  # metres; the house is 4 m long, a pixel on the ground about 3 cm


def reconstruct(house: House, job: Path, seed: int, threads: int, variant: str) -> dict[str, object]:
    """One run; its F1 in percent, PSNR, and the hash of its mesh."""
    engine = ["-c", _WITH_CUDA_SOURCE] if variant == CUDA_SOURCE else ["-m", "mgf_engine"]
    arguments = [sys.executable, *engine, "reconstruct", house.folder, "--prompts", house.prompts, "--out",
                 job, *OPTIONS, "--seed", seed, "--threads", threads, "--progress", "none"]  # fmt: skip
    environment = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE"}
    if variant not in ("", CUDA_SOURCE):
        environment["MGF_KERNEL_VARIANT"] = variant
    subprocess.run([str(a) for a in arguments], check=True, env=environment)
    figures = json.loads((job / "job.json").read_text())["stages"]["deliver"]["figures"]
    digest = hashlib.sha256((job / "mesh.ply").read_bytes()).hexdigest()[:12]
    return {"f1": f1(job / "mesh.ply", house), "psnr": figures["psnr"], "mesh": digest}


def f1(path: Path, house: House, distance: float = DISTANCE, count: int = 40_000) -> float:
    """F1 in percent of a mesh at a distance, floor and faces below 5 cm left out: no photo shows the floor.

    Args:
        path: of the mesh.
        house: with the true one.
        distance: in metres.
        count: of samples on each.
    """
    found, true = trimesh.load_mesh(path), trimesh.Trimesh(house.mesh.vertices, house.mesh.faces, process=False)
    ground = house.mesh.vertices[:, 2].min() + 0.05
    shares = []
    for here, there in ((found, true), (true, found)):
        points = trimesh.sample.sample_surface(here, count, seed=1)[0]
        points = points[points[:, 2] > ground]
        squared = igl.point_mesh_squared_distance(points, np.asarray(there.vertices), np.asarray(there.faces))[0]
        shares.append(float((np.sqrt(squared) < distance).mean()))
    return 200 * shares[0] * shares[1] / max(sum(shares), 1e-9)


def runs(seeds: int, variants: list[str]) -> list[tuple[str, int, int, str]]:
    """Name, seed, threads and kernel variant of each run."""
    return [
        *((f"seed {seed}", seed, 2, "") for seed in range(seeds)),
        ("the same again", 0, 2, ""),
        ("one thread", 0, 1, ""),
        ("one thread again", 0, 1, ""),
        *((f"kernels {variant}", 0, 2, variant) for variant in (*variants, CUDA_SOURCE)),
    ]


def main() -> int:
    from mgf_engine.native.library import runnable_variants

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stability_spread", description="Spread over seeds and machines."
    )
    parser.add_argument("--seeds", type=int, default=10)
    args = parser.parse_args()
    rows: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        house = build_house(Path(folder) / "house")
        for number, (name, seed, threads, variant) in enumerate(runs(args.seeds, runnable_variants())):
            rows[name] = row = reconstruct(house, Path(folder) / str(number), seed, threads, variant)
            print(f"{name:<22} F1 {row['f1']:.2f}  PSNR {row['psnr']:.2f}  mesh {row['mesh']}", flush=True)
    values = {key: [row[key] for row in rows.values()] for key in ("f1", "psnr")}
    for key, numbers in values.items():
        print(f"{key}: {min(numbers):.2f} .. {max(numbers):.2f}, spread {max(numbers) - min(numbers):.2f}")
    same = rows["seed 0"]["mesh"] == rows["the same again"]["mesh"]
    same &= rows["one thread"]["mesh"] == rows["one thread again"]["mesh"]
    print("equal runs are equal to the bit" if same else "equal runs DIFFER")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
