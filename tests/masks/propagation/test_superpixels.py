# SPDX-License-Identifier: GPL-3.0-or-later
from dataclasses import replace

import cv2
import numpy as np
import pytest

from mgf_engine.masks.propagation.appearance import FEATURE_SCALE, fit_mixture, log_ratio, vegetation_probability
from mgf_engine.masks.propagation.superpixels import SuperpixelOptions, cut_regions
from mgf_engine.native.library import call


def halves(height: int, width: int) -> np.ndarray:
    photo = np.full((height, width, 3), (40, 90, 160), np.uint8)
    photo[:, width // 2 :] = (190, 80, 60)
    return photo


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (19, 23), (180, 240), (667, 1000)])
def test_regions_cover_the_photo(size: tuple[int, int]):
    regions = cut_regions(halves(*size))
    count = len(regions.area)
    assert max(regions.labels.shape) <= SuperpixelOptions.reduced_side
    assert sorted(np.unique(regions.labels)) == list(range(count))
    assert regions.area.sum() == pytest.approx(1, abs=1e-5)
    assert regions.features.shape == (count, 6) and np.isfinite(regions.features).all()
    assert (regions.centres >= 0).all() and (regions.centres <= (size[1], size[0])).all()
    assert (regions.pairs[:, 0] < regions.pairs[:, 1]).all() and (regions.pairs < count).all()


def test_regions_keep_to_edges_and_contrast_shows_them():
    regions = cut_regions(halves(180, 240))
    left = regions.at(np.stack([np.full(50, 100.0), np.linspace(1, 179, 50)], 1))
    right = regions.at(np.stack([np.full(50, 140.0), np.linspace(1, 179, 50)], 1))
    assert not set(left) & set(right)
    side = regions.centres[:, 0] > 120
    across = side[regions.pairs[:, 0]] != side[regions.pairs[:, 1]]
    assert regions.contrast[across].min() > 10 * regions.contrast[~across].mean()


def test_a_place_is_looked_up_with_the_scale_of_its_own_axis():
    regions = replace(cut_regions(halves(4, 4)), labels=np.arange(4, dtype=np.int32).reshape(2, 2), scale=(0.5, 0.25))
    corners = np.array([[1, 3], [3, 3], [1, 5], [3, 5], [-9, 99], [99, -9]], float)  # the last two are clamped
    assert regions.at(corners).tolist() == [0, 1, 2, 3, 2, 1]


@pytest.mark.parametrize("size", [(20, 20), (23, 89), (66, 88), (150, 201)])
@pytest.mark.parametrize("grain", [0.7, 3.0, 12.0])
def test_superpixels_are_those_of_opencv(size: tuple[int, int], grain: float):
    """OpenCV's is the reference of the kernel: the same to the pixel."""
    rng = np.random.default_rng(round(grain) + size[1])
    noise = cv2.GaussianBlur(rng.uniform(0, 255, (*size, 3)).astype(np.float32), (0, 0), grain)
    picture = np.clip(128 + (noise - 128) * (1 + grain), 0, 255).astype(np.uint8)
    picture[: size[0] // 3, : size[1] // 2] = (200, 120, 130)  # even: nothing to choose by but place
    opencv = cv2.ximgproc.createSuperpixelSLIC(
        picture, cv2.ximgproc.SLIC, SuperpixelOptions.side, SuperpixelOptions.compactness
    )
    opencv.iterate(SuperpixelOptions.rounds)
    opencv.enforceLabelConnectivity(SuperpixelOptions.speck)
    labels = np.empty(size, np.int32)
    assert (
        call(
            "mgf_superpixels",
            *size,
            picture,
            SuperpixelOptions.side,
            SuperpixelOptions.compactness,
            SuperpixelOptions.rounds,
            SuperpixelOptions.speck,
            labels,
        )
        == 0
    )
    np.testing.assert_array_equal(labels, opencv.getLabels())


def test_lookup_clamps_to_the_frame():
    regions = cut_regions(halves(60, 80))
    far = regions.at(np.array([[-5.0, -5.0], [500.0, 500.0]]))
    assert far.tolist() == [regions.labels[0, 0], regions.labels[-1, -1]]


def test_mixtures_tell_two_materials_apart_and_strangers_not_at_all():
    rng = np.random.default_rng(0)
    red = rng.normal(0, FEATURE_SCALE, (400, 6)) + np.array([50, 30, 20, 1, 1, 1])
    blue = rng.normal(0, FEATURE_SCALE, (400, 6)) + np.array([50, -10, -40, 1, 1, 1])
    features = np.concatenate([red, blue])
    is_red = np.repeat([1.0, 0.0], 400)
    models = fit_mixture(features, is_red, 4, 0), fit_mixture(features, 1 - is_red, 4, 0)
    ratio = log_ratio(features, *models)
    assert (ratio[:400] > 2).mean() > 0.99 and (ratio[400:] < -2).mean() > 0.99
    stranger = np.array([[95.0, 5, 110, 3, 3, 3]])
    assert abs(log_ratio(stranger, *models)[0]) < 0.5


def test_mixtures_need_samples():
    features = np.random.default_rng(0).normal(size=(50, 6))
    assert fit_mixture(features, np.zeros(50), 3, 0) is None
    assert (log_ratio(features, None, None) == 0).all()
    same = np.tile(features[:1], (60, 1))
    model = fit_mixture(same, np.ones(60), 5, 0)
    assert model is not None and np.isfinite(model.log_density(same / FEATURE_SCALE)).all()


def test_plants_are_green_and_rough():
    leaf, copper_roof, brick = [35, -12, 15, 2.2, 1, 1], [35, -12, 15, 0.4, 0.3, 0.2], [45, 25, 20, 2.2, 1, 1]
    assert vegetation_probability(np.array([leaf, copper_roof, brick])).tolist() == [1, 0, 0]
