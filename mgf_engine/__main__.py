# SPDX-License-Identifier: GPL-3.0-or-later
"""``python -m mgf_engine`` is the ``mgf`` command."""

import sys

from mgf_engine.cli import main

sys.exit(main())
