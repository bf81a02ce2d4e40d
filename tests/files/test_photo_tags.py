# SPDX-License-Identifier: GPL-3.0-or-later
"""The tags of photos come from their headers, which are read once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from benchmarks.synthetic.colmap_scene import load, reconstruction, write_scene
from mgf_engine.files.images import read_info
from mgf_engine.files.photo_tags import read_photo_tags

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:d="http://www.dji.com/drone-dji/1.0/" d:GimbalPitchDegree="-90" d:GimbalRollDegree="0"/>'
    "</rdf:RDF></x:xmpmeta>"
)


def save_tagged(photo: Image.Image, path: Path) -> None:
    """Write a PNG that was taken straight down, by its XMP."""
    info = PngImagePlugin.PngInfo()
    info.add_itxt("XML:com.adobe.xmp", XMP)
    photo.save(path, "PNG", pnginfo=info)


def test_tags_of_a_png_are_read_without_decoding_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_tagged(Image.new("RGB", (8, 6)), tmp_path / "a.png")
    monkeypatch.setattr(PngImagePlugin.PngImageFile, "load_prepare", lambda self: pytest.fail("decoded"))
    monkeypatch.setattr(PngImagePlugin.PngImageFile, "load", lambda self: pytest.fail("decoded"))
    for tags in (read_photo_tags(tmp_path / "a.png"), read_info(tmp_path / "a.png").tags):
        assert np.allclose(tags.up, (0, 0, -1))


def test_the_scene_stage_reads_each_header_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_scene(reconstruction(), tmp_path / "scene")
    photos = sorted((source / "images").iterdir())
    for path in photos:
        with Image.open(path) as photo:
            save_tagged(photo.copy(), path)
    opened: list[str] = []
    plain = Image.open
    monkeypatch.setattr(Image, "open", lambda path, *rest: opened.append(Path(path).name) or plain(path, *rest))
    scene = load(source, tmp_path / "job")
    assert all(np.allclose(view.gravity, (0, 0, -1)) for view in scene.views)
    assert sorted(opened) == sorted(path.name for path in photos)
