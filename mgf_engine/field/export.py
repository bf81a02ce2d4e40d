# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a field as a standard 3D Gaussian splatting PLY in the scene frame, with the 3D filter fused in.

Readers of such files expect float32, which far from the origin (UTM) would put Gaussians onto steps of half a metre.
There the positions are written less an offset, which a comment of the header names: ``comment offset X Y Z``.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from mgf_engine.files.atomic import atomic_path
from mgf_engine.geometry.mesh_files import needs_double
from mgf_engine.model.gaussians import Gaussians, rotation_matrices
from mgf_engine.model.scene import Similarity
from mgf_engine.raster.reference import sh_basis

_OPACITY_LIMIT = 1e-6


def write_splats(field: Gaussians, to_normalised: Similarity, path: Path) -> None:
    """Write ``field`` (normalised frame) as a 3DGS PLY in the scene frame, less :func:`offset_of` it.

    Properties per Gaussian: x y z, nx ny nz (zero), f_dc_0..2, f_rest_0..44 (channel by channel), opacity
    (logit), scale_0..2 (log), rot_0..3 (w x y z).
    """
    with torch.no_grad():
        opacity = field.opacities.double().clamp(_OPACITY_LIMIT, 1 - _OPACITY_LIMIT).numpy()
        scales = field.scales.double().clamp_min(1e-12).numpy()
        rotations = rotation_matrices(field.rotations.double()).numpy()
    positions = to_normalised.invert(field.positions.detach().double().numpy())
    rotations = to_normalised.rotation.T @ rotations
    sh = np.einsum("ab,nbc->nac", rotate_sh(to_normalised.rotation), field.sh.detach().double().numpy())
    offset = offset_of(field, to_normalised)
    columns = [
        positions - offset,
        np.zeros((len(field), 3)),
        sh[:, 0],
        sh[:, 1:].transpose(0, 2, 1).reshape(len(field), 45),
        np.log(opacity / (1 - opacity))[:, None],
        np.log(scales / to_normalised.scale),
        _quaternions(rotations),
    ]
    names = [
        *"xyz", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45)), "opacity",
        *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)),
    ]  # fmt: skip
    header = "ply\nformat binary_little_endian 1.0\ncomment MGF field, scene coordinates\n"
    if any(offset):
        header += f"comment offset {' '.join(map(repr, offset))}\n"
    header += f"element vertex {len(field)}\n" + "".join(f"property float {name}\n" for name in names) + "end_header\n"
    with atomic_path(path) as temporary:
        temporary.write_bytes(header.encode() + np.concatenate(columns, 1).astype("<f4").tobytes())


def offset_of(field: Gaussians, to_normalised: Similarity) -> tuple[float, float, float]:
    """Return the offset of ``field.ply``: zero, or near the middle where float32 would be too coarse.

    Whole numbers, in scenes smaller than one unit as many decimals as their size has.
    """
    positions = to_normalised.invert(field.positions.detach().cpu().double().numpy())
    if not needs_double(positions):
        return (0.0, 0.0, 0.0)
    digits = max(0, -math.floor(math.log10(max(float(np.ptp(positions, axis=0).max()), 1e-12))))
    x, y, z = (round(float(middle), digits) for middle in np.median(positions, axis=0))
    return (x, y, z)


def rotate_sh(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return [16, 16] matrix M with ``Y(d) @ (M c) = Y(rotation @ d) @ c`` for every direction d.

    Found by least squares over more directions than coefficients, which is exact because rotations keep each
    degree's space.
    """
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    here = sh_basis(torch.from_numpy(directions)).numpy()
    there = sh_basis(torch.from_numpy(directions @ rotation.T)).numpy()
    return np.linalg.lstsq(here, there, rcond=None)[0]


def _quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(rotations).as_quat(), 1, axis=1)
