# SPDX-License-Identifier: GPL-3.0-or-later
"""One picture of a finished job for the README: photo, mask, render, normals and meshes of one view side by side."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from mgf_engine.errors import BadInput
from mgf_engine.evaluation.pictures import mask_overlay, normal_picture, on_white
from mgf_engine.export.views import render_view
from mgf_engine.geometry.mesh_files import read_texture
from mgf_engine.geometry.rasterize import shaded
from mgf_engine.jobs.job import Job
from mgf_engine.jobs.results import load_field, load_inputs, load_mesh
from mgf_engine.model.masks import building
from mgf_engine.texture.draw import draw_textured


def main() -> int:
    """Write the picture; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("job", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--view", type=int, default=0, help="index of the photo")
    args = parser.parse_args()
    with Job.start(args.job, resume=True) as job:
        scene, masks = load_inputs(job)
        field, mesh, texture = load_field(job), load_mesh(job), read_texture(args.job)
    mesh = replace(mesh, vertices=scene.to_normalised.apply(mesh.vertices))
    view, photo, labels = scene.views[args.view], scene.photo(args.view), masks.labels[args.view]
    rendering = render_view(field, view, job.config.sh_degree)
    assert rendering.normal is not None
    render = (rendering.color.clamp(0, 1).permute(1, 2, 0).numpy() * 255).astype(np.uint8)
    normals = normal_picture(rendering.normal.permute(1, 2, 0).numpy(), rendering.alpha.numpy())
    panels = [
        photo, mask_overlay(photo, labels), on_white(render, building(labels)), normals, shaded(mesh, view),
        draw_textured(mesh, texture, view)[0],
    ]  # fmt: skip
    rows = [np.concatenate(panels[k : k + 3], axis=1) for k in (0, 3)]
    picture = np.concatenate(rows, axis=0)
    scale = min(1.0, 1500 / picture.shape[1])
    picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    args.picture.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(args.picture), picture[:, :, ::-1])
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BadInput as error:
        sys.exit(f"Error: {error}")
