# SPDX-License-Identifier: GPL-3.0-or-later
"""The short form of the fuzzer, the cases that once were findings, and what readers must never contain."""

from __future__ import annotations

import random
import re
import resource
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.fuzz.mutate import mutate
from benchmarks.fuzz.targets import TARGETS
from benchmarks.fuzz.worker import try_reading
from mgf_engine.errors import BadInput
from mgf_engine.files.images import png_size, read_info
from mgf_engine.files.safe_npz import read_arrays

ROOT = Path(__file__).parents[2]
CASES = ROOT / "benchmarks" / "fuzz" / "cases"
KEPT = sorted(p for p in CASES.glob("*/*") if p.is_dir())
QUICK = sorted(set(TARGETS) - {"scene-stage"})
SHORT = {name: max(10, round(150 * target.weight)) for name, target in TARGETS.items()}


@pytest.mark.parametrize("name", TARGETS)
def test_sound_files_are_read(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    TARGETS[name].prepare(folder)
    assert try_reading(name, folder) == ("ok", "")


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_are_read_or_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    target = TARGETS[name]
    target.prepare(folder)
    rng = random.Random(name)
    outcomes = []
    for _ in range(SHORT[name]):
        file = rng.choice(list(target.files))
        sound = (folder / file).read_bytes()
        (folder / file).write_bytes(mutate(sound, target.files[file], rng))
        outcomes.append(try_reading(name, folder))
        assert outcomes[-1][0] != "finding", outcomes[-1]
        (folder / file).write_bytes(sound)
        shutil.rmtree(folder / "job" / "scene", ignore_errors=True)
    assert name in ("ply", "photos") or "refused" in {kind for kind, _ in outcomes}


@pytest.mark.parametrize("case", KEPT, ids=lambda p: f"{p.parent.name}-{p.name}")
def test_what_once_was_a_finding_stays_mended(case: Path, tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    TARGETS[case.parent.name].prepare(folder)
    for file in (p for p in case.rglob("*") if p.is_file() and p.name != "what.txt"):
        shutil.copy(file, folder / file.relative_to(case))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    kind, text = try_reading(case.parent.name, folder)
    assert kind != "finding", text
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200 << 10


@settings(max_examples=150)
@given(junk=st.binary(max_size=300), name=st.sampled_from(QUICK), pick=st.integers(0, 9))
def test_files_of_junk_never_do_worse_than_bad_input(
    junk: bytes, name: str, pick: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("junk")
    target = TARGETS[name]
    target.prepare(folder)
    (folder / list(target.files)[pick % len(target.files)]).write_bytes(junk)
    kind, text = try_reading(name, folder)
    assert kind != "finding", text
    shutil.rmtree(folder)


# ---- arrays that promise more than they hold -----------------------------------------------------------------------


def archive(path: Path, header: str, body: bytes, kind: int = zipfile.ZIP_STORED) -> Path:
    raw = header.encode() + b" " * (-(len(header) + 11) % 64) + b"\n"
    with zipfile.ZipFile(path, "w", kind) as out:
        out.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(raw).to_bytes(2, "little") + raw + body)
    return path


def test_arrays_are_read_as_numpy_writes_them(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.zeros((0, 3), np.float32), "c": np.array(5, np.int64),
              "d": np.asfortranarray(np.arange(6).reshape(2, 3)), "e": np.array([True, False])}  # fmt: skip
    np.savez(tmp_path / "x.npz", **arrays)  # type: ignore[arg-type]
    found = read_arrays(tmp_path / "x.npz")
    assert set(found) == set(arrays)
    for name, value in arrays.items():
        assert found[name].dtype == value.dtype
        np.testing.assert_array_equal(found[name], value)
        assert found[name].flags.writeable


@pytest.mark.parametrize(
    ("header", "body"),
    [
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }", b"12345678"),
        ("{'descr': '|S9999999', 'fortran_order': False, 'shape': (288,), }", b"x"),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }", b""),
        ("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"cos\nsystem\n(S'touch /tmp/owned'\ntR."),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }", b"12345678"),
        ("__import__('os').system('true')", b""),
    ],
)
def test_arrays_that_promise_more_or_run_code_are_refused(header: str, body: bytes, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_arrays(archive(tmp_path / "x.npz", header, body))


def test_archives_that_unpack_to_more_than_the_file_are_refused(tmp_path: Path) -> None:
    header = "{'descr': '|u1', 'fortran_order': False, 'shape': (50000000,), }"
    path = archive(tmp_path / "x.npz", header, bytes(50_000_000), zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 100_000
    with pytest.raises(ValueError, match="compressed"):
        read_arrays(path)


def test_the_header_of_a_large_png_is_read_without_decoding_it(tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "large.png"
    Image.new("L", (12_000, 12_000)).save(path)  # 144 MB of zeros in a small file
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    info = read_info(path)
    assert (info.width, info.height, info.orientation) == (12_000, 12_000, 1)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50 << 10


def test_a_png_whose_chunk_promises_too_much_has_no_size(tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "small.png"
    Image.new("L", (7, 5)).save(path)
    data = path.read_bytes()
    assert png_size(data) == (7, 5)
    assert png_size(data[:-1]) is None
    at = data.index(b"IDAT") - 4
    assert png_size(data[:at] + b"\x7f\xff\xff\xff" + data[at + 4 :]) is None


# ---- what must not be there at all ---------------------------------------------------------------------------------

DANGEROUS = re.compile(
    r"\bpickle\b(?!=False| import UnpicklingError$)|allow_pickle=True|torch\.load\((?!.*weights_only=True)|shell=True|"
    r"os\.system\(|\beval\(|\bexec\((?!\"\"\))|yaml\.load\("
)


def test_nothing_unpickles_evaluates_or_calls_a_shell() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for package in ("mgf_engine", "mgf_blender")
        for path in sorted((ROOT / package).rglob("*.py"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if DANGEROUS.search(line.split("#")[0])
    ]
    assert found == []


@pytest.mark.parametrize("text", ["a\nb", "a\x1b[31mb", "a\u2028b", "a\x00b"])
def test_refusals_are_one_line_of_printable_text(text: str) -> None:
    assert str(BadInput(f"{text}.")) in ("a b.", "a [31mb.")


def test_refusals_can_always_be_printed() -> None:
    assert str(BadInput("broken \ud800 letter.")).encode("utf-8").endswith(b" letter.")
