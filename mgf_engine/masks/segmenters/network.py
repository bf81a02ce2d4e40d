# SPDX-License-Identifier: GPL-3.0-or-later
"""Run an ONNX file in ONNX Runtime; failures become one sentence, those of a GPU provider fall back to the CPU."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnxruntime
from numpy.typing import NDArray

from mgf_engine.errors import BadInput

_NO_MEMORY = re.compile(r"allocat\w* (?:\w+ )?memory|out of memory|bad_alloc", re.IGNORECASE)


class Network:
    """One ONNX file in ONNX Runtime; when a GPU provider fails, the CPU goes on.

    Raises:
        BadInput: the file is no ONNX model or lacks these inputs or outputs.
    """

    def __init__(
        self, path: Path, threads: int, gpu: bool, inputs: set[str], outputs: set[str], warn: Callable[[str], None]
    ) -> None:
        self._path, self._threads, self._warn, self._lock = path, threads, warn, threading.Lock()
        wanted = ["CUDAExecutionProvider", "CoreMLExecutionProvider"] if gpu else []
        self._gpu = [p for p in wanted if p in onnxruntime.get_available_providers()]
        try:
            self._session = self._open()
        except Exception as error:  # ONNX Runtime raises its own types, one per kind of damage
            reason = _first_line(error)
            raise BadInput(f"'{path}' cannot be loaded as an ONNX model ({reason}); download it again.") from error
        self._inputs = {i.name: i.shape for i in self._session.get_inputs()}
        have_in, have_out = set(self._inputs), {o.name for o in self._session.get_outputs()}
        if not (inputs <= have_in and outputs <= have_out):
            lacking = ", ".join(sorted((inputs - have_in) | (outputs - have_out)))
            text = f"'{path}' is not an EfficientSAM model (it lacks {lacking}); use the files of 'mgf weights'."
            raise BadInput(text)

    def fixed(self, name: str, axis: int) -> int | None:
        """Return the length of an input's axis where the file allows one length only."""
        shape = self._inputs[name]
        return shape[axis] if len(shape) > axis and isinstance(shape[axis], int) else None

    def run(self, outputs: tuple[str, ...], feed: dict[str, NDArray[Any]]) -> list[NDArray[Any]]:
        """Compute these outputs for these inputs.

        Raises:
            BadInput: the file does not take such inputs.
            MemoryError: memory is short.
        """
        session = self._session
        try:
            return list(session.run(list(outputs), feed))
        except Exception as error:  # see above
            if not self._gpu:
                raise self._failure(error) from error
            self._to_cpu(error)
        try:
            return list(self._session.run(list(outputs), feed))
        except Exception as error:
            raise self._failure(error) from error

    def refusal(self, reason: str) -> BadInput:
        """Return the sentence for a file that does something else than EfficientSAM."""
        return BadInput(
            f"'{self._path}' is not a working EfficientSAM model ({reason}); use the files of 'mgf weights', or "
            "choose segmenter=random_walker, which needs none."
        )

    def _open(self) -> Any:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = self._threads
        options.log_severity_level = 3
        options.enable_cpu_mem_arena = False  # give the encoder's memory back after each image
        try:
            return onnxruntime.InferenceSession(
                str(self._path), options, providers=[*self._gpu, "CPUExecutionProvider"]
            )
        except Exception as error:
            if not self._gpu:
                raise
            self._gpu, failed = [], self._gpu[0]
            session = onnxruntime.InferenceSession(str(self._path), options, providers=["CPUExecutionProvider"])
            self._say(failed, error)  # only now: a damaged file is no fault of the provider's
            return session

    def _to_cpu(self, error: Exception) -> None:
        with self._lock:  # several threads may fail at once
            if self._gpu:
                self._say(self._gpu[0], error)
                self._gpu = []
                self._session = self._open()

    def _say(self, provider: str, error: Exception) -> None:
        name = provider.removesuffix("ExecutionProvider")
        self._warn(
            f"ONNX Runtime's {name} provider failed ({_first_line(error)}); EfficientSAM runs on the CPU instead."
        )

    def _failure(self, error: Exception) -> Exception:
        if isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)):
            return MemoryError(_first_line(error))
        return self.refusal(_first_line(error))


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0][:160] if str(error).strip() else type(error).__name__
