# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np

from mgf_engine.masks.boundaries import boundaries
from mgf_engine.model.masks import BUILDING


def test_counting_labels_do_not_cancel():
    # 1, 2, 3 in a row: a Laplacian on the values is zero in the middle, the definition is not.
    row = np.array([[1, 2, 3]], np.uint8)
    assert boundaries(row).all()


def test_frame_is_no_boundary_and_outline_is():
    assert not boundaries(np.full((4, 5), BUILDING, np.uint8)).any()
    labels = np.zeros((5, 5), np.uint8)
    labels[2, 2] = BUILDING
    expected = np.array([[0, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 1, 1, 1, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 0]], bool)
    assert (boundaries(labels) == expected).all()


def test_diagonal_neighbours_do_not_count():
    labels = np.ones((3, 3), np.uint8)
    labels[0, 0] = 2
    found = boundaries(labels)
    assert found[0, 1] and found[1, 0] and not found[1, 1]


def test_one_pixel_and_empty_maps():
    assert not boundaries(np.ones((1, 1), np.uint8)).any()
    assert boundaries(np.zeros((0, 0), np.uint8)).shape == (0, 0)
