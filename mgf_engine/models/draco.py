# SPDX-License-Identifier: GPL-3.0-or-later
"""Draco compression of GLB files: positions, texture coordinates and faces take about a tenth.

Format: glTF 2.0 with KHR_draco_mesh_compression; the compressed data by Google's Draco in DracoPy.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.files.atomic import atomic_path

EXTENSION = "KHR_draco_mesh_compression"
POSITION_BITS, TEXTURE_BITS = 16, 14  # half a millimetre on a building of 30 m; a quarter pixel of 4096
LEVEL = 7  # of Draco's effort, 0..10
_KINDS = {"POSITION": 0, "COLOR_0": 2, "TEXCOORD_0": 3}  # attribute -> what Draco calls it
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_TYPES = {5121: np.uint8, 5125: np.uint32, 5126: np.float32}
_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def compress_glb(path: Path) -> None:
    """Compress the one mesh of a GLB of ours in place; its picture and node stay as they are."""
    tree, binary = read_glb(path)
    primitive = tree["meshes"][0]["primitives"][0]
    attributes = {name: row for name, row in primitive["attributes"].items() if name in _KINDS}
    arrays = {name: read_accessor(tree, binary, row) for name, row in attributes.items()}
    faces = read_accessor(tree, binary, primitive["indices"]).reshape(-1, 3)
    data, points, count, ids = _encoded(arrays, faces)
    # What the accessors describe comes out of the extension; only they are left of the plain arrays.
    for row in (*attributes.values(), primitive["indices"]):
        for key in ("bufferView", "byteOffset"):
            tree["accessors"][row].pop(key, None)
    for row in attributes.values():
        tree["accessors"][row]["count"] = len(points)
    place = tree["accessors"][attributes["POSITION"]]
    place["min"], place["max"] = points.min(0).tolist(), points.max(0).tolist()
    tree["accessors"][primitive["indices"]] = {"componentType": 5125, "type": "SCALAR", "count": 3 * count}
    primitive["attributes"] = attributes
    pictures = [_view(tree, binary, image["bufferView"]) for image in tree.get("images", [])]
    parts: list[bytes] = []
    tree["bufferViews"] = []
    for part in (*pictures, data):
        begun = sum(len(p) for p in parts)
        tree["bufferViews"].append({"buffer": 0, "byteOffset": begun, "byteLength": len(part)})
        parts.append(part + b"\0" * (-len(part) % 4))
    for number, image in enumerate(tree.get("images", [])):
        image["bufferView"] = number
    primitive["extensions"] = {EXTENSION: {"bufferView": len(pictures), "attributes": ids}}
    for key in ("extensionsUsed", "extensionsRequired"):
        tree[key] = sorted({*tree.get(key, []), EXTENSION})
    _write_glb(path, tree, b"".join(parts))


def _encoded(
    arrays: dict[str, NDArray[Any]], faces: NDArray[Any]
) -> tuple[bytes, NDArray[np.float32], int, dict[str, int]]:
    """Return Draco's bytes; the points and the number of faces that come out of them; attribute -> its number in
    there."""
    import DracoPy

    colors, uv = arrays.get("COLOR_0"), arrays.get("TEXCOORD_0")
    data = DracoPy.encode(
        np.asarray(arrays["POSITION"], np.float32), faces.astype(np.uint32), quantization_bits=POSITION_BITS,
        compression_level=LEVEL, colors=None if colors is None else np.ascontiguousarray(colors, np.uint8),
        tex_coord=None if uv is None else np.asarray(uv, np.float64), tex_coord_quantization_bits=TEXTURE_BITS,
    )  # fmt: skip
    back = DracoPy.decode(data)
    number_of = {own["attribute_type"]: int(own["unique_id"]) for own in back.attributes}
    ids = {name: number_of[_KINDS[name]] for name in arrays}
    return data, np.asarray(back.points, np.float32), len(back.faces), ids


def read_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    """Read the JSON and the binary part of a GLB."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def read_accessor(tree: dict[str, Any], binary: bytes, row: int) -> NDArray[Any]:
    """Read an array of a GLB, [count, components]."""
    accessor = tree["accessors"][row]
    width = _COUNTS[accessor["type"]]
    begun = accessor.get("byteOffset", 0)
    data = _view(tree, binary, accessor["bufferView"])
    kind = _TYPES[accessor["componentType"]]
    return np.frombuffer(data, kind, accessor["count"] * width, begun).reshape(-1, width)


def _view(tree: dict[str, Any], binary: bytes, row: int) -> bytes:
    view = tree["bufferViews"][row]
    begun = view.get("byteOffset", 0)
    return binary[begun : begun + view["byteLength"]]


def _write_glb(path: Path, tree: dict[str, Any], binary: bytes) -> None:
    """Write a GLB of its JSON part and its one binary buffer."""
    tree["buffers"] = [{"byteLength": len(binary)}]
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    with atomic_path(path) as temporary:
        temporary.write_bytes(
            head + struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(binary), _BINARY) + binary
        )
