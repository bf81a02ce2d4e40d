# SPDX-License-Identifier: GPL-3.0-or-later
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from mgf_engine.export.stage import _offset
from mgf_engine.field.export import offset_of, rotate_sh, write_splats
from mgf_engine.model.gaussians import Gaussians, rotation_matrices
from mgf_engine.model.scene import Similarity
from mgf_engine.raster.reference import sh_basis


def random_field(count: int = 30) -> Gaussians:
    random = torch.Generator().manual_seed(0)
    return Gaussians(
        *(torch.randn(count, *s, generator=random) for s in ((3,), (3,), (4,), (), (16, 3))),
        filter_3d=torch.rand(count, generator=random) * 0.1,
    )


@pytest.mark.parametrize("seed", range(3))
def test_rotated_harmonics_give_the_same_color_in_the_turned_direction(seed: int) -> None:
    rotation = Rotation.random(random_state=seed).as_matrix()
    directions = np.random.default_rng(seed).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    coefficients = np.random.default_rng(9).normal(size=16)
    before = sh_basis(torch.from_numpy(directions @ rotation.T)).numpy() @ coefficients
    after = sh_basis(torch.from_numpy(directions)).numpy() @ (rotate_sh(rotation) @ coefficients)
    np.testing.assert_allclose(after, before, atol=1e-10)


def test_splats_are_the_same_gaussians_in_the_scene_frame(tmp_path) -> None:
    field = random_field()
    frame = Similarity(2.5, Rotation.random(random_state=1).as_matrix(), np.array([1.0, -2, 3]))
    path = tmp_path / "field Ü.ply"
    write_splats(field, frame, path)
    raw = path.read_bytes()
    header, body = raw.split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b"property")]
    table = np.frombuffer(body, "<f4").reshape(len(field), len(names))
    column = {name: table[:, i] for i, name in enumerate(names)}
    assert len(names) == 62
    position = np.stack([column[n] for n in "xyz"], 1)
    np.testing.assert_allclose(frame.apply(position.astype(float)), field.positions.numpy(), atol=1e-5)
    opacity = 1 / (1 + np.exp(-column["opacity"]))
    np.testing.assert_allclose(opacity, field.opacities.numpy(), rtol=1e-4, atol=2e-6)
    quaternion = torch.from_numpy(np.stack([column[f"rot_{i}"] for i in range(4)], 1))
    scales = np.exp(np.stack([column[f"scale_{i}"] for i in range(3)], 1)) * frame.scale
    turned = frame.rotation @ rotation_matrices(quaternion).numpy()
    covariance = np.einsum("nij,nj,nkj->nik", turned, scales**2, turned)
    own = rotation_matrices(field.rotations)
    expected = torch.einsum("nij,nj,nkj->nik", own, field.scales**2, own).numpy()
    np.testing.assert_allclose(covariance, expected, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("size", "middle", "shifted"),
    [(20.0, (392_345.0, 5_705_123.0, 61.0), True), (0.02, (39.2, 5_705.123, 0.06), True), (20.0, (9.0, 5, 1), False)],
)
def test_splats_in_map_coordinates_keep_their_precision(tmp_path, size, middle, shifted) -> None:
    field = random_field(500)
    frame = Similarity(1 / size, np.eye(3), -np.array(middle) / size)
    write_splats(field, frame, tmp_path / "field.ply")
    header, body = (tmp_path / "field.ply").read_bytes().split(b"end_header\n", 1)
    (offset,) = [[float(w) for w in line.split()[2:]] for line in header.splitlines() if b"offset" in line] or [
        [0.0] * 3
    ]
    positions = np.frombuffer(body, "<f4").reshape(500, -1)[:, :3].astype(np.float64) + offset
    expected = frame.invert(field.positions.double().numpy())
    np.testing.assert_allclose(positions, expected, atol=1e-6 * size)
    assert tuple(offset) == offset_of(field, frame)
    assert any(offset) == shifted
    named = _offset(field, SimpleNamespace(to_normalised=frame))  # in deliver.json
    assert named == ({"field_offset": offset} if shifted else {})
    assert size < 1 or all(value == round(value) for value in offset)
