# SPDX-License-Identifier: GPL-3.0-or-later
"""The kinds of models, and the packages that each needs."""

from __future__ import annotations

_LEVELS = {"xatlas": "xatlas", "fast_simplification": "fast-simplification"}
#: What ``--only`` takes -> the packages of the extra ``models`` that it needs, module -> name.
PACKAGES: dict[str, dict[str, str]] = {
    "lod": _LEVELS,
    "tiles": _LEVELS,
    "solid": {},
    "ifc": {"ifcopenshell": "ifcopenshell"},
    "usd": {**_LEVELS, "pxr": "usd-core"},
    "points": {"laspy": "laspy", "lazrs": "lazrs"},
}
KINDS = tuple(PACKAGES)
