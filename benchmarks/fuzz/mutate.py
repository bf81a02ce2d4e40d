# SPDX-License-Identifier: GPL-3.0-or-later
"""Damage to files: blind (cuts, flipped bits, odd numbers anywhere) and by format (text, JSON, PNG, npz, with sums
made right again, so that the damage gets past them)."""

from __future__ import annotations

import io
import json
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

Mutator = Callable[[bytes, random.Random], bytes]

#: Bytes; what is doubled again and again would fill the memory here, not in the reader.
MAX_BYTES = 4 << 20
INTEGERS = (0, 1, 2, 255, 256, 65535, 1 << 31, (1 << 31) - 1, (1 << 32) - 1, 1 << 40, 1 << 62, (1 << 63) - 1, 1 << 63,
            (1 << 64) - 1)  # fmt: skip
FLOATS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, 1e-320, 1e300, -1e300, 1e15, -1.0)
WORDS = (
    "nan", "inf", "-inf", "1e999", "-1", "0", "99999999999999999999", "1e15", "0x10", "", " ", "\t", "\r", "é",
    "\u0000", "../../../etc/passwd", "/etc/passwd", "C:\\x", "$(touch /tmp/owned)", "; rm -rf x", "`id`", "%s%n",
    "a" * 300, "\ud800", "null", "true", "[]", "{}", "-0", "1_000", "٣", "+5", "1e-400", "--set", "NaN", "#", "\n",
)  # fmt: skip


def cut(data: bytes, rng: random.Random) -> bytes:
    """Truncated at any byte."""
    return data[: rng.randrange(len(data) + 1)]


def flip(data: bytes, rng: random.Random) -> bytes:
    """One to eight bits flipped."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def odd_number(data: bytes, rng: random.Random) -> bytes:
    """An integer or float of some width replaced by an odd one, preferably near the start, where counts are."""
    pack = rng.choice(("<B", "<H", "<I", "<Q", "<Q", "<d", "<f", ">I"))
    size = struct.calcsize(pack)
    if len(data) < size:
        return data
    end = len(data) - size
    at = rng.randint(0, min(end, 64)) if rng.random() < 0.5 else rng.randint(0, end)
    if pack[-1] == "f":
        value: float = rng.choice([v for v in FLOATS if abs(v) < 1e38 or v != v or abs(v) == float("inf")])
    elif pack[-1] == "d":
        value = rng.choice(FLOATS)
    else:
        value = rng.choice(INTEGERS) % (1 << (8 * size))
    return data[:at] + struct.pack(pack, value) + data[at + size :]


def shuffle(data: bytes, rng: random.Random) -> bytes:
    """A piece removed, doubled, moved, or replaced by noise."""
    if not data:
        return rng.randbytes(rng.randint(0, 64))
    a, b = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
    b = min(b, a + rng.choice((1, 4, 8, 24, 64, 4096)))
    piece = data[a:b]
    at = rng.randrange(len(data) + 1)
    return rng.choice((
        data[:a] + data[b:],
        data[:b] + piece + data[b:],
        data[:at] + piece + data[at:],
        data[:a] + rng.randbytes(len(piece)) + data[b:],
        data + rng.randbytes(rng.randint(1, 32)),
    ))  # fmt: skip


def text_word(data: bytes, rng: random.Random) -> bytes:
    """A word or number of a text replaced, doubled or removed."""
    text = data.decode("utf-8", "surrogateescape")
    words = list(re.finditer(r"[^\s,:\[\]{}\"]+", text))
    if not words:
        return data
    word = rng.choice(words)
    new = rng.choice((rng.choice(WORDS), str(rng.choice(INTEGERS)), str(rng.choice(FLOATS)), word.group() * 2, ""))
    return (text[: word.start()] + new + text[word.end() :]).encode("utf-8", "surrogatepass")


def text_line(data: bytes, rng: random.Random) -> bytes:
    """A line removed, doubled or swapped with another."""
    lines = data.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    how = rng.randrange(3)
    if how == 0:
        del lines[i]
    elif how == 1:
        lines.insert(j, lines[i])
    else:
        lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def json_node(data: bytes, rng: random.Random) -> bytes:
    """One value, key or container of a JSON document replaced; sometimes nested thousands deep."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):
        return flip(data, rng)
    if rng.random() < 0.01:
        depth = rng.choice((900, 20_000))
        return b'{"a":' * depth if rng.random() < 0.5 else b"[" * depth + data + b"]" * depth
    nodes: list[tuple[Any, Any]] = []
    _collect(value, nodes)
    if not nodes:
        return json.dumps(_odd_value(rng)).encode()
    parent, key = rng.choice(nodes)
    how = rng.random()
    if how < 0.15:
        del parent[key]
    elif how < 0.3 and isinstance(parent, dict):
        parent[rng.choice(WORDS)] = parent.pop(key)
    elif how < 0.4 and isinstance(parent, list):
        parent.extend(parent[:] * rng.choice((1, 30)))
    else:
        parent[key] = _odd_value(rng)
    return json.dumps(value).encode()


