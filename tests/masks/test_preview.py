# SPDX-License-Identifier: GPL-3.0-or-later
"""The mask of one photo, through the command line: right, in the photo's own frame, and clear about bad input."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.house import House
from mgf_engine.cli.main import main
from mgf_engine.masks.preview import one_view
from mgf_engine.options.config import make_config


def preview(house: House, out: Path, *more: str, image: str = "", prompts: Path | None = None) -> int:
    name = image or sorted(json.loads(house.prompts.read_text()))[0]
    clicks = str(prompts or house.prompts)
    return main(["preview", str(house.folder), "--prompts", clicks, "--image", name, "--out", str(out), *more])


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_mask_is_the_building_in_every_clicked_photo(house: House, tmp_path: Path):
    for name in json.loads(house.prompts.read_text()):
        assert preview(house, tmp_path / "mask.png", image=name) == 0
        mask = cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_UNCHANGED)
        assert mask.ndim == 2 and set(np.unique(mask)) == {0, 255}
        assert iou(mask > 0, house.masks[name]) > 0.9
    assert [p.name for p in tmp_path.iterdir()] == ["mask.png"]


def test_resolution_is_the_longest_side(house: House, tmp_path: Path):
    assert preview(house, tmp_path / "mask.png", "--resolution", "120") == 0
    assert max(cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_UNCHANGED).shape) == 120


@pytest.mark.parametrize(("photo", "by_all"), [("photo_00.png", False), ("photo_01.png", True)])
def test_up_in_a_photo_from_above_comes_from_all_cameras(house: House, photo: str, by_all: bool):
    """The first of the house's photos look 10 and 27 degrees below the horizon."""
    up = one_view(house.folder, photo, make_config())[2]
    assert (up is not None) == by_all
    assert up is None or up @ [0, 0, 1] > 0.999


def test_photos_alone_need_no_model(house: House, tmp_path: Path):
    (tmp_path / "images").symlink_to(house.folder / "images")
    name = sorted(json.loads(house.prompts.read_text()))[0]
    out = tmp_path / "mask.png"
    code = main(["preview", str(tmp_path), "--prompts", str(house.prompts), "--image", name, "--out", str(out)])
    assert code == 0
    mask, clicks = cv2.imread(str(out), 0) > 0, json.loads(house.prompts.read_text())[name]
    assert all(mask[int(v), int(u)] for u, v in clicks["positive"])
    assert not any(mask[int(v), int(u)] for u, v in clicks["negative"])


@pytest.mark.parametrize(
    ("image", "clicks", "out", "says"),
    [
        ("nowhere.png", None, "mask.png", "has no photo 'nowhere.png'"),
        ("", "{}", "mask.png", "has no clicks on the photo"),
        ("", '{"NAME": {"negative": [[3, 3]]}}', "mask.png", "has no click on the building"),
        ("", '{"NAME": {"positive": [[3, 9999]]}}', "mask.png", "outside the photo"),
        ("", "{", "mask.png", "is not valid JSON"),
        ("", None, "mask.jpg", "should be a PNG"),
    ],
)
def test_bad_input(
    house: House,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    image: str,
    clicks: str | None,
    out: str,
    says: str,
):
    path = None
    if clicks is not None:
        path = tmp_path / "prompts.json"
        path.write_text(clicks.replace("NAME", sorted(json.loads(house.prompts.read_text()))[0]))
    assert preview(house, tmp_path / out, image=image, prompts=path) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / out).exists()


def test_options_of_the_algorithms_decide_the_mask(house: House, tmp_path: Path, capsys):
    def mask(*more: str) -> np.ndarray:
        assert preview(house, tmp_path / "mask.png", *more) == 0
        return cv2.imread(str(tmp_path / "mask.png"), 0)

    usual = mask()
    assert (mask("--set", "superpixels.side=40") != usual).any()
    assert (mask("--set", "superpixels.side=10") == usual).all(), "its default"
    assert preview(house, tmp_path / "mask.png", "--set", "tsdf.band=2") == 2
    assert "'mgf preview' does not use the option 'tsdf.band'" in capsys.readouterr().err
