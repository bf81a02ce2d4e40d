# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos of every kind end up as RGB, turned the right way, or are refused."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from benchmarks.synthetic.colmap_scene import photo_of, reconstruction, write_photo
from mgf_engine.errors import BadInput
from mgf_engine.files.images import apply_orientation, read_info, read_rgb, resize, write_png


@pytest.fixture(scope="module")
def rgb() -> np.ndarray:
    return photo_of(reconstruction().cameras[1])


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".ppm", ".jpg", ".webp"])
def test_formats(suffix: str, rgb: np.ndarray, tmp_path: Path) -> None:
    path = write_photo(tmp_path / ("Foto \u00e4 \u5c4b" + suffix), rgb)
    read = read_rgb(path)
    assert read.dtype == np.uint8 and read.shape == rgb.shape
    assert np.abs(read.astype(int) - rgb).mean() < (3.0 if suffix in (".jpg", ".webp") else 1e-9)
    assert (read_info(path).width, read_info(path).height) == (rgb.shape[1], rgb.shape[0])


def test_depths_and_channels(rgb: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "x.png"
    bgr = rgb[:, :, ::-1]
    cv2.imwrite(str(path), (bgr.astype(np.uint16) << 8) + 77)
    assert np.abs(read_rgb(path).astype(int) - rgb).max() <= 1
    cv2.imwrite(str(path), np.dstack([bgr, np.zeros(rgb.shape[:2], np.uint8)]))
    assert np.array_equal(read_rgb(path), rgb)
    cv2.imwrite(str(path), rgb[:, :, 0])
    assert np.array_equal(read_rgb(path), np.repeat(rgb[:, :, :1], 3, 2))
    Image.fromarray(rgb).quantize(64).save(path)
    assert read_rgb(path).shape == rgb.shape
    assert np.abs(read_rgb(path).astype(int) - rgb).mean() < 15


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_rotation_agrees_with_opencv(orientation: int, rgb: np.ndarray, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(rgb).save(tmp_path / "x.jpg", exif=exif, quality=95)
    info = read_info(tmp_path / "x.jpg")
    assert info.orientation == orientation
    expected = read_rgb(tmp_path / "x.jpg", turn=True)
    assert np.array_equal(apply_orientation(read_rgb(tmp_path / "x.jpg"), orientation), expected)
    assert info.turned_size == (expected.shape[1], expected.shape[0])


@pytest.mark.parametrize("content", [b"", b"not a picture", b"\xff\xd8\xff\xe0" + b"\0" * 100, b"\x89PNG\r\n\x1a\n"])
def test_unreadable_photos(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.jpg"
    path.write_bytes(content)
    for read in (read_rgb, read_info):
        with pytest.raises(BadInput, match="cannot be read"):
            read(path)
    with pytest.raises(BadInput, match="does not exist"):
        read_info(tmp_path / "none.jpg")
    with pytest.raises(BadInput):
        read_rgb(tmp_path / "none.jpg")


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_cut_off_photos_are_refused(suffix: str, rgb: np.ndarray, tmp_path: Path) -> None:
    path = write_photo(tmp_path / ("x" + suffix), rgb)
    data = path.read_bytes()
    for share in (0.3, 0.6, 0.95):
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(BadInput, match="cannot be read"):
            read_rgb(path)


def test_a_photo_with_a_thumbnail_and_a_video_behind_it(rgb: np.ndarray, tmp_path: Path) -> None:
    path = write_photo(tmp_path / "x.jpg", rgb)
    plain = path.read_bytes()
    thumbnail = cv2.imencode(".jpg", rgb[::8, ::8])[1].tobytes()
    comment = b"\xff\xfe" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    whole = plain[:2] + comment + plain[2:]
    path.write_bytes(whole + b"\0ftypmp4" * 30_000)
    assert np.array_equal(read_rgb(path), cv2.cvtColor(cv2.imdecode(np.frombuffer(plain, np.uint8), 1), 4))
    path.write_bytes(whole[: len(comment) + 2000])
    with pytest.raises(BadInput, match="cannot be read"):
        read_rgb(path)


def test_a_header_with_a_mad_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.bmp"
    path.write_bytes(
        struct.pack("<2sIHHIIiiHHIIiiII", b"BM", 54, 0, 0, 54, 40, 1 << 30, 1 << 30, 1, 24, 0, 0, 0, 0, 0, 0)
    )
    with pytest.raises(BadInput):
        read_rgb(path)


def test_resizing_averages(rgb: np.ndarray) -> None:
    small = resize(rgb, rgb.shape[1] // 4, rgb.shape[0] // 4)
    blocks = rgb.reshape(rgb.shape[0] // 4, 4, rgb.shape[1] // 4, 4, 3).mean((1, 3))
    assert np.abs(small - blocks).max() <= 0.51


def test_png_is_exact_and_leaves_nothing_behind(rgb: np.ndarray, tmp_path: Path) -> None:
    write_png(tmp_path / "x.png", rgb)
    assert np.array_equal(read_rgb(tmp_path / "x.png"), rgb)
    assert [p.name for p in tmp_path.iterdir()] == ["x.png"]
