# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawings read by programs of others: DXF by GDAL, GeoTIFF by Pillow, sheets by PDFium."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pypdfium2
import pytest
import rasterio
import shapely
from PIL import Image

from tests.drawings.test_lines import segments


def test_gdal_reads_the_lines_of_every_dxf_in_their_layers(drawings: Path) -> None:
    files = sorted(drawings.glob("*.dxf"))
    assert len(files) >= 6
    for file in files:
        fields, _, shapes, columns = pyogrio.raw.read(file)
        layers = columns[list(fields["fields"]).index("Layer")]
        lines = shapely.from_wkb(shapes)
        for layer, true in segments(file).items():
            length = sum(float(shapely.length(lines[k])) for k in np.flatnonzero(layers == layer) if _is_line(lines[k]))
            wanted = sum(float(np.linalg.norm(b - a)) for a, b in true)
            assert length == pytest.approx(wanted, rel=1e-6), (file.name, layer)


def _is_line(shape: Any) -> bool:
    return shape is not None and int(shapely.get_type_id(shape)) in (1, 2, 5)  # line, ring, lines


def test_pillow_reads_the_pixels_of_an_orthophoto(drawings: Path) -> None:
    path = drawings / "orthophoto-A.tif"
    with Image.open(path) as picture, rasterio.open(path) as file:
        assert picture.size == (file.width, file.height) and picture.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(picture), np.moveaxis(file.read(), 0, 2))


def test_pdfium_shows_every_sheet_in_its_size_with_its_title(drawings: Path) -> None:
    files = sorted(drawings.glob("sheet-*.pdf"))
    assert files
    for file in files:
        document = pypdfium2.PdfDocument(file)
        page = document[0]
        assert len(document) == 1 and [round(side * 25.4 / 72) for side in page.get_size()] == [420, 297]  # A3
        assert "MGF" in page.get_textpage().get_text_range() and "1:" in page.get_textpage().get_text_range()
        ink = np.asarray(page.render(scale=1.0).to_pil().convert("L")) < 128
        assert 0.001 < ink.mean() < 0.5, file.name
