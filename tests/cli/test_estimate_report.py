# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate of a job as data and as a table."""

from __future__ import annotations

from mgf_engine.cli.estimate_report import estimate_to_dict, format_estimate
from mgf_engine.jobs.estimate import Estimate, PhotoSummary
from mgf_engine.options.config import make_config
from mgf_engine.system.memory import GB

FOUND = Estimate({"scene": 10.0, "masks": 70.04}, {"scene": 0.5 * GB, "masks": 2.0 * GB})
PHOTOS = PhotoSummary(40, (4000, 3000), placed=True, building=0.25)


def test_the_data_are_sums_and_largest_of_the_stages() -> None:
    data = estimate_to_dict(FOUND, make_config({"max_photos": 30, "threads": 3}), PHOTOS, 8 * GB)
    assert data["stages"] == {
        "scene": {"seconds": 10.0, "bytes": 0.5 * GB},
        "masks": {"seconds": 70.0, "bytes": 2 * GB},
    }
    assert (data["seconds"], data["bytes"], data["allowed"], data["second_attempt"]) == (80.0, 2 * GB, 8 * GB, 0.0)
    assert (data["photos"], data["used"], data["size"], data["threads"]) == (40, 30, [4000, 3000], 3)
    assert data["cameras_known"] and data["building"] == 0.25


def test_the_table_has_a_line_for_each_stage_and_their_sum() -> None:
    data = estimate_to_dict(FOUND, make_config({"max_photos": 30}), PHOTOS, 8 * GB)
    lines = format_estimate(data).splitlines()
    assert lines[0].startswith("40 photos of 4000 x 3000 px, 30 of them used; the building fills 25% of them;")
    assert [line.split() for line in lines if line.startswith(("scene", "masks", "together"))] == [
        ["scene", "10", "s", "0.5", "GB"], ["masks", "1", "min", "10", "s", "2.0", "GB"],
        ["together", "1", "min", "20", "s", "2.0", "GB"],
    ]  # fmt: skip
    assert lines[-1] in ("8.0 GB may be used.", data["shortage"])


def test_cameras_that_are_to_be_found_and_too_little_memory_are_said() -> None:
    unplaced = PhotoSummary(40, (4000, 3000), placed=False)
    data = estimate_to_dict(
        Estimate(FOUND.seconds, FOUND.memory, second_attempt=33.0), make_config(), unplaced, 0.05 * GB
    )  # fmt: skip
    lines = format_estimate(data).splitlines()
    assert "cameras to be found" in lines[0] and "used" not in lines[0]
    assert any(line.startswith("33 s more where structure from motion has to run twice") for line in lines)
    assert data["shortage"] and lines[-1] == data["shortage"] and "--memory" in lines[-1]
