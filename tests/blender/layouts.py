# SPDX-License-Identifier: GPL-3.0-or-later
"""A layout that records what a panel draws; Blender draws none without a window."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import bpy

_CONTAINERS = {"row", "column", "box", "split", "column_flow", "grid_flow"}


@dataclass
class Recorder:
    """Stands in for ``UILayout``; sub-layouts write into the same lists.

    Attributes:
        texts: (text, whether Blender translates it) in the order they are drawn.
        operators: (operator, its properties, whether the layout was enabled).
        icons: pictures that are drawn by themselves.
        props: names of the properties.
    """

    texts: list = field(default_factory=list)
    operators: list = field(default_factory=list)
    props: list = field(default_factory=list)
    icons: list = field(default_factory=list)
    enabled: bool = True
    scale_y: float = 1.0
    active: bool = True
    use_property_split: bool = False
    use_property_decorate: bool = False

    def __getattr__(self, name):
        if name in _CONTAINERS:

            def part(heading="", **_):
                self._say(heading)
                return Recorder(self.texts, self.operators, self.props, self.icons, self.enabled)

            return part
        raise AttributeError(name)

    def _say(self, text, translate=True):
        if text:
            self.texts.append((text, translate))

    def label(self, text="", translate=True, icon="NONE"):
        _check_icon(icon)
        self._say(text, translate)

    def prop(self, data, name, text=None, icon="NONE", **_):
        _check_icon(icon)
        assert name in data.bl_rna.properties, name
        self.props.append(name)
        self._say(text)

    def operator(self, name, text=None, icon="NONE", depress=False, translate=True):
        _check_icon(icon)
        group, _, part = name.partition(".")
        kind = getattr(getattr(bpy.ops, group), part).get_rna_type()
        given = SimpleNamespace()
        self.operators.append((name, given, self.enabled))
        self._say(text if text is not None else kind.name)
        return given

    def operator_menu_enum(self, name, prop, icon="NONE"):
        self.operator(name, icon=icon)

    def progress(self, factor=0.0, text="", translate=True):
        assert 0 <= factor <= 1
        self._say(text, translate)

    def panel(self, name, default_closed=False):
        return Recorder(self.texts, self.operators, self.props), Recorder(self.texts, self.operators, self.props)

    def template_icon(self, icon_value=0, scale=1.0):
        self.icons.append(icon_value)

    def template_list(self, *_, **__):
        pass

    def separator(self, factor=1.0):
        pass

    @property
    def said(self) -> str:
        """Everything drawn, one line each."""
        return "\n".join(text for text, _ in self.texts)


def _check_icon(icon):
    known = bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items
    assert icon in known, icon


def draw(cls: type[bpy.types.Panel], context=None) -> Recorder:
    """What a panel draws now; empty when its poll says no."""
    context = context or bpy.context
    recorder = Recorder()
    if hasattr(cls, "poll") and not cls.poll(context):
        return recorder
    stand_in = type(cls.__name__, (), dict(vars(cls)))()
    stand_in.layout = recorder
    stand_in.draw(context)
    return recorder
