# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasters as GeoTIFF: tiled, compressed, with overviews, placed in the drawing's frame or in the job's CRS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgf_engine.drawings.model import DrawingFrame, Survey
from mgf_engine.drawings.project import Grid
from mgf_engine.drawings.vector_files import file_shift
from mgf_engine.files.atomic import atomic_path

TILE = 256
MIN_OVERVIEW_SIDE = 256  # px; no overview is smaller


def write_geotiff(path: Path, bands: NDArray[Any], grid: Grid, survey: Survey, tags: dict[str, str]) -> None:
    """Write a raster: RGBA uint8 [H, W, 4], or one band of float32 [H, W] with NaN for what is unknown.

    A plan lies in the CRS where x is east; any other drawing lies in its own frame (x along, y up), and tags tell
    where that is: ``ORIGIN``, ``X_AXIS``, ``Y_AXIS``, ``NORMAL`` in coordinates of the tag ``CRS``.

    Args:
        path: of the file.
        bands: RGBA uint8 [H, W, 4], or float32 [H, W].
        grid: pixels of the drawing.
        survey: for the CRS.
        tags: further tags of the file.
    """
    import rasterio
    from rasterio.enums import ColorInterp, Resampling
    from rasterio.io import MemoryFile

    colored = bands.ndim == 3
    planes = np.moveaxis(bands, 2, 0) if colored else bands[None]
    profile: dict[str, Any] = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "count": len(planes), "dtype": planes.dtype,
        "tiled": True, "blockxsize": TILE, "blockysize": TILE, "compress": "deflate",
        "predictor": 2 if colored else 3, "bigtiff": "if_safer", **placement(grid, survey),
    }  # fmt: skip
    if colored:
        profile["photometric"] = "RGB"
    else:
        profile["nodata"] = float("nan")
    with MemoryFile(ext=path.suffix) as memory:  # GDAL does not say that a disk is full
        with memory.open(**profile) as file:
            if colored:
                file.colorinterp = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha]
            file.write(planes)
            file.update_tags(**frame_tags(grid.frame, survey), **tags)
        with rasterio.open(memory.name, "r+") as file:
            file.build_overviews(_overviews(grid), Resampling.average)
        with atomic_path(path) as temporary:
            temporary.write_bytes(memory.getbuffer())


def placement(grid: Grid, survey: Survey) -> dict[str, Any]:
    """Return ``crs`` and ``transform`` of a raster, as rasterio takes them."""
    from rasterio.crs import CRS
    from rasterio.transform import from_origin

    frame = grid.frame
    left, top = np.array([grid.left, grid.top]) + file_shift(frame, survey)
    transform = from_origin(left, top, grid.resolution, grid.resolution)
    if in_crs(frame, survey):
        return {"crs": CRS.from_user_input(survey.georeference.crs), "transform": transform}
    unit = 'UNIT["metre",1]' if survey.georeference.metric else 'UNIT["unknown",1]'
    return {
        "crs": CRS.from_wkt(f'LOCAL_CS["{frame.name}",{unit},AXIS["x",EAST],AXIS["y",NORTH]]'),
        "transform": transform,
    }


def in_crs(frame: DrawingFrame, survey: Survey) -> bool:
    """Tell whether the axes of a drawing are those of the job's CRS."""
    return bool(frame.from_above and frame.x[0] > 0.999999 and survey.georeference.crs is not None)


def frame_tags(frame: DrawingFrame, survey: Survey) -> dict[str, str]:
    """Return the tags that place a drawing in the world: a point (x, y) of it is ``ORIGIN + x X_AXIS + y Y_AXIS``."""
    vectors = {"X_AXIS": frame.x, "Y_AXIS": frame.y, "NORMAL": frame.normal}
    axes = {name: _numbers(vector @ survey.turn) for name, vector in vectors.items()}
    origin = frame.to_local(np.append(-file_shift(frame, survey), 0.0))
    return {
        "ORIGIN": _numbers(survey.world(origin)), **axes,
        "CRS": survey.georeference.crs or "scene", "UNIT": survey.georeference.unit,
    }  # fmt: skip


def _numbers(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.9g}" if abs(value) < 10 else f"{value:.6f}" for value in values)


def _overviews(grid: Grid) -> list[int]:
    factors: list[int] = []
    while max(grid.width, grid.height) / 2 ** (len(factors) + 1) >= MIN_OVERVIEW_SIDE:
        factors.append(2 ** (len(factors) + 1))
    return factors or [2]
