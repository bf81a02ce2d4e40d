# SPDX-License-Identifier: GPL-3.0-or-later
"""``python -m mgf_engine`` is the ``mgf`` command."""

import sys


def main() -> int:
    """Run the command line; returns the exit code."""
    code = _run()
    exec("")  # of nothing: clears the mark that a Ctrl-C inside an exec leaves, with which Python ends by the signal
    return code


def _run() -> int:
    """Load and run the command line; Ctrl-C while it is being loaded is no traceback either."""
    try:
        from mgf_engine.cli.main import main as run
    except KeyboardInterrupt:
        from mgf_engine.errors import EXIT_CANCELLED

        print("Cancelled.", file=sys.stderr)
        return EXIT_CANCELLED
    return run()


if __name__ == "__main__":
    sys.exit(main())
