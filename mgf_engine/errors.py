# SPDX-License-Identifier: GPL-3.0-or-later
"""Exceptions for bad input and cancelling, exit codes, and a one-sentence explanation of every other exception."""

from __future__ import annotations

import contextlib
import errno
import re
import sys
from pathlib import Path

EXIT_DONE = 0
EXIT_FAULT = 1
EXIT_BAD_INPUT = 2
EXIT_CANCELLED = 3
_FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_ACCESS = (errno.EACCES, errno.EPERM, errno.EROFS)
_BAD_PATH = (errno.ENAMETOOLONG, errno.ELOOP, errno.EISDIR, errno.ENOTDIR)
#: What libraries say in errors of their own when memory is short.
_NO_MEMORY = re.compile(
    r"can(?:'t|not) allocate memory|not enough memory|insufficient memory|bad_alloc|failed to map segment"
    r"|can't start new thread|unable to allocate", re.IGNORECASE
)  # fmt: skip


class _OneSentence(Exception):
    """Its message is one sentence that says what is wrong and what to do; it is shown without a traceback, and the
    process ends with :data:`EXIT_BAD_INPUT`.

    The message is reduced to one line of printable text: names read from files may contain line ends, terminal codes or
    invalid characters.
    """

    def __init__(self, text: str) -> None:
        clean = text.encode("utf-8", "backslashreplace").decode("utf-8")
        super().__init__(re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+", " ", clean))


class BadInput(_OneSentence):
    """Input of the user cannot be used."""


class BadInstallation(_OneSentence):
    """The installation lacks what nothing can replace; what is done instead where input is bad is not done."""


class Cancelled(Exception):
    """The user cancelled the job; it can be resumed."""


def reason(error: BaseException) -> str:
    """Return why something failed, for a sentence: of the system's errors what it says, without number and path."""
    return str(getattr(error, "strerror", None) or error)


def is_full_disk(error: BaseException) -> bool:
    """Tell whether the error means a full disk."""
    return isinstance(error, OSError) and error.errno in _FULL_DISK


def _full_folder(error: BaseException, place: Path | None) -> Path | None:
    """Return the folder whose disk is full: of the file that the error names, or else the one that was written to."""
    name = getattr(error, "filename", None)  # missing where an open file could not grow
    return Path(name).absolute().parent if isinstance(name, str) and name else place


def _was_interrupted(error: BaseException) -> bool:
    """Tell whether Ctrl-C is behind an error: libraries that it meets while they are loaded call themselves broken."""
    seen: BaseException | None = error
    while seen is not None and not isinstance(seen, KeyboardInterrupt):
        seen = seen.__cause__ or seen.__context__
    return seen is not None


def near_memory_limit(share: float = 0.7) -> bool:
    """Tell whether this process came near the limit of its address space (``ulimit -v``); False without one.

    Libraries fail in strange ways when the system denies them memory; this tells what the matter was.
    """
    if not sys.platform.startswith("linux"):
        return False
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return False
    with contextlib.suppress(OSError, ValueError, IndexError):
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return int(status.split("VmPeak:")[1].split()[0]) * 1024 > share * limit
    return False


def explain(
    error: BaseException, *, resumable: bool = True, again: str = "", place: Path | None = None
) -> tuple[int, str]:
    """Return the exit code and sentence of an error.

    Args:
        error: what was raised.
        resumable: it ended a job, which goes on from where it was.
        again: how to go on, where that is not ``--resume``.
        place: folder that was written to, for errors that name no file.
    """
    again = again or ("run again with --resume" if resumable else "run again")
    if isinstance(error, _OneSentence):
        return EXIT_BAD_INPUT, str(error)
    if isinstance(error, Cancelled | KeyboardInterrupt):
        return EXIT_CANCELLED, str(error) or f"Cancelled; {again} to continue."
    if _was_interrupted(error):
        return EXIT_CANCELLED, f"Cancelled; {again} to continue."
    if isinstance(error, BrokenPipeError):
        return EXIT_CANCELLED, f"The reader of the progress messages has closed; {again} to continue."
    if is_full_disk(error):
        folder = _full_folder(error, place)
        if folder is None:
            return EXIT_BAD_INPUT, f"The disk is full; free some space and {again}."
        return EXIT_BAD_INPUT, f"The disk of '{folder}' is full; free some space and {again}."
    if isinstance(error, FileNotFoundError) and error.filename is None:  # where a relative path begins
        return EXIT_BAD_INPUT, "The current folder is gone; go to another one."
    if isinstance(error, OSError) and error.errno in _NO_ACCESS:
        shown = Path(error.filename) if isinstance(error.filename, str) else place
        if shown is not None and shown.name.startswith(".part-"):  # where it was to be written is what is locked
            shown = shown.parent
        return EXIT_BAD_INPUT, f"No permission for '{shown}'; change its permissions or give another folder."
    if isinstance(error, OSError) and error.errno in _BAD_PATH:
        path = str(error.filename)[-60:]
        return EXIT_BAD_INPUT, f"Cannot use the path '{path}' ({error.strerror}); give another one."
    if isinstance(error, UnicodeEncodeError) and error.encoding != "utf-8":
        return EXIT_BAD_INPUT, (
            f"The encoding of this system's paths ({error.encoding}) lacks letters of '{error.object[-60:]}'; set the "
            "environment variable PYTHONUTF8=1."
        )
    if type(error).__name__ == "OutOfMemoryError":  # torch's, for GPUs
        return EXIT_BAD_INPUT, "The GPU's memory is full; lower --resolution or --max-gaussians, or use --device cpu."
    if isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)) or near_memory_limit():
        remedy = "lower --resolution or --max-gaussians" if resumable else "close other programs or give smaller files"
        return EXIT_BAD_INPUT, f"Out of memory; {remedy} and {again}."
    return EXIT_FAULT, f"Unexpected error: {type(error).__name__}: {error}"
