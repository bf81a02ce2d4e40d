# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels of another processor or system, run by an emulator and called from the tests like this machine's."""
