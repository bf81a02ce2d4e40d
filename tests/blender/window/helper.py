# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs inside the real Blender: says where things are and changes the layout; it presses nothing itself.

Commands come as files ``cmd`` (one word and an argument), the state goes to ``state.json``.
"""

import json
import os
import sys
import time
from pathlib import Path

import bpy

PAUSE = 0.25  # seconds between two looks; TICK of driver.py
last, gaps = 0.0, []
OUT = Path(os.environ["MGF_WINDOW_OUT"])
bpy.context.preferences.view.show_splash = False
bpy.context.preferences.view.use_save_prompt = False


def main_area():
    """The large editor of the window."""
    areas = bpy.context.window_manager.windows[0].screen.areas
    known = [a for a in areas if a.type in {"VIEW_3D", "IMAGE_EDITOR", "PREFERENCES"}]
    return max(known or list(areas), key=lambda a: a.width * a.height)  # a file browser may fill the screen


def addon_module(name):
    """A module of the add-on by its name there; None while the add-on is not on."""
    return next((m for n, m in sys.modules.items() if n.endswith(f".mgf.{name}")), None)


def region(area, kind):
    return next((r for r in area.regions if r.type == kind), None)


def obey(text):
    """Change what is shown."""
    window = bpy.context.window_manager.windows[0]
    word, _, argument = text.partition(" ")
    area = main_area()
    if word == "editor":
        area.type = argument
        if argument != "PREFERENCES":
            area.spaces.active.show_region_ui = True
    elif word == "tab":
        region(area, "UI").active_panel_category = "MGF"
    elif word == "fit":
        with bpy.context.temp_override(window=window, area=area, region=region(area, "WINDOW")):
            if area.type == "IMAGE_EDITOR":
                bpy.ops.image.view_all(fit_view=True)
            else:
                bpy.ops.view3d.view_all()
    elif word == "frame":
        with bpy.context.temp_override(window=window, area=area, region=region(area, "WINDOW")):
            for obj in window.view_layer.objects:
                obj.select_set(obj.get("mgf_kind") == argument)
            bpy.ops.view3d.view_selected()
            bpy.ops.object.select_all(action="DESELECT")
    elif word == "py":
        exec(argument, {"bpy": bpy, "area": area, "window": window})  # set-up only, see drive.py
    elif word == "browse":
        browser = next(a for a in window.screen.areas if a.type in {"PROPERTIES", "FILE_BROWSER"})
        browser.type = "FILE_BROWSER"
        if browser.spaces.active.params is None:
            return False  # not drawn yet
        browser.spaces.active.params.directory = argument.encode()
        browser.spaces.active.show_region_toolbar = browser.spaces.active.show_region_ui = False
    for r in area.regions:
        r.tag_redraw()
    return True


def state():
    """What the driver needs to aim and to check."""
    area = main_area()
    window = bpy.context.window_manager.windows[0]
    found = {
        "size": [window.width, window.height],
        "version": list(bpy.app.version),
        "area": area.type,
        "windows": len(bpy.context.window_manager.windows),
    }
    found["regions"] = {r.type: [r.x, r.y, r.width, r.height] for r in area.regions}
    found["tick"], found["ui_scale"] = len(gaps), bpy.context.preferences.system.ui_scale
    found["tab"], found["browser"] = None, any(a.type == "FILE_BROWSER" for a in window.screen.areas)
    found["longest_gap"] = max(gaps, default=0.0)
    found["addons"] = [a.module for a in bpy.context.preferences.addons]
    if area.type in {"VIEW_3D", "IMAGE_EDITOR"}:  # of other editors, asking can crash Blender
        found["tab"] = getattr(region(area, "UI"), "active_panel_category", None)
    scene = window.scene
    mgf = getattr(scene, "mgf", None)
    if mgf is not None:
        found["photos"] = [
            {"name": p.name, "size": [p.width, p.height], "clicks": [[*c.uv, c.negative, c.part] for c in p.clicks]}
            for p in mgf.photos
        ]
        found["marks"] = [list(m.uv) for m in mgf.georef.marks]
        found["photo_index"], found["job_folder"], found["source"] = mgf.photo_index, mgf.job_folder, mgf.source
        found["crop"] = sum(o.get("mgf_role") == "crop" for o in bpy.data.objects)
        found["scene_keys"] = {k: v for k, v in scene.items() if isinstance(v, (str, float, int))}
        found["auto"], found["options"] = mgf.auto_preview, {"preset": mgf.options.preset}
        found["camera"] = scene.camera.get("mgf_shown", "") if scene.camera else ""
        found["objects"] = {
            k: sum(o.get("mgf_kind") == k for o in bpy.data.objects) for k in ("Cameras", "Points", "Mesh", "Renders")
        }
        runner = addon_module("common.runner")
        if runner is not None:
            found["jobs"] = [
                [j.kind, j.status, j.stage, j.overall, j.text, j.figures.get("iteration", 0)] for j in runner.jobs()
            ]
            found["longest_tick"] = runner.longest_tick()
            found["pids"] = [j.process.pid for j in runner.jobs() if j.process is not None]
        found["meshes"] = sorted(o.data.session_uid for o in bpy.data.objects if o.get("mgf_kind") == "Mesh")
        arrival = addon_module("results.async_import")
        if arrival is not None:
            found["longest_step"] = arrival.longest_step()
            found["importing"] = addon_module("jobs.import_status").under_way(scene)
        surface = addon_module("results.surface")
        if surface is not None:
            found["painted"] = [surface.shown(o.data) for o in bpy.data.objects if o.get("mgf_kind") == "Mesh"]
        preview = addon_module("prompts.preview")
        if preview is not None:
            found["previews"] = {p.photo: [p.status, p.text, p.seconds] for p in preview._latest.values()}
        current_task = addon_module("engine.current_task")
        task = current_task.current()[1] if current_task is not None else None
        found["task"] = None if task is None else [task.status, task.title, task.text]
    if area.type == "IMAGE_EDITOR" and area.spaces.active.image is not None:
        win = region(area, "WINDOW")
        found["image"], found["image_file"] = area.spaces.active.image.name, area.spaces.active.image.filepath
        a, b = win.view2d.view_to_region(0, 1, clip=False), win.view2d.view_to_region(1, 0, clip=False)
        found["image_px"] = [win.x + a[0], win.y + a[1], win.x + b[0], win.y + b[1]]
        tool = window.workspace.tools.from_space_image_mode("VIEW")
        found["tool"] = tool.idname if tool is not None else ""
    return found


def tick():
    global last
    command, now = OUT / "cmd", time.monotonic()
    if last:
        gaps.append(now - last - PAUSE)
    last = now
    try:
        if command.exists() and obey(command.read_text()):
            command.unlink()
        text = json.dumps(state())
    except Exception as error:
        command.unlink(missing_ok=True)
        import traceback

        text = json.dumps({"error": f"{error}\n{traceback.format_exc()}"})
    (OUT / "state.tmp").write_text(text)
    (OUT / "state.tmp").replace(OUT / "state.json")
    return PAUSE


bpy.app.timers.register(tick, first_interval=0.5, persistent=True)
