# SPDX-License-Identifier: GPL-3.0-or-later
"""Fuzzing of every reader: ``python -m benchmarks.fuzz --cases 1000000``, and a short form among the tests."""
