# SPDX-License-Identifier: GPL-3.0-or-later
"""How work and memory grow: ``python -m benchmarks.stability_scale --out FOLDER``.

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
from collections.abc import Sequence
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import pycolmap

from benchmarks.kernels import Clock, Iteration
from benchmarks.synthetic.house import WIDTH, build_house
from mgf_engine.files.atomic import write_json

PHOTOS = (20, 60, 200, 600)
PIXELS = (375, 750, 1500, 3000)
GAUSSIANS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 2_000_000)
FEW = 14  # photos while pixels grow
SHARES = (1.0, 0.25, 0.12, 0.06)
OPTIONS = [
    "--iterations", "200", "--max-gaussians", "10000", "--sh-degree", "1", "--refine-rounds", "0", "--progress", "none",
]  # fmt: skip


LABELS = {
    "photos": f"photos of {WIDTH} px", "pixels": f"px, {FEW} photos", "gaussians": "Gaussians",
    "shares": "million pairs that masks leave",
}  # fmt: skip


def enlarged(folder: Path, target: Path, width: int) -> Path:
    """A copy of a house scene with photos so many pixels wide."""
    factor = width / WIDTH
    (target / "images").mkdir(parents=True, exist_ok=True)
    for photo in sorted((folder / "images").iterdir()):
        picture = cv2.imread(str(photo))
        assert picture is not None
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


def masked_iteration(share: float) -> dict[str, object]:
    """The same with 100,000 Gaussians, of which a mask over this share of the picture leaves some to be drawn."""
    work, clock = Iteration(100_000, 750, 500, "all", 2, share), Clock()
    for _ in range(5):
        work.run(clock)
    return {"cpu": dict(clock.cpu), "pairs": work.pairs}


def measure(
    out: Path, photos: Sequence[int], pixels: Sequence[int], gaussians: Sequence[int], shares: Sequence[float]
) -> dict[str, dict]:
    """Everything that ``scale.json`` does not have yet, kind -> size -> figures."""
    file = out / "scale.json"
    found = {kind: {} for kind in LABELS} | (json.loads(file.read_text()) if file.exists() else {})

    def add(kind: str, size: float, figures: dict[str, object]) -> None:
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
    for share in shares:
        if str(share) not in found["shares"]:
            add("shares", share, masked_iteration(share))
    return found


def chart(found: dict[str, dict], path: Path) -> None:
    """A picture for each kind that was measured: against photos, pixels and Gaussians."""
    kinds = [kind for kind in LABELS if found.get(kind)]
    figure, panes = plt.subplots(1, len(kinds), figsize=(4.4 * len(kinds), 4.2), layout="constrained", squeeze=False)
    for axes, kind in zip(panes[0], kinds, strict=True):
        rows = sorted(found[kind].items(), key=lambda row: float(row[0]))
        sizes = [row["pairs"] / 1e6 if kind == "shares" else int(size) for size, row in rows]
        for part in rows[0][1]["cpu"]:
            axes.plot(sizes, [row["cpu"][part] for _, row in rows], marker="o", label=part)
        whole = kind in ("photos", "pixels")
        unit = "CPU seconds" if whole else "CPU ms of an iteration, 750 x 500"
        axes.set(xlabel=LABELS[kind], ylabel=unit, xscale="log", yscale="log")
        axes.set_xticks(sizes, [_short(n) for n in sizes])
        axes.minorticks_off()
        axes.legend(fontsize=8, frameon=False)
        axes.grid(True, alpha=0.3)
        if whole:
            memory = axes.twinx()
            memory.plot(sizes, [row["memory"] / 1e9 for _, row in rows], "k:", marker=".")
            memory.set(ylabel="peak memory, GB (dotted)", ylim=(0, None))
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _short(number: float) -> str:
    """12000 as 12k, 2000000 as 2M."""
    if number >= 1e6:
        return f"{number / 1e6:g}M"
    return f"{number / 1e3:g}k" if number >= 1e4 else f"{number:.0f}"


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stability_scale", description="How work and memory grow."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the figures and the chart")
    parser.add_argument("--photos", type=int, nargs="*", default=PHOTOS)
    parser.add_argument("--pixels", type=int, nargs="*", default=PIXELS)
    parser.add_argument("--gaussians", type=int, nargs="*", default=GAUSSIANS)
    parser.add_argument("--shares", type=float, nargs="*", default=SHARES, help="of the picture that a mask leaves")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found = measure(args.out, args.photos, args.pixels, args.gaussians, args.shares)
    chart(found, args.out / "scale.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
