# SPDX-License-Identifier: GPL-3.0-or-later
"""A painted house whose colour is known everywhere: what the texture shows on it."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.house import House, build_house, paint
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import MaskSet
from mgf_engine.model.mesh import Mesh, Texture
from mgf_engine.model.scene import Lens, Scene
from mgf_engine.native.library import set_threads
from mgf_engine.options.config import make_config
from mgf_engine.scene import photos
from mgf_engine.scene.cameras import to_original
from mgf_engine.scene.load import load_scene
from mgf_engine.texture import bake
from mgf_engine.texture.bake import sample_reduced_photo
from mgf_engine.texture.draw import draw_textured
from mgf_engine.texture.model import Source
from mgf_engine.texture.texture_pipeline import make_texture

WORKING = 80  # px; the photos have three times as many


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    return build_house(tmp_path_factory.mktemp("painted house"))


@pytest.fixture(scope="module")
def scene(house: House, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(
        house.folder, tmp_path_factory.mktemp("job") / "scene", make_config({"resolution": WORKING}), Reporter()
    )


def masks_of(scene: Scene, house: House) -> MaskSet:
    labels = [
        cv2.resize(house.masks[v.name].astype(np.uint8), (v.width, v.height), interpolation=cv2.INTER_NEAREST)
        for v in scene.views
    ]
    count = len(labels)
    return MaskSet(tuple(labels), np.ones(count, bool), np.ones(count, np.float32), np.zeros(0, bool))


def in_frame(scene: Scene, mesh: Mesh) -> Mesh:
    return replace(mesh, vertices=scene.to_normalised.apply(mesh.vertices))


def on_surface(mesh: Mesh, count: int = 4000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random spots: faces [n], weights of their corners [n, 3], places [n, 3]."""
    rng = np.random.default_rng(3)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(mesh.faces), count, p=area / area.sum())
    weight = rng.dirichlet((1, 1, 1), count)
    return face, weight, (mesh.vertices[mesh.faces[face]] * weight[..., None]).sum(1)


