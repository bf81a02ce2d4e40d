# SPDX-License-Identifier: GPL-3.0-or-later
"""Write line drawings as DXF, with a layer for each kind of line, and as SVG, in real lengths."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from mgf_engine.drawings.model import (
    CREASE,
    CUT,
    DETAIL,
    HATCH,
    OUTLINE,
    PART,
    STEP,
    Array,
    DrawingFrame,
    LineDrawing,
    Survey,
    rings_of,
)
from mgf_engine.drawings.model import pen_width as pen
from mgf_engine.files.atomic import atomic_path

_COLORS = {CUT: 1, OUTLINE: 7, STEP: 7, CREASE: 8, DETAIL: 9, HATCH: 8}  # AutoCAD's numbers; parts are blue
_METRES, _NO_UNIT = 6, 0  # $INSUNITS
_HATCH = 3.0  # millimetres on paper between the lines of a hatch
_ANSI31 = 3.175  # millimetres between those of the pattern ANSI31


def file_shift(frame: DrawingFrame, survey: Survey) -> Array:
    """Return the offset of drawing coordinates in files, [2]: easting and northing of the CRS, or height."""
    east, north, height = survey.georeference.offset
    if frame.from_above:
        return np.array([east, north]) if frame.x[0] > 0.999999 else np.zeros(2)
    return np.array([0.0, height]) if abs(frame.normal[2]) < 1e-6 else np.zeros(2)


def layer_name(layer: str) -> str:
    """Return a layer as people read it."""
    return layer.removeprefix(PART).replace("_", " ").lower()


def write_dxf(path: Path, drawing: LineDrawing, survey: Survey, scale: float) -> None:
    """Write DXF (R2010): polylines on layers by kind, areas hatched; the unit is the metre where it is known.

    Args:
        path: of the file.
        drawing: its lines and areas.
        survey: what it is a drawing of.
        scale: N of a print at 1:N, for the distance of the hatch's lines.
    """
    import ezdxf

    document = ezdxf.new("R2010", setup=True)  # type: ignore[attr-defined]
    document.header["$INSUNITS"] = _METRES if survey.georeference.metric else _NO_UNIT
    document.header["$MEASUREMENT"] = 1
    for layer in _layers(drawing):
        document.layers.add(layer, color=_COLORS.get(layer, 5), lineweight=round(100 * pen(layer)))
    space, shift = document.modelspace(), file_shift(drawing.frame, survey)
    for line in drawing.lines:
        closed = len(line.points) > 2 and bool((line.points[0] == line.points[-1]).all())
        points = (line.points[:-1] if closed else line.points) + shift
        space.add_lwpolyline(points.tolist(), close=closed, dxfattribs={"layer": line.layer})
    for area in drawing.areas:
        hatch = space.add_hatch(dxfattribs={"layer": HATCH})
        hatch.set_pattern_fill("ANSI31", scale=scale / 1000 * _HATCH / _ANSI31)
        for number, ring in enumerate(rings_of(area)):
            outer = number == 0
            hatch.paths.add_polyline_path((ring[:-1] + shift).tolist(), is_closed=True, flags=int(outer))
    with atomic_path(path) as temporary:
        document.saveas(temporary)


def write_svg(path: Path, drawing: LineDrawing, survey: Survey, scale: float) -> None:
    """Write SVG in the drawing's own unit, y downwards, a group for each layer.

    Browsers keep four bytes for a coordinate, which is half a metre at a northing of 5,000,000 m: a drawing from above
    has local coordinates, and its description says what to add.

    Args:
        path: of the file.
        drawing: its lines and areas.
        survey: what it is a drawing of.
        scale: the file's size and pens are those of a print at 1:scale.
    """
    shift = file_shift(drawing.frame, survey)
    added = shift if drawing.frame.from_above else np.zeros(2)
    shift, margin = shift - added, 0.02 * float(drawing.frame.size.max())
    low, high = drawing.frame.low + shift - margin, drawing.frame.high + shift + margin
    width, height = high - low
    root = Xml.Element("svg", {
        "xmlns": "http://www.w3.org/2000/svg", "version": "1.1",
        "width": f"{1000 * width / scale:.3f}mm", "height": f"{1000 * height / scale:.3f}mm",
        "viewBox": f"{low[0]:.4f} {-high[1]:.4f} {width:.4f} {height:.4f}", "data-scale": f"1:{scale:g}",
    })  # fmt: skip
    if added.any():
        text = f"{survey.georeference.crs}: east = x + {added[0]:.3f}, north = {added[1]:.3f} - y"
        Xml.SubElement(root, "desc").text = text
    if drawing.areas:
        _hatch_pattern(root, scale / 1000)
        group = Xml.SubElement(root, "g", {"id": HATCH, "fill": "url(#hatch)", "fill-rule": "evenodd"})
        for area in drawing.areas:
            rings = [_path(ring + shift) + " Z" for ring in rings_of(area)]
            Xml.SubElement(group, "path", {"d": " ".join(rings)})
    for layer in _layers(drawing):
        if layer != HATCH:
            style = {"fill": "none", "stroke": "black", "stroke-width": f"{pen(layer) * scale / 1000:.5f}"}
            group = Xml.SubElement(root, "g", {"id": layer, **style, "stroke-linecap": "round"})
            for line in drawing.lines:
                if line.layer == layer:
                    Xml.SubElement(group, "path", {"d": _path(line.points + shift)})
    Xml.indent(root)
    with atomic_path(path) as temporary:
        temporary.write_bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _hatch_pattern(root: Xml.Element, millimetre: float) -> None:
    """Write the pattern of lines at 45 degrees; ``millimetre``: length of one on paper, in the drawing's unit."""
    side = _HATCH * millimetre
    box = {"id": "hatch", "width": f"{side}", "height": f"{side}", "patternUnits": "userSpaceOnUse"}
    pattern = Xml.SubElement(Xml.SubElement(root, "defs"), "pattern", {**box, "patternTransform": "rotate(45)"})
    stroke = {"stroke": "black", "stroke-width": f"{pen(HATCH) * millimetre:.5f}"}
    Xml.SubElement(pattern, "line", {"x1": "0", "y1": "0", "x2": "0", "y2": f"{side}", **stroke})


def _layers(drawing: LineDrawing) -> list[str]:
    used = dict.fromkeys(line.layer for line in drawing.lines)
    known = [layer for layer in (CUT, OUTLINE, STEP, CREASE) if layer in used]
    parts = sorted(layer for layer in used if layer.startswith(PART))
    return known + parts + [DETAIL] * (DETAIL in used) + [HATCH] * bool(drawing.areas)


def _path(points: Array) -> str:
    return "M " + " L ".join(f"{x:.4f} {-y:.4f}" for x, y in points)
