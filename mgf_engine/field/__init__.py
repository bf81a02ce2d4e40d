# SPDX-License-Identifier: GPL-3.0-or-later
"""Third stage: the masked Gaussian field and its training (section 3.2 of the paper)."""
