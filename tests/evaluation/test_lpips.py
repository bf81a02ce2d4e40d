# SPDX-License-Identifier: GPL-3.0-or-later
"""LPIPS on networks of the true shape with an eighth of the channels, and on the real weights where they are.

MGF_TEST_LPIPS=~/.cache/mgf/weights .venv/bin/python -m pytest tests/evaluation/test_lpips.py
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
import torch

from mgf_engine.cli.main import main
from mgf_engine.errors import BadInput
from mgf_engine.evaluation.images import score
from mgf_engine.evaluation.lpips import MIN_SIDE, NETWORKS, Lpips, find_lpips, read_lpips
from mgf_engine.weights import WEIGHTS, WeightFile

VARIABLE = "MGF_TEST_LPIPS"
#: Network -> channels of each convolution, the numbers of its weights, its windows, and what is compared.
SHAPES = {
    "lpips-alex": ([64, 192, 384, 256, 256], [0, 3, 6, 8, 10], [11, 5, 3, 3, 3], [0, 1, 2, 3, 4]),
    "lpips-vgg": ([64, 64, 128, 128, 256, 256, 256, *[512] * 6], [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28],
                  [3] * 13, [1, 3, 6, 9, 12]),
}  # fmt: skip


def small_weights(network: str, folder: Path) -> tuple[Path, Path]:
    """Two files as the real ones are named and laid out, random, an eighth as wide."""
    generator = torch.Generator().manual_seed(4)
    channels, numbers, windows, compared = SHAPES[network]
    trunk, before = {}, 3
    for count, number, window in zip(channels, numbers, windows, strict=True):
        shape = (count // 8, before, window, window)
        spread = (2 / (before * window**2)) ** 0.5
        trunk[f"features.{number}.weight"] = spread * torch.randn(shape, generator=generator)
        trunk[f"features.{number}.bias"] = 0.1 * torch.randn(count // 8, generator=generator)
        before = count // 8
    linear = {f"lin{k}.model.1.weight": torch.rand(1, channels[layer] // 8, 1, 1, generator=generator)
              for k, layer in enumerate(compared)}  # fmt: skip
    paths = tuple(folder / file.name for file in WEIGHTS[network])
    folder.mkdir(parents=True, exist_ok=True)
    torch.save(trunk, paths[0])
    torch.save(linear, paths[1])
    return paths


def install(network: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The small weights, known by their own checksums."""
    paths = small_weights(network, folder)
    files = tuple(WeightFile(p.name, p.stat().st_size, hashlib.sha256(p.read_bytes()).hexdigest()) for p in paths)
    monkeypatch.setitem(WEIGHTS, network, files)
    return folder


