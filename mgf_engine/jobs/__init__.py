# SPDX-License-Identifier: GPL-3.0-or-later
"""The job folder, its inputs and results, and estimates of time and memory."""
