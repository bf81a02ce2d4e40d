# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture of the finished mesh: an atlas of the user's original photos, and the UV coordinates of each face.

Which photo shows which face (``visibility``), which one paints it (``view_selection``), where that goes in the picture
(``charts``, ``packing``), how seams between photos vanish (``seams``, ``blending``), and the pixels themselves
(``bake``); ``texture_pipeline`` runs it all.
"""
