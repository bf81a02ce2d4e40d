# SPDX-License-Identifier: GPL-3.0-or-later
"""What each stage of a job does, a module each: ``(job, reporter) -> figures``, named in :mod:`mgf_engine.stages`."""
