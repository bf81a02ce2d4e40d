# SPDX-License-Identifier: GPL-3.0-or-later
"""MGF in Blender: photos of a building in, the building as a mesh in the scene out.

Every module with an interface has ``register`` and ``unregister``; this file calls them in order, which is also that of
the panels: true coordinates before the drawings and models that use them.
"""

import importlib

_MODULES = (
    "translations", "common.runner", "common.editors", "properties", "engine.operators", "preferences",
    "scene_import.operators", "scene_import.placement", "scene_import.panel", "prompts.tool",
    "reconstruct.preview_image", "reconstruct.operators", "prompts.operators", "prompts.suggest", "prompts.preview",
    "prompts.drawing", "prompts.panel", "reconstruct.panel", "results.async_import", "results.operators",
    "results.panel", "georef.operators", "georef.tool", "georef.overlay", "georef.magnifier", "georef.panel",
    "drawings.operators", "drawings.previews", "drawings.panel", "models.operators", "models.panel", "town.operators",
    "town.panel", "cli",
)  # fmt: skip


def register() -> None:
    """Enable the add-on."""
    for name in _MODULES:
        importlib.import_module(f".{name}", __package__).register()


def unregister() -> None:
    """Disable it, leaving nothing behind."""
    for name in reversed(_MODULES):
        importlib.import_module(f".{name}", __package__).unregister()
