# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's options as Blender properties, generated from ``options.json`` and never written a second time.

The panel shows the values that will be used: choosing a preset sets the options it governs. Only what differs from
the preset is handed to the engine, which applies the preset itself.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy

SCHEMA: dict[str, Any] = json.loads((Path(__file__).parents[1] / "options.json").read_text(encoding="utf-8"))
OPTIONS: dict[str, dict[str, Any]] = {o["name"]: o for o in SCHEMA["options"]}
SECTIONS: dict[str, str] = SCHEMA["sections"]  # name -> heading
STAGES: dict[str, str] = SCHEMA["stages"]  # name -> what is shown while it runs
PRESETS: dict[str, dict[str, Any]] = SCHEMA["presets"]
COSTS: dict[str, Any] = SCHEMA["costs"]
PRESET_HELP: dict[str, str] = SCHEMA["preset_help"]
RUN_LENGTH: dict[str, int] = SCHEMA["run_length"]
_CAPITALS = {"3d", "sh", "psnr", "ssim", "lpips", "l1", "obj", "glb", "cpu", "cuda", "gps", "crs"}
_SPELLED = {**{word: word.upper() for word in _CAPITALS}, "efficientsam": "EfficientSAM",
            "lambda": "λ", "seconds": "(s)"}  # fmt: skip  # what is left has room in a sidebar
_SWITCH = {"true": True, "on": True, "yes": True, "1": True, "false": False, "off": False, "no": False, "0": False}
_SMALL = {"of", "the", "to", "in", "on", "by", "and", "a"}


def title(name: str) -> str:
    """Return an option's name as interface text, for example ``max_faces`` -> ``Max Faces``."""
    words = name.split("_")
    out = []
    for i, word in enumerate(words):
        small = word in _SMALL and 0 < i < len(words) - 1
        out.append(_SPELLED.get(word, word if small else word[:1].upper() + word[1:]))
    return " ".join(out)


def default_of(name: str, preset: str) -> Any:
    """Return the value an option has under a preset."""
    return type(OPTIONS[name]["default"])(PRESETS.get(preset, {}).get(name, OPTIONS[name]["default"]))


def changed(options: bpy.types.PropertyGroup) -> dict[str, Any]:
    """Return the options whose values differ from the chosen preset, name -> value."""
    result = {}
    for name in OPTIONS:
        if name == "preset":
            continue
        value, default = _value(options, name), default_of(name, options.preset)
        same = abs(value - default) <= 1e-6 * max(1.0, abs(default)) if isinstance(default, float) else value == default
        if not same:
            result[name] = value
    return result


def _value(options: bpy.types.PropertyGroup, name: str) -> Any:
    """Return the value of an option; Blender's float32 numbers have seven digits."""
    value = getattr(options, name)
    return round(value, 7) if isinstance(value, float) else value


def arguments(options: bpy.types.PropertyGroup, also: Iterable[str] = ()) -> list[str]:
    """Return command line arguments of the engine for the panel's values.

    Args:
        also: options to pass even at their defaults; a resumed job keeps what it was given otherwise.
    """
    values = changed(options)
    for name in also:
        if name in OPTIONS and name != "preset":
            values[name] = _value(options, name)
    result = ["--set", f"preset={options.preset}"]
    for name, value in values.items():
        result += ["--set", f"{name}={_text(value)}"]
    return result


def set_values(options: bpy.types.PropertyGroup, given: dict[str, Any]) -> None:
    """Take over values, for example those an earlier job was given, kept as text; what does not fit is left out."""
    if given.get("preset") in PRESETS:
        options.preset = given["preset"]
    for name, value in given.items():
        parsed = _parsed(OPTIONS[name], value) if name in OPTIONS and name != "preset" else None
        if parsed is not None:
            setattr(options, name, parsed)


def reset(options: bpy.types.PropertyGroup, but: Iterable[str] = ()) -> None:
    """Set the options back to those of the chosen preset, all ``but`` some."""
    for name in set(OPTIONS) - {"preset", *but}:
        setattr(options, name, default_of(name, options.preset))


def replace(options: bpy.types.PropertyGroup, given: dict[str, Any]) -> None:
    """Take over values, see :func:`set_values`, and set all others back to those of the preset."""
    set_values(options, given)
    reset(options, but=given)


def _parsed(option: dict[str, Any], value: Any) -> Any:
    """Return a value or its text in the option's own type; None when it is no such value."""
    text, kind = str(value).strip(), type(option["default"])
    try:
        if kind is bool:
            return _SWITCH.get(text.lower())
        if kind is str:
            return value if isinstance(value, str) and value in (option["choices"] or [value]) else None
        number = kind(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _apply_preset(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    for name in {n for values in PRESETS.values() for n in values}:
        setattr(self, name, default_of(name, self.preset))


def _in_titles(text: str) -> str:
    """Return a help text of the engine with options called by their names in the panel."""
    return re.sub(r"[a-z]+(?:_[a-z]+)+", lambda found: title(found[0]) if found[0] in OPTIONS else found[0], text)


def _choice_help(name: str, choice: str) -> str:
    """Return what a choice means; of a preset, what it sets (0 is off, all, or the engine's own choice)."""
    if name != "preset":
        return f"{title(name)}: {title(choice)}"
    if choice in PRESET_HELP:
        return PRESET_HELP[choice]
    told = sorted({n for preset, given in PRESETS.items() if preset not in PRESET_HELP for n in given})
    values = [(n, default_of(n, choice)) for n in told]
    return ", ".join(f"{title(n)} {v:,}" if isinstance(v, int) else f"{title(n)} {v}" for n, v in values if v)


def _annotation(option: dict[str, Any]) -> Any:
    """Return the ``bpy.props`` definition of one option."""
    unit = f" ({option['unit']})" if option["unit"] else ""
    default = default_of(option["name"], OPTIONS["preset"]["default"])
    name = title(option["name"]) + (unit if option["unit"] == "GB" else "")
    common = {"name": name, "description": _in_titles(option["help"]) + unit, "default": default}
    if option["unit"] == "px":
        common["subtype"] = "PIXEL"  # Blender writes it behind the number
    limits = {k: option[v] for k, v in (("min", "low"), ("max", "high")) if option[v] is not None}
    if option["choices"]:
        items = [(c, title(c), _choice_help(option["name"], c)) for c in option["choices"]]
        update = {"update": _apply_preset} if option["name"] == "preset" else {}
        return bpy.props.EnumProperty(items=items, **common, **update)
    if option["type"] == "bool":
        return bpy.props.BoolProperty(**common)
    if option["type"] == "int":
        return bpy.props.IntProperty(**common, **{k: int(v) for k, v in limits.items()})
    if option["type"] == "float":
        return bpy.props.FloatProperty(**common, **limits, precision=1 if option["unit"] == "GB" else 3)
    subtype = {"file": "FILE_PATH", "folder": "DIR_PATH"}.get(option["path"], "NONE")
    return bpy.props.StringProperty(**common, subtype=subtype)


def make_group() -> type[bpy.types.PropertyGroup]:
    """Make the property group with one property per option."""
    annotations = {name: _annotation(option) for name, option in OPTIONS.items()}
    body = {"__annotations__": annotations, "__doc__": "The engine's options.", "__module__": __name__}
    return type("MGF_PG_options", (bpy.types.PropertyGroup,), body)
