# SPDX-License-Identifier: GPL-3.0-or-later
"""Many buildings of one scene: find footprints, click automatically, run a job for each, collect the results.

``plan`` chooses photos (``view_selection``) and clicks (``clicks``) of each footprint (``footprints``, or ``find``
without a map); ``run`` is ``mgf town``: it starts a ``worker`` for each building under Snakemake (``workflow``), and
``result`` gathers what comes back.
"""
