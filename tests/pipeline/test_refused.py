# SPDX-License-Identifier: GPL-3.0-or-later
"""Clicks, masks and devices that cannot be used end a job before any work, with one sentence."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from support.jobs import run_here

from benchmarks.synthetic.house import House


def test_a_gpu_that_cannot_be_used_is_refused_not_replaced(house: House, tmp_path: Path, capsys) -> None:
    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    given = (house.folder, "--prompts", house.prompts, "--out", tmp_path / "job")
    code, messages = run_here(capsys, "reconstruct", *given, "--device", "cuda")
    assert code == 2 and "--device cpu" in messages[-1]["text"]


BAD_PROMPTS = {
    "unknown image": ('{"nowhere.png": {"positive": [[5, 5]]}}', "nowhere.png"),
    "outside": ('{"photo_00.png": {"positive": [[5000, 5]]}}', "photo_00.png"),
    "none": ("{}", "click"),
    "not json": ("clicks", "JSON"),
}


@pytest.mark.parametrize("name", BAD_PROMPTS)
def test_bad_prompts_are_refused_by_name(house: House, tmp_path: Path, capsys, name: str) -> None:
    content, part = BAD_PROMPTS[name]
    prompts = tmp_path / "prompts.json"
    prompts.write_text(content)
    code, messages = run_here(capsys, "masks", house.folder, "--prompts", prompts, "--out", tmp_path / "job")
    assert code == 2
    assert part.lower() in messages[-1]["text"].lower()
    assert not (tmp_path / "job" / "masks" / "labels").exists()


def test_bad_prompts_of_a_folder_of_photos_are_refused_before_its_cameras_are_found(
    house: House, tmp_path: Path, capsys
) -> None:
    prompts = tmp_path / "prompts.json"
    command = ("reconstruct", house.folder / "images", "--prompts", prompts, "--out", tmp_path / "job")
    for content, part in BAD_PROMPTS.values():
        prompts.write_text(content)
        code, messages = run_here(capsys, *command)
        assert code == 2 and part.lower() in messages[-1]["text"].lower()
        assert not any(m["type"] == "progress" for m in messages)


def test_masks_of_other_photos_are_refused_before_the_cameras_are_found(house: House, tmp_path: Path, capsys) -> None:
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "elsewhere.png").write_bytes(b"")
    given = ("--masks", tmp_path / "masks", "--out", tmp_path / "job")
    code, messages = run_here(capsys, "reconstruct", house.folder / "images", *given)
    assert code == 2 and "fits a photo" in messages[-1]["text"]
    assert not any(m["type"] == "progress" for m in messages)


@pytest.mark.parametrize("value", [0, 255])
def test_masks_that_are_empty_or_cover_everything_are_refused(house: House, tmp_path: Path, capsys, value: int) -> None:
    folder = tmp_path / "masks"
    folder.mkdir()
    for name, mask in house.masks.items():
        cv2.imwrite(str(folder / name), np.full(mask.shape, value, np.uint8))
    code, messages = run_here(capsys, "masks", house.folder, "--masks", folder, "--out", tmp_path / "job")
    assert code == 2
    assert "mask" in messages[-1]["text"]
