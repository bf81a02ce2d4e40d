# SPDX-License-Identifier: GPL-3.0-or-later
"""LPIPS (eq. 29): perceptual distance between a photo and its render by features of a trained network.

The features of AlexNet or VGG-16, each pixel's scaled to unit length, are compared layer by layer; a trained weight per
channel says what people notice (Zhang, Isola, Efros, Shechtman and Wang 2018, version 0.1 of their weights). The
weights are never fetched by themselves: ``mgf weights --model lpips-alex`` does it on request. The networks are built
from the weights alone: torchvision, which the package ``lpips`` needs for them, cannot be imported beside a build of
torch for the CPU where its wheel is made for CUDA.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from mgf_engine.errors import BadInput
from mgf_engine.weights import WEIGHTS, check_file, default_folder

NETWORKS = {"lpips-alex": "AlexNet", "lpips-vgg": "VGG-16"}  # the first that is there is taken
#: Mean and spread of the pictures the networks were trained on, for colours in -1..1.
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
MIN_SIDE = 64  # px that the longest side of a picture must have for both networks


@dataclass(frozen=True)
class _Step:
    """A convolution and its ReLU: number of its weights, stride, padding; what pools before it; if it is compared."""

    index: int
    stride: int = 1
    padding: int = 1
    pool: tuple[int, int] = (0, 0)  # size and stride
    compared: bool = True


_STEPS: dict[str, tuple[_Step, ...]] = {
    "lpips-alex": (
        _Step(0, 4, 2), _Step(3, 1, 2, (3, 2)), _Step(6, pool=(3, 2)), _Step(8), _Step(10),
    ),
    "lpips-vgg": tuple(
        _Step(index, pool=(2, 2) if number == 0 and block else (0, 0), compared=number == len(indices) - 1)
        for block, indices in enumerate(((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28)))
        for number, index in enumerate(indices)
    ),
}  # fmt: skip


class Lpips:
    """LPIPS with one network.

    Args:
        network: key of :data:`NETWORKS`.
        trunk: weights as torchvision names them, ``features.N.weight`` and ``features.N.bias``.
        linear: ``linK.model.1.weight`` [1, channels, 1, 1] of the K-th compared layer.

    Attributes:
        name: the network's name, for people.
    """

    def __init__(self, network: str, trunk: dict[str, Tensor], linear: dict[str, Tensor]) -> None:
        self.name, self._steps = NETWORKS[network], _STEPS[network]
        self._trunk = [(trunk[f"features.{s.index}.weight"], trunk[f"features.{s.index}.bias"]) for s in self._steps]
        self._linear = [linear[f"lin{k}.model.1.weight"] for k in range(sum(s.compared for s in self._steps))]

    def distance(self, photo: NDArray[np.uint8], render: NDArray[np.uint8]) -> float | None:
        """Compute eq. 29 of two pictures RGB uint8 [h, w, 3]; None where they are too small for the network."""
        if min(photo.shape[:2]) < MIN_SIDE:
            return None
        total = 0.0
        with torch.no_grad():
            features = zip(self._features(photo), self._features(render), self._linear, strict=True)
            for a, b, weight in features:
                total += float(F.conv2d((_unit(a) - _unit(b)) ** 2, weight).mean())
        return total

    def _features(self, picture: NDArray[np.uint8]) -> list[Tensor]:
        x = torch.from_numpy(np.ascontiguousarray(picture)).permute(2, 0, 1)[None].float() / 127.5 - 1
        x = (x - torch.tensor(_SHIFT)[None, :, None, None]) / torch.tensor(_SCALE)[None, :, None, None]
        found = []
        for step, (weight, bias) in zip(self._steps, self._trunk, strict=True):
            if step.pool[0]:
                x = F.max_pool2d(x, *step.pool)
            x = F.relu(F.conv2d(x, weight, bias, step.stride, step.padding))
            if step.compared:
                found.append(x)
        return found


def _unit(features: Tensor) -> Tensor:
    """Return features [1, c, h, w] with every pixel's scaled to unit length."""
    return features / (features.square().sum(1, keepdim=True).sqrt() + 1e-10)


def find_lpips(folder: Path | None = None) -> Lpips | None:
    """Read LPIPS with the first network whose weights are there; None where none is.

    Args:
        folder: of the weights; None is the user's cache folder.

    Raises:
        BadInput: weights are there, but damaged or of another version.
    """
    folder = folder or default_folder()
    for network in NETWORKS:
        files = WEIGHTS[network]
        if all((folder / f.name).is_file() for f in files):
            for file in files:
                check_file(folder / file.name, file, folder)
            return read_lpips(network, *(folder / f.name for f in files))
    return None


def read_lpips(network: str, trunk: Path, linear: Path) -> Lpips:
    """Read LPIPS from its two files.

    Raises:
        BadInput: a file cannot be read, or is not what the network needs.
    """
    try:
        loaded = [torch.load(path, map_location="cpu", weights_only=True) for path in (trunk, linear)]
        return Lpips(network, *loaded)
    except (OSError, RuntimeError, KeyError, TypeError, EOFError, UnpicklingError) as error:
        raise BadInput(
            f"'{trunk.name}' and '{linear.name}' do not work as the weights of {network} ({error}); fetch them again "
            f"with 'mgf weights --model {network}'."
        ) from error


def how_to_get() -> str:
    """Return how to get LPIPS, as half a sentence."""
    size = sum(f.size for f in WEIGHTS["lpips-alex"]) / 1e6
    return f"'mgf weights --model lpips-alex' fetches its network ({size:.0f} MB)"
