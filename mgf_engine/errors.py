# SPDX-License-Identifier: GPL-3.0-or-later
"""The two ways a job ends early on purpose, and the exit codes people's scripts rely on."""

import re

EXIT_DONE = 0
EXIT_FAULT = 1
EXIT_BAD_INPUT = 2
EXIT_CANCELLED = 3


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is one clear sentence that says what is wrong and what to do; it is shown as it is,
    without a traceback, and the process ends with :data:`EXIT_BAD_INPUT`. It stays one line of printable text
    whatever the input holds: names out of files may carry line ends, terminal codes or broken letters.
    """

    def __init__(self, text: str) -> None:
        clean = text.encode("utf-8", "backslashreplace").decode("utf-8")
        super().__init__(re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+", " ", clean))


class Cancelled(Exception):
    """The user asked the job to stop; what was done so far stays resumable."""