def pictures(height: int = 96, width: int = 120) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    photo = generator.integers(0, 256, (height // 8, width // 8, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    render = np.clip(photo + generator.normal(0, 40, photo.shape), 0, 255).astype(np.uint8)
    return photo, render


def by_hand(network: str, paths: tuple[Path, Path], photo: np.ndarray, render: np.ndarray) -> float:
    """Eq. 29 from torch's own layers, put together as the networks' authors describe them."""
    trunk, linear = (torch.load(path, weights_only=True) for path in paths)
    _, numbers, windows, compared = SHAPES[network]
    layers, taps = [], []
    for position, number in enumerate(numbers):
        if network == "lpips-alex" and position in (1, 2):
            layers.append(torch.nn.MaxPool2d(3, 2))
        if network == "lpips-vgg" and position in (2, 4, 7, 10):
            layers.append(torch.nn.MaxPool2d(2, 2))
        weight = trunk[f"features.{number}.weight"]
        stride, padding = (4, 2) if windows[position] == 11 else (1, windows[position] // 2)
        convolution = torch.nn.Conv2d(weight.shape[1], weight.shape[0], weight.shape[2:], stride, padding).double()
        convolution.load_state_dict({"weight": weight, "bias": trunk[f"features.{number}.bias"]})
        layers += [convolution, torch.nn.ReLU()]
        if position in compared:
            taps.append(len(layers))
    total = 0.0
    with torch.no_grad():
        for k, tap in enumerate(taps):
            features = []
            for picture in (photo, render):
                x = torch.from_numpy(picture / 255.0).permute(2, 0, 1) * 2 - 1
                x = (x - torch.tensor([-0.030, -0.088, -0.188])[:, None, None].double()) / torch.tensor(
                    [0.458, 0.448, 0.450]
                )[:, None, None].double()
                features.append(torch.nn.functional.normalize(torch.nn.Sequential(*layers[:tap])(x[None]), dim=1))
            squared = (features[0] - features[1]) ** 2
            total += float((squared * linear[f"lin{k}.model.1.weight"].double()).sum(1).mean())
    return total


@pytest.mark.parametrize("network", list(NETWORKS))
def test_it_is_equation_29(network: str, tmp_path: Path) -> None:
    paths = small_weights(network, tmp_path)
    measure = read_lpips(network, *paths)
    photo, render = pictures()
    assert measure.distance(photo, photo) == 0.0
    found = measure.distance(photo, render)
    assert found is not None and found > 0.01
    assert found == pytest.approx(by_hand(network, paths, photo, render), rel=1e-4)
    nearer = ((photo.astype(int) + render) // 2).astype(np.uint8)
    assert measure.distance(photo, nearer) < found


def test_the_box_of_the_mask_and_the_whole_frame(tmp_path: Path) -> None:
    measure = read_lpips("lpips-alex", *small_weights("lpips-alex", tmp_path))
    photo, render = pictures(160, 200)
    mask = np.zeros((160, 200), bool)
    mask[30:130, 20:120] = True
    scores = score(photo, render, mask, measure)
    zeroed = [np.where(mask[..., None], p, 0).astype(np.uint8) for p in (photo, render)]
    assert scores.lpips == measure.distance(*(p[30:130, 20:120] for p in zeroed))
    assert scores.lpips_frame == measure.distance(*zeroed) and scores.lpips_frame < scores.lpips
    small = np.zeros((160, 200), bool)
    small[150:160, 0:5] = True  # widened to what the networks need
    assert score(photo, render, small, measure).lpips > 0
    tiny = score(photo[:40, :40], render[:40, :40], np.ones((40, 40), bool), measure)
    assert MIN_SIDE > 40 and tiny.lpips is None and tiny.lpips_frame is None and tiny.psnr is not None


def test_weights_are_found_checked_and_never_fetched_by_themselves(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("mgf_engine.weights._fetch", lambda *a: pytest.fail("fetched"))
    assert find_lpips(tmp_path) is None
    folder = install("lpips-vgg", tmp_path / "here", monkeypatch)
    assert find_lpips(folder).name == "VGG-16"
    install("lpips-alex", folder, monkeypatch)
    assert find_lpips(folder).name == "AlexNet"
    (folder / "alex.pth").write_bytes(b"x")
    with pytest.raises(BadInput, match="damaged or of another version"):
        find_lpips(folder)


def test_files_of_another_network_are_refused_in_one_sentence(tmp_path: Path) -> None:
    trunk, linear = small_weights("lpips-alex", tmp_path)
    for pair in ((linear, trunk), (trunk, Path(__file__))):
        with pytest.raises(BadInput, match="do not work as the weights of lpips-alex") as caught:
            read_lpips("lpips-alex", *pair)
        assert "mgf weights --model lpips-alex" in str(caught.value)


def test_the_command_takes_them_from_a_folder(tmp_path: Path, monkeypatch, capsys) -> None:
    source = install("lpips-alex", tmp_path / "stick", monkeypatch)
    command = ["weights", "--model", "lpips-alex", "--from", str(source), "--folder", str(tmp_path / "weights")]
    assert main(command) == 0
    assert isinstance(find_lpips(tmp_path / "weights"), Lpips)
    assert main([*command[:-3], str(tmp_path / "nowhere"), "--folder", str(tmp_path / "weights")]) == 2


@pytest.mark.skipif(
    not os.environ.get(VARIABLE),
    reason=f"{VARIABLE} names no folder with the real weights of LPIPS, which are not part of the project",
)
def test_real_weights() -> None:
    measure = find_lpips(Path(os.environ[VARIABLE]).expanduser())
    assert measure is not None
    photo, render = pictures()
    assert measure.distance(photo, photo) == 0.0 and 0.01 < measure.distance(photo, render) < 1.5
