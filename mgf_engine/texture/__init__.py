# SPDX-License-Identifier: GPL-3.0-or-later
"""A texture for the finished mesh: one picture, cut from the photos as the user took them, and where each face finds
its part of it.

Which photo shows which face (``visibility``), which one paints it (``view_selection``), where that goes in the picture
(``charts``), how seams between photos vanish (``seams``), and the pixels themselves (``bake``); ``texture_pipeline``
runs it all.
"""
