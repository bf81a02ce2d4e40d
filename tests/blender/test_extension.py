# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension as users get it: one zip, valid, installed from disk into a fresh Blender, in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import zipfile

import pytest
from conftest import REPO

CODE = """
import os, sys
import bpy
bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
bpy.ops.mgf.import_colmap(filepath=sys.argv[2])
from bl_ext.user_default.mgf.common import addon
print("USER", addon.user_folder())
print("PREFS", addon.preferences().engine_source)
try:
    bpy.ops.mgf.install_engine()
except RuntimeError as error:
    print("OFFLINE", error)
bpy.context.preferences.system.use_online_access = True
try:
    bpy.ops.mgf.install_engine()
except RuntimeError as error:
    print("NO WHEEL", error)
print("CAMERAS", sum(o.type == "CAMERA" for o in bpy.data.objects))
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.mgf")
print("LEFT", [n for n in dir(bpy.types) if n.startswith("MGF_")], hasattr(bpy.types.Scene, "mgf"))
sys.stdout.flush()
os._exit(0)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, str(REPO / "tools" / "build_extension.py"), "--no-wheel", "--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_zip_is_complete_and_pure(built):
    manifest = tomllib.loads((REPO / "blender_manifest.toml").read_text())
    (path,) = built.glob("*.zip")
    names = zipfile.ZipFile(path).namelist()
    assert {"blender_manifest.toml", "__init__.py", "options.json", "LICENSE", "batch.py"} <= set(names)
    assert not [n for n in names if "__pycache__" in n or n.endswith((".so", ".pyd", ".pyc"))]
    assert "Blender" not in manifest["name"]
    assert all(len(t) <= 64 and t[-1].isalnum() for t in (manifest["tagline"], *manifest["permissions"].values()))
    (entry,) = json.loads((built / "index.json").read_text())["data"]
    assert entry["version"] == manifest["version"] and entry["archive_size"] == path.stat().st_size


def test_same_sources_give_the_same_zip(built, tmp_path):
    command = [sys.executable, str(REPO / "tools" / "build_extension.py"), "--no-wheel", "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    (first,), (second,) = built.glob("*.zip"), tmp_path.glob("*.zip")
    assert first.read_bytes() == second.read_bytes()


def test_installs_from_disk_works_and_leaves(built, house, tmp_path):
    (path,) = built.glob("*.zip")
    user = tmp_path / "user"
    user.mkdir()
    environment = {k: v for k, v in os.environ.items() if k != "MGF_ENGINE_PYTHON"}
    command = [sys.executable, "-c", CODE, str(path), str(house.folder)]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**environment, "BLENDER_USER_RESOURCES": str(user)}, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout
    assert f"USER {user}" in lines and "PREFS MANAGED" in lines
    assert "CAMERAS 13" in lines  # 12 and the start-up file's own
    assert (
        "OFFLINE Error: Online access is off" in lines and "NO WHEEL Error: This copy of the add-on carries no" in lines
    )
    assert "LEFT [] False" in lines
