# SPDX-License-Identifier: GPL-3.0-or-later
"""Every kernel on ARM and Windows, by tests that know its result; ``tools/foreign_kernels.py`` runs more."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from foreign.remote import EMULATORS, PACKAGES, emulator_of, exported, kernels_of, start
from mgf_engine.geometry.rasterize import corners
from mgf_engine.model.scene import View
from mgf_engine.model.topology import Adjacency
from mgf_engine.native import build

#: As few tests as call every kernel, the rasterizer's and the losses' with gradients.
FEW = [
    "tests/raster/test_render_edges.py::test_edge_case[cpu:x86-64-pancakes]",
    "tests/raster/test_render_edges.py::test_edge_case[cpu:x86-64-near plane]",
    "tests/raster/test_adam.py::test_agrees_with_torch_optim[cpu:x86-64]",
    "tests/raster/test_point_opacity.py::test_matches_the_reference[cpu-4.0-many]",
    "tests/field/test_losses.py::test_every_kernel_variant_matches_the_reference[x86-64]",
    "tests/model/test_topology.py",
    "tests/geometry/test_rasterize.py",
    "tests/geometry/test_delaunay.py::test_they_are_those_of_the_definition",
    "tests/mesh/test_tsdf.py",
    "tests/mesh/test_photometric.py::test_kernel_equals_its_reference[x86-64]",
    "tests/mesh/test_depth_smoothing.py::test_the_kernel_agrees_with_its_reference",
    "tests/mesh/test_planar_clustering.py::test_a_box_keeps_its_shape_with_a_third_of_the_vertices",
    "tests/mesh/test_decimate.py::test_a_flat_wall_needs_few_faces_and_its_edges_stay",
    "tests/mesh/test_decimate.py::test_rims_stay_where_they_are",
    "tests/mesh/test_decimate.py::test_the_count_is_met_where_tolerances_ask_for_more[6.0]",
    "tests/mesh/test_colors.py",
    "tests/start/test_start_kernels.py",
    "tests/start/test_cut_graph.py",
    "tests/start/test_smoothing.py::test_kernel_and_reference_agree[x86-64]",
    "tests/masks/refinement/test_patch_ncc.py",
    "tests/masks/geometry/test_point_surface.py",
    "tests/masks/propagation/test_superpixels.py",
    "tests/scene/test_patch_match.py::test_kernel_equals_its_reference[x86-64-True]",
]
#: They only measure speed, which means nothing in an emulator.
TIMED = {"mgf_peak", "mgf_peak_operations"}
#: Wine's own server was seen to end under load, with every result right until then; a wrong kernel is wrong each time.
TRIES = 3


def tool():
    spec = importlib.util.spec_from_file_location("foreign_kernels", Path("tools/foreign_kernels.py").resolve())
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("target", ["linux-aarch64", "windows-x86_64"])
def test_every_kernel_agrees_with_its_reference(target: str) -> None:
    if emulator_of(target) is None:
        pytest.skip(f"needs {EMULATORS[target]} ({PACKAGES[EMULATORS[target]]})")
    code, calls = 1, []
    for _ in range(TRIES):
        code, calls = tool().run(target, ["-k", "not v3 and not v4 and not quick", "--tb=short", *FEW])
        if code == 0:
            break
    assert code == 0
    assert set(exported()) - set(calls) == TIMED


@pytest.mark.skipif(build.host_target() != "linux-x86_64", reason="the host process is tried on Linux x86-64")
def test_what_goes_through_the_host_is_what_comes_without(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points, faces = rng.normal(size=(500, 3)), rng.integers(0, 500, (900, 3)).astype(np.int32)
    view = View("a", "a.png", 60, 40, 50.0, 50.0, 30.0, 20.0, np.eye(3), np.array([0, 0, 4.0]), 60, 40)

    def work() -> list[np.ndarray]:
        around = Adjacency.of(faces, 500)
        return [*around.fans(), around.open_edges(), around.vertex_normals(points), corners(points, view)]

    expected = work()
    with kernels_of(start("linux-x86_64", tmp_path)) as remote:
        found = work()
    assert remote.calls["mgf_vertex_fans"] == 1 and len(remote.calls) == 5
    for a, b in zip(expected, found, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


def test_a_kernel_that_crashes_is_an_error_and_no_hang(tmp_path: Path) -> None:
    if emulator_of("linux-x86_64") is None:
        pytest.skip("the host process is tried on Linux x86-64")
    with kernels_of(start("linux-x86_64", tmp_path)), pytest.raises(RuntimeError, match="ended with code"):
        Adjacency.of(np.full((9, 3), 1 << 28, np.int32), 5)
