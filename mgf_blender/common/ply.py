# SPDX-License-Identifier: GPL-3.0-or-later
"""Read PLY files into numpy: meshes, point clouds and Gaussian fields, binary or ASCII.

Blender's own importer rounds coordinates to float32 on the way in; scenes in national grids need the float64
of the file until the offset of the scene is taken off, so the add-on reads PLY itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .errors import UserError, reason

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_MAX_HEADER = 1 << 16
_COLORS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_KNOWN = {"x", "y", "z", "nx", "ny", "nz", "alpha", *(name for names in _COLORS for name in names)}


@dataclass
class _Element:
    name: str
    count: int
    scalars: list[tuple[str, str]] = field(default_factory=list)  # (property, numpy type)
    lists: list[tuple[str, str, str]] = field(default_factory=list)  # (property, count type, item type)


@dataclass(frozen=True)
class Ply:
    """The content of a PLY file.

    Attributes:
        vertices: property name -> array [N] in the file's own type.
        triangles: int32 [F, 3], empty for files without faces; polygons are cut into fans.
        offset: what a comment of the header ("offset X Y Z") says is to be added to the positions, float64 [3].
    """

    vertices: dict[str, np.ndarray]
    triangles: np.ndarray
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def positions(self) -> np.ndarray:
        """float64 [N, 3], the offset added."""
        return np.stack([self.vertices[axis].astype(np.float64) for axis in "xyz"], axis=1) + self.offset

    def colors(self) -> np.ndarray | None:
        """Return uint8 [N, 3] in sRGB, or None when the file has none."""
        for names in _COLORS:
            if all(n in self.vertices for n in names):
                columns = [self.vertices[n] for n in names]
                if columns[0].dtype.kind == "f":
                    columns = [np.clip(np.nan_to_num(c) * 255.0 + 0.5, 0, 255) for c in columns]
                return np.stack(columns, axis=1).astype(np.uint8)
        return None

    def extras(self) -> dict[str, np.ndarray]:
        """Return what a vertex carries beside place, normal and colour, for example ``confidence``; name -> [N]."""
        return {name: values for name, values in self.vertices.items() if name not in _KNOWN}


def read_ply(path: Path) -> Ply:
    """Read the vertices and faces of a PLY file.

    Raises:
        UserError: the file is missing, is no PLY file, or ends too early.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(
            "Cannot read '{path}' ({reason}); check that the file exists.",
            path=path,
            reason=reason(error),
        ) from error
    order, elements, start = _read_header(data, path)
    try:
        if order == "ascii":
            tables = _ascii_tables(data[start:], elements)
        else:
            tables = _binary_tables(data, start, elements, order)
    except (ValueError, IndexError, OverflowError, MemoryError) as error:
        raise UserError("'{path}' is damaged or ends too early; write the file again.", path=path) from error
    vertices, faces = tables.get("vertex"), tables.get("face")
    if not isinstance(vertices, dict) or not {"x", "y", "z"} <= set(vertices):
        raise UserError("'{path}' holds no vertices with x, y and z; it is not a mesh or point cloud.", path=path)
    triangles = faces if isinstance(faces, np.ndarray) else np.zeros((0, 3), np.int32)
    count = len(vertices["x"])
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= count):
        raise UserError("'{path}' has faces that name vertices it does not hold; write the file again.", path=path)
    return Ply(vertices, triangles, _offset(data[:start]))


def _offset(header: bytes) -> np.ndarray:
    """Return the offset of fields in map coordinates, whose positions are float32; zero without such a comment."""
    for line in header.splitlines():
        words = line.split()
        if words[:2] == [b"comment", b"offset"] and len(words) == 5:
            try:
                offset = np.array([float(word) for word in words[2:]])
            except ValueError:
                continue
            if np.isfinite(offset).all():
                return offset
    return np.zeros(3)


def _read_header(data: bytes, path: Path) -> tuple[str, list[_Element], int]:
    """Return byte order ('ascii', '<' or '>'), the elements and the offset of the first data byte."""
    end = data.find(b"end_header", 0, _MAX_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise UserError(
            "'{path}' is not a PLY file; choose a file that ends in .ply and was written as one.", path=path
        )
    start = data.find(b"\n", end) + 1
    order, elements = "", []
    try:
        for line in data[:end].decode("ascii", "replace").splitlines():
            words = line.split()
            if not words:
                continue
            if words[0] == "format":
                order = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                elements[-1].lists.append((words[4], _TYPES[words[2]], _TYPES[words[3]]))
            elif words[0] == "property":
                elements[-1].scalars.append((words[2], _TYPES[words[1]]))
        if not order or start == 0 or any(e.count < 0 for e in elements):
            raise ValueError
    except (KeyError, IndexError, ValueError) as error:
        raise UserError("The header of '{path}' is damaged; write the file again.", path=path) from error
    return order, elements, start


def _binary_tables(data: bytes, start: int, elements: list[_Element], order: str) -> dict[str, object]:
    tables: dict[str, object] = {}
    for element in elements:
        if not element.lists:
            dtype = np.dtype([(name, order + kind) for name, kind in element.scalars])
            table = np.frombuffer(data, dtype, element.count, start)
            tables[element.name] = {name: table[name] for name, _ in element.scalars}
            start += element.count * dtype.itemsize
        elif len(element.lists) == 1:
            polygons, start = _binary_faces(data, start, element, order)
            tables[element.name] = polygons
        else:
            raise ValueError("more than one list property")
    return tables


def _binary_faces(data: bytes, start: int, element: _Element, order: str) -> tuple[np.ndarray, int]:
    """Return triangles and the offset behind them; one frombuffer when every face has three corners."""
    _, count_type, item_type = element.lists[0]
    extra = [(name, order + kind) for name, kind in element.scalars]
    dtype = np.dtype([("n", order + count_type), ("v", order + item_type, 3), *extra])
    if element.count == 0:
        return np.zeros((0, 3), np.int32), start
    if len(data) - start >= element.count * dtype.itemsize:
        table = np.frombuffer(data, dtype, element.count, start)
        if np.all(table["n"] == 3):
            return table["v"].astype(np.int32), start + element.count * dtype.itemsize
    if extra:
        raise ValueError("polygons with further properties")
    head, item = np.dtype(order + count_type), np.dtype(order + item_type)
    fans = []
    for _ in range(element.count):
        n = int(np.frombuffer(data, head, 1, start)[0])
        start += head.itemsize
        corners = np.frombuffer(data, item, n, start)
        start += n * item.itemsize
        fans.extend(_fan(corners))
    return np.array(fans, np.int64).astype(np.int32).reshape(-1, 3), start


def _fan(corners: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    """Cut a polygon into triangles that share its first corner."""
    return ((corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1))


def _ascii_tables(data: bytes, elements: list[_Element]) -> dict[str, object]:
    lines = iter(data.decode("ascii", "replace").splitlines())
    tables: dict[str, object] = {}
    for element in elements:
        rows = []
        while len(rows) < element.count:
            line = next(lines, None)
            if line is None:
                raise ValueError("too few lines")
            if line.strip():
                rows.append(line.split())
        if element.lists:
            fans = []
            for row in rows:
                n = int(row[0])
                corners = [int(v) for v in row[1 : n + 1]]
                if len(corners) != n:
                    raise ValueError("face cut short")
                fans.extend(_fan(corners))
            tables[element.name] = np.array(fans, np.int32).reshape(-1, 3)
        else:
            columns = np.array(rows, dtype=np.float64).reshape(element.count, len(element.scalars))
            tables[element.name] = {name: columns[:, i].astype(kind) for i, (name, kind) in enumerate(element.scalars)}
    return tables
