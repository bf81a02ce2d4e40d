# SPDX-License-Identifier: GPL-3.0-or-later
"""The command mgf: its arguments, and commands too small for a package of their own."""
