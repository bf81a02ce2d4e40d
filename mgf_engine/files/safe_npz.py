# SPDX-License-Identifier: GPL-3.0-or-later
"""Read npz archives and npy files that may be damaged or hostile: nothing is allocated that the file does not hold.

numpy's own reader believes the shape in an array's header and asks for that much memory first; a damaged checkpoint
of some kilobytes then takes terabytes. Here every header is held against the bytes that are there.
"""

from __future__ import annotations

import io
import zipfile
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_KINDS = "biuf"  # plain numbers; objects would run code when they are read


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read the arrays of an archive that ``numpy.savez`` wrote (uncompressed plain numbers), by name.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such archive, is damaged, or promises more than it holds.
    """
    data = path.read_bytes()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if any(m.compress_type != zipfile.ZIP_STORED for m in members):
                raise ValueError("it is compressed")
            if sum(m.file_size for m in members) > len(data):
                raise ValueError("it promises more than it holds")
            return {m.filename.removesuffix(".npy"): _array(archive.read(m), m.filename) for m in members}
    except Exception as error:  # zipfile and numpy fail in many ways
        raise ValueError(str(error) or type(error).__name__) from error


def read_array(path: Path) -> NDArray[Any]:
    """Read the array of plain numbers in a file that ``numpy.save`` wrote.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such file, is damaged, or promises more than it holds.
    """
    data = path.read_bytes()
    try:
        return _array(data, path.name)
    except Exception as error:  # numpy fails in many ways
        raise ValueError(str(error) or type(error).__name__) from error


def _array(raw: bytes, name: str) -> NDArray[Any]:
    stream = io.BytesIO(raw)
    version = np.lib.format.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"{name} has the format {version}")
    shape, fortran, dtype = _HEADERS[version](stream)
    if dtype.kind not in _KINDS or dtype.names is not None or any(n < 0 for n in shape):
        raise ValueError(f"{name} holds {dtype} {shape}")
    start = stream.tell()
    if prod(shape) * dtype.itemsize != len(raw) - start:
        raise ValueError(f"{name} is cut off or damaged")
    flat = np.frombuffer(raw, dtype, offset=start).copy()
    return flat.reshape(shape, order="F" if fortran else "C")
