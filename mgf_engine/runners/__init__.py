# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions that run the stages of a job, a module each: ``(job, reporter) -> figures``; ``stages.py`` lists them."""
