# SPDX-License-Identifier: GPL-3.0-or-later
"""A parts file comes from a folder that anything may have written to: it is never run, and ends in one sentence."""

from __future__ import annotations

import pickle
import random
import zipfile

import numpy as np
import pytest

from mgf_blender.common.errors import UserError
from mgf_blender.results.parts import read_parts


class Bomb:
    """What a hostile pickle would do."""

    def __reduce__(self):
        return pytest.fail, ("the file was run",)


def _pickled(path):
    with path.open("wb") as file:
        pickle.dump(Bomb(), file)


def _objects(path):
    np.savez(path, names=np.array([Bomb(), Bomb()], object), face=np.zeros(16, np.uint8))


def _bare_array(path):
    with path.open("wb") as file:
        np.save(file, np.zeros(16, np.uint8))


def _encrypted(path):
    np.savez(path, names=np.array(["a"]), face=np.zeros(16, np.uint8))
    data = bytearray(path.read_bytes())
    for at in range(len(data) - 4):  # the flag in both headers of every entry
        if data[at : at + 4] in (b"PK\x03\x04", b"PK\x01\x02"):
            data[at + (6 if data[at + 2] == 3 else 8)] |= 1
    path.write_bytes(bytes(data))


def _no_names(path):
    np.savez(path, face=np.zeros(16, np.uint8))


def _single_name(path):
    np.savez(path, names=np.array("a"), face=np.zeros(16, np.uint8))


def _fractions(path):
    np.savez(path, names=np.array(["a"]), face=np.full(16, np.nan))


def _other_things(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("names.npy", "not an array")
        archive.writestr("face.npy", "nor this")


@pytest.mark.parametrize(
    "write", [_pickled, _objects, _bare_array, _encrypted, _no_names, _single_name, _fractions, _other_things]
)
def test_files_of_another_kind_are_refused_and_not_run(tmp_path, write):
    path = tmp_path / "mesh_parts.npz"
    write(path)
    with pytest.raises(UserError) as caught:
        read_parts(path, 16)
    assert str(caught.value).endswith("run the job again.") and str(path) in str(caught.value)


def test_a_missing_file_and_a_folder(tmp_path):
    for path in (tmp_path / "gone.npz", tmp_path):
        with pytest.raises(UserError, match="Cannot read"):
            read_parts(path, 16)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_flipped_bytes_give_parts_or_a_sentence(tmp_path, save):
    path, chance = tmp_path / "mesh_parts.npz", random.Random(5)
    save(path, names=np.array(["building", "door"]), face=np.arange(500) % 2)
    good, refused = path.read_bytes(), 0
    assert read_parts(path, 500).names == ["building", "door"]
    for _ in range(300):
        data = bytearray(good)
        for _ in range(chance.choice((1, 3, 30))):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(bytes(data[: chance.choice((len(data), len(data), chance.randrange(len(data))))]))
        try:
            parts = read_parts(path, 500)
        except UserError:
            refused += 1
        else:
            assert parts.face.shape == (500,) and 0 <= parts.face.min() <= parts.face.max() < len(parts.names)
    assert refused > 100
