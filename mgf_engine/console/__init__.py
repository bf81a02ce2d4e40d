# SPDX-License-Identifier: GPL-3.0-or-later
"""What commands share: arguments, progress on the terminal, one sentence for each failure."""
