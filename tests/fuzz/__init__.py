# SPDX-License-Identifier: GPL-3.0-or-later
"""Fuzzing of every reader: ``PYTHONPATH=tests python -m fuzz --cases 1000000``, and a short form among the tests."""
