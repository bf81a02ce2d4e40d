# SPDX-License-Identifier: GPL-3.0-or-later
"""How work and memory grow: ``PYTHONPATH=tests python -m stability.scale --out FOLDER``.

The painted house with more and more photos, and with larger and larger ones, through the whole engine with few
iterations; and training iterations alone with more and more Gaussians. CPU seconds count all cores together, so that
other programs hardly matter. What is measured is kept in ``FOLDER/scale.json`` and not measured again.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import pycolmap
from house import WIDTH, build_house

from mgf_engine.bench.kernels import Clock, Iteration
from mgf_engine.system import write_json

PHOTOS = (20, 60, 200, 600)
PIXELS = (375, 750, 1500, 3000)
GAUSSIANS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000)
FEW = 14  # photos while pixels grow
OPTIONS = ["--iterations", "200", "--max-gaussians", "10000", "--preset", "draft", "--progress", "none"]


def enlarged(folder: Path, target: Path, width: int) -> Path:
    """A copy of a house scene with photos so many pixels wide."""
    factor = width / WIDTH
    (target / "images").mkdir(parents=True, exist_ok=True)
    for photo in sorted((folder / "images").iterdir()):
        picture = cv2.imread(str(photo))
        size = (width, round(picture.shape[0] * factor))
        cv2.imwrite(str(target / "images" / photo.name), cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC))
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    for camera in model.cameras.values():
        camera.rescale(*size)
    for image in model.images.values():
        for point in image.points2D:
            point.xy = point.xy * factor
    (target / "sparse" / "0").mkdir(parents=True, exist_ok=True)
    model.write_binary(str(target / "sparse" / "0"))
    clicks = json.loads((folder / "prompts.json").read_text())
    for photo in clicks.values():
        for kind, spots in photo.items():
            photo[kind] = [[x * factor, y * factor] for x, y in spots]
    (target / "prompts.json").write_text(json.dumps(clicks))
    return target


def whole_job(scene: Path, job: Path, resolution: int) -> dict[str, object]:
    """CPU seconds per stage and the peak memory of one job, bytes."""
    shutil.rmtree(job, ignore_errors=True)
    command = [sys.executable, "-m", "mgf_engine", "reconstruct", scene, "--prompts", scene / "prompts.json"]
    command += ["--out", job, *OPTIONS, "--resolution", resolution]
    subprocess.run([str(part) for part in command], check=True)
    stages = json.loads((job / "job.json").read_text())["stages"]
    shutil.rmtree(job)
    return {
        "cpu": {name: entry["cpu_seconds"] for name, entry in stages.items()},
        "memory": max(entry["peak_memory"] for entry in stages.values()),
    }


def iteration(count: int) -> dict[str, object]:
    """CPU milliseconds of one training iteration at 750 x 500 with so many Gaussians, as wide as they are many."""
    work, clock = Iteration(count, 750, 500, "all", 2), Clock()
    for _ in range(3):
        work.run(clock)
    return {"cpu": dict(clock.cpu)}


def measure(out: Path, photos: tuple[int, ...], pixels: tuple[int, ...], gaussians: tuple[int, ...]) -> dict[str, dict]:
    """Everything that ``scale.json`` does not have yet, kind -> size -> figures."""
    file = out / "scale.json"
    found = json.loads(file.read_text()) if file.exists() else {"photos": {}, "pixels": {}, "gaussians": {}}

    def add(kind: str, size: int, figures: dict[str, object]) -> None:
        found[kind][str(size)] = figures
        write_json(file, found)
        print(kind, size, figures, flush=True)

    for count in photos:
        if str(count) not in found["photos"]:
            house = build_house(out / "house", count)
            add("photos", count, whole_job(house.folder, out / "job", WIDTH))
            shutil.rmtree(house.folder)
    for width in pixels:
        if str(width) not in found["pixels"]:
            house = build_house(out / "house", FEW)
            add("pixels", width, whole_job(enlarged(house.folder, out / "large", width), out / "job", width))
            shutil.rmtree(house.folder)
            shutil.rmtree(out / "large")
    for count in gaussians:
        if str(count) not in found["gaussians"]:
            add("gaussians", count, iteration(count))
    return found


def chart(found: dict[str, dict], path: Path) -> None:
    """A picture for each kind that was measured: against photos, pixels and Gaussians."""
    labels = {"photos": f"photos of {WIDTH} px", "pixels": f"px, {FEW} photos", "gaussians": "Gaussians"}
    kinds = [kind for kind in labels if found[kind]]
    figure, panes = plt.subplots(1, len(kinds), figsize=(4.4 * len(kinds), 4.2), layout="constrained", squeeze=False)
    for axes, kind in zip(panes[0], kinds, strict=True):
        sizes = sorted(map(int, found[kind]))
        for part in found[kind][str(sizes[0])]["cpu"]:
            axes.plot(sizes, [found[kind][str(n)]["cpu"][part] for n in sizes], marker="o", label=part)
        whole = kind != "gaussians"
        unit = "CPU seconds" if whole else "CPU ms of an iteration, 750 x 500"
        axes.set(xlabel=labels[kind], ylabel=unit, xscale="log", yscale="log")
        axes.set_xticks(sizes, [f"{n // 1000}k" if n >= 10_000 else str(n) for n in sizes])
        axes.minorticks_off()
        axes.legend(fontsize=8, frameon=False)
        axes.grid(True, alpha=0.3)
        if whole:
            memory = axes.twinx()
            memory.plot(sizes, [found[kind][str(n)]["memory"] / 1e9 for n in sizes], "k:", marker=".")
            memory.set(ylabel="peak memory, GB (dotted)", ylim=(0, None))
    figure.savefig(path, dpi=100)
    plt.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m stability.scale", description="How work and memory grow.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the figures and the chart")
    parser.add_argument("--photos", type=int, nargs="*", default=PHOTOS)
    parser.add_argument("--pixels", type=int, nargs="*", default=PIXELS)
    parser.add_argument("--gaussians", type=int, nargs="*", default=GAUSSIANS)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    chart(measure(args.out, args.photos, args.pixels, args.gaussians), args.out / "scale.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
