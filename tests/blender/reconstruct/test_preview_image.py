# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview image follows a running job."""

from __future__ import annotations

import bpy
import numpy as np
import synthetic

from mgf_blender.reconstruct import preview_image


def test_preview_follows_the_engine(ready, engine, house, tmp_path):
    from synthetic import write_png

    write_png(tmp_path / "p.png", np.full((4, 6, 3), 200, np.uint8))
    engine("ok", FAKE_RESULT=house.job, FAKE_PREVIEW=tmp_path / "p.png")
    bpy.ops.mgf.reconstruct()
    image = bpy.data.images[preview_image.NAME]
    assert tuple(image.size) == (6, 4) and abs(image.pixels[0] - 200 / 255) < 0.01
    write_png(tmp_path / "q.png", np.full((2, 2, 3), 10, np.uint8))
    preview_image.show(tmp_path / "q.png")
    assert tuple(image.size) == (2, 2) and preview_image.show(tmp_path / "gone.png") is None


def test_undo_does_not_blank_the_preview(ready, engine, house, tmp_path):
    """The picture came between two undo steps, so neither holds it."""
    synthetic.write_png(tmp_path / "p.png", np.full((4, 6, 3), 200, np.uint8))
    bpy.ops.ed.undo_push(message="one")
    ready.part = "door"
    bpy.ops.ed.undo_push(message="two")
    area = max(bpy.context.window.screen.areas, key=lambda a: a.width * a.height)
    area.type = "IMAGE_EDITOR"
    preview_image.show(tmp_path / "p.png")
    area.spaces.active.image = bpy.data.images[preview_image.NAME]
    for turn in (bpy.ops.ed.undo, bpy.ops.ed.redo):
        turn()
        image = area.spaces.active.image
        assert image is not None and image.name == preview_image.NAME and tuple(image.size) == (6, 4)
    synthetic.write_png(tmp_path / "q.png", np.full((2, 2, 3), 10, np.uint8))
    preview_image.show(tmp_path / "q.png")
    assert tuple(area.spaces.active.image.size) == (2, 2) and len([i for i in bpy.data.images if "MGF" in i.name]) == 1
    area.spaces.active.image = None
    bpy.ops.ed.undo()
    assert area.spaces.active.image is None
