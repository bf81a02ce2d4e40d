# SPDX-License-Identifier: GPL-3.0-or-later
"""Snakemake that ends with whoever started it: ``python -m mgf_engine.town.submit ARGUMENTS``.

On a cluster nothing else would: jobs there do not hang on the pipe of ``mgf town``, and a Snakemake that was left alone
would go on to submit jobs, beside the one that the next ``mgf town`` starts. At the end of standard input it is told
to stop, as by Ctrl-C, and cancels the jobs.
"""

from __future__ import annotations

import os
import signal
import sys
import threading


def main() -> None:
    """Run Snakemake's command line; ends with its exit code."""
    from snakemake.cli import main as snakemake

    signal.signal(signal.SIGINT, signal.default_int_handler)  # a script's `mgf town … &` ignores it, and so would this
    threading.Thread(target=_stop_at_end_of_input, daemon=True).start()
    snakemake(sys.argv[1:])


def _stop_at_end_of_input() -> None:
    while os.read(0, 1):  # sys.stdin would be locked by this thread when the interpreter ends
        pass
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    main()
