# SPDX-License-Identifier: GPL-3.0-or-later
"""Every option of a job and of its algorithms: tables, values, presets, what users give."""
