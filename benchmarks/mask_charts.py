# SPDX-License-Identifier: GPL-3.0-or-later
"""The chart of ``mgf bench masks``: quality of the masks over the number of clicked photos."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def write_chart(rows: list[dict[str, Any]], path: Path) -> Path | None:
    """Draw mean and worst IoU over the number of clicked photos, a colour per scene, into a file.

    Returns:
        the file, None where there is nothing to draw.
    """
    good = [r for r in rows if r["variant"] in ("1 photo", "2 photos", "3 photos", "a tenth", "a fifth")]
    good = [r for r in good if r.get("children") is not None]
    if len({r["clicked"] for r in good}) < 2:
        return None
    figure, axes = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
    for k, scene in enumerate(dict.fromkeys(r["scene"] for r in good)):
        mine = sorted((r for r in good if r["scene"] == scene), key=lambda r: r["clicked"])
        x = [r["clicked"] for r in mine]
        axes.plot(x, [r["children"] for r in mine], marker="o", color=f"C{k}", label=f"{scene}, mean")
        axes.plot(x, [r["worst"] for r in mine], marker="v", linestyle=":", color=f"C{k}", label="worst not flagged")
    axes.set_xlabel("clicked photos")
    axes.set_ylabel("IoU of the other photos, %")
    axes.grid(True, alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=7, frameon=False, ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path
