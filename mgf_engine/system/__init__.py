# SPDX-License-Identifier: GPL-3.0-or-later
"""Facts about this machine and process: cores, memory, time, worker processes."""