def shown(texture: Texture, face: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The texture's nearest pixel at spots on faces, [n, 3]."""
    u, v = (texture.uv[face] * weight[..., None]).sum(1).T
    height, width = texture.image.shape[:2]
    return texture.image[np.floor((1 - v) * height).astype(int), np.floor(u * width).astype(int)].astype(float)


def test_every_spot_has_its_color_finer_than_the_working_photos(house: House, scene: Scene) -> None:
    warnings: list[str] = []
    texture = make_texture(in_frame(scene, house.mesh), scene, masks_of(scene, house), 1024, warnings.append)
    assert not warnings and texture.uv.shape == (len(house.mesh.faces), 3, 2)
    assert texture.uv.min() >= 0 and texture.uv.max() <= 1
    face, weight, places = on_surface(house.mesh)
    true = paint(places, face, len(house.mesh.faces)).astype(float)
    error = np.abs(shown(texture, face, weight) - true).mean(1)
    # walls of two triangles: wrong perspective inside a triangle would shift the pattern by many pixels
    coarse = _from_working_photos(scene, house, face, weight, true)
    assert np.median(error) < 8 and np.median(error) < 0.75 * np.median(coarse)


@pytest.mark.parametrize(("fit", "most"), [(0.5, 1), (2.5, 2), (100.0, 8)])
def test_no_more_photos_are_open_at_once_than_memory_allows(scene, house, monkeypatch, fit: float, most: int) -> None:
    view = scene.views[0]
    size = view.original_width * view.original_height
    opened, counts, painting = [0], [], bake.reduce_photo

    def counted(*arguments: Any) -> Any:
        opened[0] += 1
        time.sleep(0.02)  # long enough for the others to come in
        counts.append(opened[0])
        opened[0] -= 1
        return painting(*arguments)

    monkeypatch.setattr(photos, "_MEMORY", int(fit * size * photos._BYTES_PER_PIXEL))
    monkeypatch.setattr(bake, "reduce_photo", counted)
    set_threads(8)
    try:
        texture = make_texture(in_frame(scene, house.mesh), scene, masks_of(scene, house), 256, lambda text: None)
    finally:
        set_threads(0)
    assert max(counts) <= most and len(counts) >= 4
    assert texture.image.std() > 10


def _from_working_photos(
    scene: Scene, house: House, face: np.ndarray, weight: np.ndarray, true: np.ndarray
) -> np.ndarray:
    """The error of a texture when the user's photos are gone."""
    lost = replace(scene, views=tuple(replace(v, photo=v.photo + ".gone") for v in scene.views))
    warnings: list[str] = []
    texture = make_texture(in_frame(scene, house.mesh), lost, masks_of(scene, house), 1024, warnings.append)
    assert len(warnings) == 1 and "cannot be read any more" in warnings[0]
    return np.abs(shown(texture, face, weight) - true).mean(1)


def test_a_photo_that_was_replaced_by_another_is_not_painted_with(house: House, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(house.folder, copy)
    scene = load_scene(copy, tmp_path / "job" / "scene", make_config({"resolution": WORKING}), Reporter())
    for photo in (copy / "images").iterdir():
        cv2.imwrite(str(photo), np.zeros((90, 120, 3), np.uint8))
    warnings: list[str] = []
    mesh = in_frame(scene, house.mesh)
    texture = make_texture(mesh, scene, masks_of(scene, house), 512, warnings.append)
    assert len(warnings) == 1 and "has changed since the job began" in warnings[0]
    assert texture.image.mean() > 40


def test_photos_are_brought_to_one_exposure(house: House, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(house.folder, copy)
    for photo in sorted((copy / "images").iterdir())[::2]:
        cv2.imwrite(str(photo), (cv2.imread(str(photo)) * 0.6).astype(np.uint8))
    scene = load_scene(copy, tmp_path / "job" / "scene", make_config({"resolution": WORKING}), Reporter())
    assert min(g for v in scene.views for g in v.gain) < 0.9 < 1.1 < max(g for v in scene.views for g in v.gain)
    texture = make_texture(in_frame(scene, house.mesh), scene, masks_of(scene, house), 512, lambda text: None)
    face, weight, places = on_surface(house.mesh)
    true = paint(places, face, len(house.mesh.faces)).astype(float)
    ratio = np.median(shown(texture, face, weight) / np.maximum(true, 1), axis=0)
    off = np.abs(shown(texture, face, weight) / ratio - true).mean(1)
    assert np.median(off) < 10


def test_faces_that_no_photo_shows_are_painted_with_their_vertices_colors(house: House, scene: Scene) -> None:
    floor = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    colors = np.tile(np.array([[10, 200, 90]], np.uint8), (len(house.mesh.vertices), 1))
    mesh = Mesh(house.mesh.vertices, np.concatenate([house.mesh.faces, floor]), colors)
    texture = make_texture(in_frame(scene, mesh), scene, masks_of(scene, house), 512, lambda text: None)
    weight = np.array([[0.4, 0.3, 0.3], [0.2, 0.4, 0.4]])
    assert np.abs(shown(texture, np.array([14, 15]), weight) - (10, 200, 90)).max() < 2


def test_a_picture_of_the_textured_mesh_is_the_photo(house: House, scene: Scene) -> None:
    mesh = in_frame(scene, house.mesh)
    texture = make_texture(mesh, scene, masks_of(scene, house), 1024, lambda text: None)
    for index in (0, 5):
        picture, seen = draw_textured(mesh, texture, scene.views[index])
        inside = cv2.erode(seen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        error = np.abs(picture.astype(float) - scene.photo(index))[inside].mean()
        assert seen.mean() > 0.05 and error < 10 and (picture[~seen] == 255).all()


def test_pixels_looked_up_in_many_chunks_are_the_same(house: House, scene: Scene, monkeypatch) -> None:
    mesh, masks = in_frame(scene, house.mesh), masks_of(scene, house)
    whole = make_texture(mesh, scene, masks, 512, lambda text: None)
    monkeypatch.setattr(bake, "CHUNK", 97)
    assert (make_texture(mesh, scene, masks, 512, lambda text: None).image == whole.image).all()


def test_a_photo_is_looked_up_through_its_lens(scene: Scene) -> None:
    """A photo whose red and green tell the pixel: what is read is where the lens put the point."""
    view = scene.views[0]
    width, height = view.original_width, view.original_height
    lens = Lens("SIMPLE_RADIAL", width, height, (220.0, width / 2, height / 2, -0.1))
    bent = replace(view, lens=lens)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    photo = np.stack([x, y, 0 * x], 2).astype(np.uint8)
    points = view.centre + np.array([[0.45, 0.3, 1], [-0.4, 0.2, 1], [0, 0, 1]]) @ view.rotation
    found = sample_reduced_photo(bent, Source(photo, True), points, 2.0)
    expected = to_original(bent, bent.project(points)[0])
    assert np.abs(found[:, :2] - expected).max() < 1.5
    straight = to_original(view, view.project(points)[0])
    assert np.abs(expected - straight).max() > 2
