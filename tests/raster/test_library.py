# SPDX-License-Identifier: GPL-3.0-or-later
"""Building and loading the kernel libraries."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mgf_engine.native import build, library
from mgf_engine.native.parallel import parallel_map


def test_best_variant_is_loaded_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MGF_KERNEL_VARIANT", raising=False)
    library.use_variant("")
    assert library.variant() == library.runnable_variants()[-1]


def test_environment_chooses_the_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    name = library.runnable_variants()[0]
    monkeypatch.setenv("MGF_KERNEL_VARIANT", name)
    library.use_variant("")
    assert library.variant() == name
    monkeypatch.delenv("MGF_KERNEL_VARIANT")
    library.use_variant("")


def test_unknown_variant_is_refused() -> None:
    with pytest.raises(RuntimeError, match="choose"):
        library.use_variant("z80")


def test_missing_library_says_how_to_build_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(library, "library_path", lambda target, variant: tmp_path / f"{variant}.so")
    library._open.cache_clear()
    with pytest.raises(RuntimeError, match=r"python -m mgf_engine\.native\.build"):
        library.use_variant("")
    library._open.cache_clear()


def test_broken_library_says_how_to_build_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "broken.so").write_bytes(b"not a library")
    monkeypatch.setattr(library, "library_path", lambda target, variant: tmp_path / "broken.so")
    library._open.cache_clear()
    with pytest.raises(RuntimeError, match="cannot be loaded"):
        library.use_variant("")
    library._open.cache_clear()


def test_a_library_built_before_this_engine_says_how_to_build_it() -> None:
    with pytest.raises(library.NoKernels, match=r"older than this engine.*python -m mgf_engine\.native\.build"):
        library.parallel("mgf_a_kernel_of_next_year", 1)
    assert not hasattr(library.library(), "__array_interface__")


def test_build_rebuilds_only_what_changed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    kernels = tmp_path / "kernels"
    kernels.mkdir()
    (kernels / "one.c").write_text('__attribute__((visibility("default"))) int one(void) { return 1; }\n')
    monkeypatch.setattr(build, "KERNELS", kernels)
    monkeypatch.setattr(build, "LIBRARIES", tmp_path / "lib")
    (path,) = build.build(["linux-x86_64"], ["x86-64"])
    first = path.stat().st_mtime_ns
    assert build.build(["linux-x86_64"], ["x86-64"]) == [path] and path.stat().st_mtime_ns == first
    (kernels / "one.c").write_text("int broken(")
    with pytest.raises(RuntimeError, match="failed"):
        build.build(["linux-x86_64"], ["x86-64"])
    assert path.stat().st_mtime_ns == first, "a failed build must leave the library that works"
    assert [p.name for p in path.parent.glob("partial*")] == []


def test_command_line_refuses_unknown_targets() -> None:
    command = [sys.executable, "-m", "mgf_engine.native.build", "--targets", "amiga-68000"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and "invalid choice" in done.stderr


def test_libraries_are_up_to_date() -> None:
    """The tests run the kernels in the tree, not an older build of them."""
    before = {p: p.stat().st_mtime_ns for p in build.LIBRARIES.glob("*.so")}
    build.build()
    after = {p: p.stat().st_mtime_ns for p in build.LIBRARIES.glob("*.so")}
    assert before == after, "the libraries were stale and have been rebuilt; run the tests again"


@pytest.mark.parametrize("count", [1, 2, 3])
def test_pieces_side_by_side_come_in_order_and_few_are_ahead(count: int) -> None:
    library.set_threads(count)
    done: list[int] = []

    def work(number: int) -> tuple[int, int]:
        done.append(number)
        return number, library.own_threads()

    for taken, result in enumerate(parallel_map(work, range(20))):
        assert result == (taken, 1) and len(done) <= taken + 1 + 2 * count + 1
    assert sorted(done) == list(range(20)) and library.own_threads() == count
    library.set_threads(0)


def test_a_piece_that_fails_ends_the_others() -> None:
    def work(number: int) -> int:
        if number == 3:
            raise ValueError("three")
        return number

    taken = []
    with pytest.raises(ValueError, match="three"):
        for number in parallel_map(work, range(1000)):
            taken.append(number)
    assert taken == [0, 1, 2]
    assert list(parallel_map(work, [])) == []
