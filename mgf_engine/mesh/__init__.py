# SPDX-License-Identifier: GPL-3.0-or-later
"""Fourth stage: from the trained field to a clean triangle mesh (section 3.3 of the paper)."""