def _collect(value: Any, nodes: list[tuple[Any, Any]]) -> None:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in items:
        nodes.append((value, key))
        _collect(child, nodes)


def _odd_value(rng: random.Random) -> Any:
    choices: tuple[Any, ...]
    choices = (rng.choice(WORDS), rng.choice(FLOATS), rng.choice(INTEGERS), -rng.choice(INTEGERS), None, True, [], {},
               [[]], {"": None}, [None], "x" * 10_000, 10**400, [1, 2, 3], rng.random() * 100)  # fmt: skip
    return rng.choice(choices)


def png_chunk(data: bytes, rng: random.Random) -> bytes:
    """A chunk of a PNG damaged, with its checksum made right again; often the header, where the size is."""
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        return flip(data, rng)
    chunks, at = [], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append([data[at + 4 : at + 8], data[at + 8 : at + 8 + length]])
        at += 12 + length
    if not chunks:
        return flip(data, rng)
    chosen = chunks[0] if rng.random() < 0.4 else rng.choice(chunks)
    if chosen[0] == b"IHDR" and len(chosen[1]) == 13 and rng.random() < 0.7:
        head = bytearray(chosen[1])
        place = rng.choice((0, 4, 8, 9, 12))
        if place < 8:
            head[place : place + 4] = struct.pack(">I", rng.choice((0, 1, 7, 4096, 30000, 65535, 100_000, 1 << 31)))
        else:
            head[place] = rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
        chosen[1] = bytes(head)
    else:
        chosen[1] = rng.choice((cut, flip, odd_number, shuffle))(chosen[1], rng)
    body = b"".join(struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in chunks)
    return data[:8] + body


def npz_member(data: bytes, rng: random.Random) -> bytes:
    """An array of an npz damaged (type, shape, contents), removed or swapped, in an archive that is sound."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:
        return flip(data, rng)
    if not members:
        return data
    name = rng.choice(sorted(members))
    how = rng.random()
    if how < 0.1:
        del members[name]
    elif how < 0.2:
        members[name] = members[rng.choice(sorted(members))]
    elif how < 0.3:
        members[rng.choice(("../../evil.npy", "/tmp/evil.npy", "extra.npy"))] = members[name]
    elif how < 0.7:
        members[name] = _npy_header(members[name], rng)
    elif members[name][:1] == b"\x93":
        start = 10 + int.from_bytes(members[name][8:10], "little")
        body = rng.choice((flip, odd_number, cut, shuffle, json_node))(members[name][start:], rng)
        members[name] = members[name][:start] + body
        if name in ("head.npy", "state.npy"):  # JSON inside: its length is the shape
            members[name] = _npy(f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({len(body)},), }}", body)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for key, content in members.items():
            archive.writestr(key, content)
    return out.getvalue()


def _npy_header(data: bytes, rng: random.Random) -> bytes:
    if data[:1] != b"\x93":
        return flip(data, rng)
    length = int.from_bytes(data[8:10], "little")
    head, body = data[10 : 10 + length].decode("latin-1").strip(), data[10 + length :]
    shape = rng.choice(("()", "(0,)", "(1,)", "(-1,)", "(99999999999,)", "(3, 99999999)", "(1, 3, 3)",
                        "(2**62, 2**62)", "(1.5,)", "('a',)"))  # fmt: skip
    kind = rng.choice(("'|O'", "'<f8'", "'<f4'", "'|u1'", "'<i8'", "'<U4'", "'|S9999999'", "'<c16'", "'|V8'",
                       "'<M8[s]'", "[('a', '<f4')]", "'|b1'", "'>f4'", "5"))  # fmt: skip
    if rng.random() < 0.5:
        head = re.sub(r"'shape': \([^)]*\)", lambda _: f"'shape': {shape}", head)
    else:
        head = re.sub(r"'descr': [^,]*,", lambda _: f"'descr': {kind},", head)
    return _npy(head, body)


def _npy(head: str, body: bytes) -> bytes:
    raw = head.encode("latin-1")
    raw += b" " * (-(len(raw) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(raw)) + raw + body


BLIND: tuple[Mutator, ...] = (cut, flip, odd_number, shuffle)
BY_KIND: dict[str, tuple[Mutator, ...]] = {
    "binary": BLIND,
    "text": (*BLIND, text_word, text_word, text_word, text_line),
    "json": (*BLIND, text_word, json_node, json_node, json_node, json_node),
    "png": (*BLIND, png_chunk, png_chunk, png_chunk),
    "npz": (flip, cut, npz_member, npz_member, npz_member, npz_member),
}


def mutate(data: bytes, kind: str, rng: random.Random) -> bytes:
    """One to four damages of the kinds that suit the file."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        data = rng.choice(BY_KIND[kind])(data, rng)
    return data[:MAX_BYTES]
