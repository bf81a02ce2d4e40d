# SPDX-License-Identifier: GPL-3.0-or-later
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from mgf_engine.model.photo_cache import PhotoCache


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder with files of the names 0 to 8."""
    for name in range(9):
        (tmp_path / str(name)).touch()
    return tmp_path


class Disk:
    """Photos of 300 bytes that count how often they are read."""

    def __init__(self) -> None:
        self.read_paths: list[str] = []

    def read(self, path: Path) -> np.ndarray:
        self.read_paths.append(path.name)
        return np.full((10, 10, 3), int(path.name), np.uint8)


def test_what_was_used_last_is_kept_and_the_oldest_goes(files: Path) -> None:
    disk, cache = Disk(), PhotoCache(capacity=900)
    for name in ("1", "2", "3", "1", "4", "1", "2"):
        assert cache.get(files / name, disk.read)[0, 0, 0] == int(name)
    assert disk.read_paths == ["1", "2", "3", "4", "2"]  # 2 had to go for 4, because 1 was used again


def test_a_photo_larger_than_the_room_is_read_every_time(files: Path) -> None:
    disk, cache = Disk(), PhotoCache(capacity=100)
    for _ in range(2):
        cache.get(files / "7", disk.read)
    assert disk.read_paths == ["7", "7"]


def test_nobody_can_change_what_others_will_see(files: Path) -> None:
    photo = PhotoCache().get(files / "5", Disk().read)
    with pytest.raises(ValueError, match="read-only"):
        photo[0] = 1


def test_a_failure_is_not_kept(files: Path) -> None:
    cache = PhotoCache()

    def broken(path: Path) -> np.ndarray:
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        cache.get(files / "1", broken)
    assert cache.get(files / "1", Disk().read)[0, 0, 0] == 1


def test_many_threads_stay_within_the_room(files: Path) -> None:
    disk, cache = Disk(), PhotoCache(capacity=1500)
    with ThreadPoolExecutor(4) as pool:
        for name, photo in zip(
            range(200), pool.map(lambda n: cache.get(files / str(n % 9), disk.read), range(200)), strict=True
        ):
            assert photo[0, 0, 0] == name % 9
    assert cache._bytes == sum(photo.nbytes for _, photo in cache._held.values()) <= 1500
    cache.clear()
    assert cache._bytes == len(cache._held) == 0


def test_a_file_that_was_written_anew_is_read_anew(files: Path) -> None:
    disk, cache = Disk(), PhotoCache()
    cache.get(files / "3", disk.read)
    (files / "3").write_text("another photo")
    for _ in range(2):
        cache.get(files / "3", disk.read)
    assert disk.read_paths == ["3", "3"] and cache._bytes == 300  # what the file was before is let go


def test_a_file_that_is_gone_is_asked_of_the_reader(tmp_path: Path) -> None:
    def gone(path: Path) -> np.ndarray:
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        PhotoCache().get(tmp_path / "1", gone)
