# SPDX-License-Identifier: GPL-3.0-or-later
"""Griffe extension for docs/api.md: show the Sphinx roles of docstrings (``:func:`name```) as plain code."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:func|class|meth|mod|data|attr|exc):`~?([^`]+)`")


class PlainRoles(griffe.Extension):
    """Replace ``:func:`~package.module.name``` by ``name`` in every docstring."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Rewrite one docstring; called by griffe for each object that it has read."""
        if obj.docstring is not None:
            obj.docstring.value = _ROLE.sub(lambda role: f"`{role[1].rpartition('.')[2]}`", obj.docstring.value)
