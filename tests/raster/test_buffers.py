# SPDX-License-Identifier: GPL-3.0-or-later
"""The pool of scratch arrays: what is handed back is used again, at any moment and from any thread."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading

import pytest
import torch

from mgf_engine.native import buffers
from mgf_engine.native.buffers import RenderBuffers, lasting_array

COLLECTED_INSIDE = """
import gc
from mgf_engine.native import buffers

class Collecting:
    # Stands for the lock, and lets the garbage go while it is held, as any allocation there may
    def __init__(self, lock):
        self.lock = lock
    def __enter__(self):
        self.lock.acquire()
        gc.collect()
    def __exit__(self, *error):
        self.lock.release()
    def acquire(self, *how, **named):
        return self.lock.acquire(*how, **named)
    def release(self):
        self.lock.release()

import torch
frame = buffers.RenderBuffers()
place = frame.array(torch.float32, 1000).data_ptr()
frame.itself = frame  # only the collector ends it
del frame
buffers._lock = Collecting(buffers._lock)
block = buffers._take(4000)
assert block.data_ptr() == place
print("went on")
"""


@pytest.fixture(autouse=True)
def empty_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    gc.collect()
    monkeypatch.setattr(buffers, "_free", [])


def test_a_frame_collected_while_the_pool_is_in_use_does_not_stop_it() -> None:
    done = subprocess.run([sys.executable, "-c", COLLECTED_INSIDE], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "went on", done.stderr


def test_what_is_handed_back_is_taken_again() -> None:
    frame = RenderBuffers()
    place = frame.array(torch.float32, 5000).data_ptr()
    del frame
    again = lasting_array(torch.int32, 4000)
    assert again.data_ptr() == place
    del again
    assert RenderBuffers().array(torch.uint8, 16000).data_ptr() == place


def test_the_pool_keeps_few_arrays_also_when_no_more_are_asked_for() -> None:
    frames = [RenderBuffers() for _ in range(3 * buffers._POOL_LIMIT)]
    for frame in frames:
        frame.array(torch.uint8, 1000)
    del frames, frame
    assert len(buffers._free) == buffers._POOL_LIMIT and buffers._returned.empty()


def test_no_array_is_lost_or_given_twice_among_threads() -> None:
    def work(number: int) -> None:
        for turn in range(300):
            frame = RenderBuffers()
            array = frame.array(torch.int64, 64 + turn)
            array.fill_(number)
            if not bool((array == number).all()):
                wrong.append(number)

    wrong: list[int] = []
    threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong and len({b.data_ptr() for b in buffers._free}) == len(buffers._free)
