# SPDX-License-Identifier: GPL-3.0-or-later
"""Scripts that a Python with ``bpy`` runs as a separate process to render the synthetic scenes.

The engine never imports anything from here; it starts ``render.py`` and reads the pictures it wrote.
"""
