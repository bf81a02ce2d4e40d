# SPDX-License-Identifier: GPL-3.0-or-later
"""``mgf preview``: segment one photo from its own clicks, fast enough for an update after every click.

Only that photo and the sparse points that it observed are read. The masks stage, which uses all photos together, gives
better masks. The preview is in the frame of the user's original photo.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mgf_engine.console.commands import read_algorithm_options
from mgf_engine.errors import BadInput
from mgf_engine.files.images import apply_orientation, read_rgb, resize
from mgf_engine.masks.build import choose_segmenter
from mgf_engine.masks.geometry.building_extent import ExtentOptions
from mgf_engine.masks.geometry.point_features import PointFeatureOptions, measure_point_features
from mgf_engine.masks.image_ops import rgb_to_lab
from mgf_engine.masks.prompts import Clicks, read_clicks_of
from mgf_engine.masks.propagation.draw_mask import draw_mask, make_hints
from mgf_engine.masks.propagation.label_graph import LabelGraph
from mgf_engine.masks.propagation.propagation_options import PropagationOptions
from mgf_engine.masks.propagation.random_walker import LabelPropagation
from mgf_engine.masks.propagation.random_walker_options import RandomWalkerOptions
from mgf_engine.masks.propagation.sky_regions import SkyOptions
from mgf_engine.masks.propagation.stable_masks import enforce_clicks, first_clicks, merge_masks, set_clicked_pixels
from mgf_engine.masks.propagation.superpixels import SuperpixelOptions, cut_regions
from mgf_engine.masks.refinement.homogeneous_regions import HomogeneousRegionOptions, find_clicked_regions
from mgf_engine.masks.segmenters.base import Hints, Segment, agreement
from mgf_engine.masks.store import write_image
from mgf_engine.messages import Reporter
from mgf_engine.model.scene import Scene, Similarity, View
from mgf_engine.native.parallel import parallel_map
from mgf_engine.options.config import Config, make_config, renamed_values
from mgf_engine.scene.cameras import from_original, to_original
from mgf_engine.scene.colmap import find_model, find_photos, list_photos, read_model
from mgf_engine.scene.gravity import GravityOptions, up_of_tilted_view
from mgf_engine.scene.load import build_scene
from mgf_engine.scene.names import named_like
from mgf_engine.scene.normalise import normalise_pose, rotation_of
from mgf_engine.scene.photos import plan_photos
from mgf_engine.scene.sparse import SparseImage, SparseModel, SparsePoints
from mgf_engine.system.machine import cores
from mgf_engine.weights import default_folder

_MAP_STEP = 8  # px between the places where the lens is evaluated


def preview_command(args: argparse.Namespace) -> int:
    """Run ``mgf preview``; returns 0.

    Raises:
        BadInput: anything about the scene, the clicks or the output that cannot be used.
    """
    started = time.perf_counter()
    if args.out.suffix.lower() != ".png":
        raise BadInput(f"The mask '{args.out}' should be a PNG; give a name that ends in .png.")
    given = {n: getattr(args, n) for n in ("resolution", "segmenter", "weights")}
    config = make_config({**given, **read_algorithm_options(args, "preview")})
    for text in renamed_values(given):
        print(f"Warning: {text}", file=sys.stderr)
    mask, score = preview(args.scene, args.prompts, args.image, config)
    try:
        write_image(args.out, np.where(mask, 255, 0).astype(np.uint8))
    except OSError as error:
        raise BadInput(f"Cannot write the mask '{args.out}' ({error.strerror}); give another place.") from error
    print(f"Mask of '{args.image}': {mask.mean():.0%} of the photo, score {score:.2f}, "
          f"{time.perf_counter() - started:.1f} s, in {args.out}")  # fmt: skip
    return 0


def preview(source: Path, prompts: Path, name: str, config: Config) -> tuple[NDArray[np.bool_], float]:
    """Return the mask of one photo from its own clicks.

    Args:
        source: COLMAP scene or folder of photos.
        prompts: the clicks' file; other photos in it are not looked at.
        name: the photo, as in the model or in the prompts.
        config: ``resolution`` (longest side of the answer), ``segmenter``, ``weights``, ``threads``, ``seed``.

    Returns:
        bool [h, w] in the frame of the user's photo, and the agreement with clicks and points, 0..1.

    Raises:
        BadInput: no such photo, no click on the building in it, or unreadable input.
    """
    if not source.is_dir():
        raise BadInput(f"The scene '{source}' is not a folder; give a COLMAP scene or a folder of photos.")
    scene, photo, up = one_view(source.resolve(), name, config)
    clicks = read_clicks_of(prompts, scene.views[0])
    if not len(clicks.positive):
        raise BadInput(f"'{prompts}' has no click on the building in '{name}'; click at least one point on it.")
    segment = _segment(scene, photo, up, clicks, config)
    view = scene.views[0]
    mask = _in_original(segment.mask, view, config.resolution)
    scale = np.array([mask.shape[1] / view.original_width, mask.shape[0] / view.original_height])
    kinds = (to_original(view, points) * scale for points in (clicks.positive, clicks.negative))
    return set_clicked_pixels(mask, Clicks(*kinds)), segment.score


def one_view(source: Path, name: str, config: Config) -> tuple[Scene, NDArray[np.uint8], NDArray[np.float64] | None]:
    """Read one photo of a scene.

    Returns:
        A scene of the photo and the points it observed, its working photo RGB uint8 [H, W, 3], and up by all cameras
        [3] in the normalised frame of that scene; None where up in the photo serves.
    """
    folder = find_model(source)
    if folder is None:
        root, names = list_photos(source)
        return *_without_model(root, _match(name, names, source), config), None
    whole = read_model(folder)
    wanted = _match(name, [image.name for image in whole.images], source)
    image = next(image for image in whole.images if image.name == wanted)
    model = _only(whole, image)
    planned = plan_photos(model, find_photos([image.name], folder, source), config.resolution, Reporter())
    scene = build_scene(model, planned, source, replace(config, holdout_every=0))
    photo = read_rgb(planned[0].path)
    if planned[0].orientation != 1:
        photo = apply_orientation(photo, planned[0].orientation)
    return scene, planned[0].camera.make_photo(photo), _up_by_all(scene, whole, config)


def _up_by_all(scene: Scene, model: SparseModel, config: Config) -> NDArray[np.float64] | None:
    """Return up by all cameras of a model where the photo of a scene is far from level, [3]; None where it is not.

    Only the photo's own file was read: all cameras are taken to be held as its camera was.
    """
    view, options = scene.views[0], config.algorithm(PropagationOptions)
    poses = (
        normalise_pose(rotation_of(image.quaternion), image.translation, scene.to_normalised) for image in model.images
    )
    others = [replace(view, rotation=rotation, translation=translation) for rotation, translation in poses]
    return up_of_tilted_view(view, others, options.steep, options.level_rms, config.algorithm(GravityOptions))


def _match(name: str, names: list[str], source: Path) -> str:
    """Find the photo meant, see :func:`mgf_engine.scene.names.named_like`."""
    found = named_like(name, names)
    if len(found) == 1:
        return names[found[0]]
    some = ", ".join(names[:3]) or "none"
    raise BadInput(f"'{source}' has no photo '{name}' (it has {some}, ...); give its name as in the prompts.")


def _only(model: SparseModel, image: SparseImage) -> SparseModel:
    """Strip the model of all other photos and the points this one did not observe."""
    points = model.points
    mine = np.flatnonzero(points.image_ids == image.id)
    rows, first = np.unique(points.track_point[mine], return_index=True)
    kept = SparsePoints(
        points.ids[rows], points.xyz[rows], points.rgb[rows], points.errors[rows],
        np.arange(len(rows) + 1), points.image_ids[mine[first]], points.keypoint[mine[first]],
    )  # fmt: skip
    return SparseModel(model.folder, model.cameras, (image,), kept, None)


def _without_model(root: Path, name: str, config: Config) -> tuple[Scene, NDArray[np.uint8]]:
    """Take a folder of photos that no model places yet: the photo as it is stored, no points."""
    photo = read_rgb(root / name)
    height, width = photo.shape[:2]
    scale = min(1.0, config.resolution / max(width, height))
    w, h = max(1, round(width * scale)), max(1, round(height * scale))
    focal = 1.2 * max(w, h)  # what COLMAP assumes without EXIF
    view = View(name, name, w, h, focal, focal, w / 2, h / 2, np.eye(3), np.zeros(3), width, height)
    scene = Scene(
        (view,), np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, np.float32), np.zeros(1, np.int64),
        np.zeros(0, np.int32), np.zeros((0, 2), np.float32), Similarity(1.0, np.eye(3), np.zeros(3)), (0,), (), root,
    )  # fmt: skip
    return scene, resize(photo, w, h)


def _segment(
    scene: Scene, photo: NDArray[np.uint8], up: NDArray[np.float64] | None, clicks: Clicks, config: Config
) -> Segment:
    regions, options = cut_regions(photo, config.algorithm(SuperpixelOptions)), config.algorithm(PropagationOptions)
    graph = LabelGraph(
        scene,
        [regions],
        measure_point_features(scene, up, config.algorithm(PointFeatureOptions)),
        options=config.algorithm(RandomWalkerOptions),
        sky=config.algorithm(SkyOptions),
    )
    walker = LabelPropagation(graph, config.algorithm(ExtentOptions))
    segmenter = choose_segmenter(config, default_folder().parent)

    def answer(given: Clicks) -> tuple[Segment, Hints]:
        probability = walker.solve({0: given}, config.seed)
        hints = make_hints(scene, 0, given, regions, probability, (probability.points > 0.5)[scene.track_point])
        return draw_mask(segmenter, photo, hints, options), hints

    *earlier, everything = first_clicks(clicks)
    last, hints = answer(everything)  # first, since it leaves behind what the others can use
    threads = config.threads or cores()
    masks = [segment.mask for (segment, _) in parallel_map(lambda i: answer(earlier[i]), range(len(earlier)), threads)]
    mask = merge_masks([*masks, last.mask], options.click_loss)
    plain = config.algorithm(HomogeneousRegionOptions)
    mask = mask | find_clicked_regions(rgb_to_lab(photo), mask, clicks.positive, clicks.negative, plain)
    mask = enforce_clicks(mask, regions, clicks)
    return Segment(mask, agreement(mask, hints))


def _in_original(mask: NDArray[np.bool_], view: View, resolution: int) -> NDArray[np.bool_]:
    """Return a working mask in the frame of the user's photo, reduced to at most ``resolution`` pixels on a side."""
    scale = min(1.0, resolution / max(view.original_width, view.original_height))
    w, h = max(1, round(view.original_width * scale)), max(1, round(view.original_height * scale))
    if view.lens is None:
        return cv2.resize(mask.astype(np.uint8), (w, h), interpolation=cv2.INTER_NEAREST) > 0
    # The lens on a coarse grid (its corners at pixel centres), smoothly in between.
    gw, gh = max(2, w // _MAP_STEP), max(2, h // _MAP_STEP)
    x, y = np.meshgrid(
        (np.arange(gw) + 0.5) * view.original_width / gw, (np.arange(gh) + 0.5) * view.original_height / gh
    )
    working = from_original(view, np.stack([x.ravel(), y.ravel()], 1)).reshape(gh, gw, 2) - 0.5
    maps = cv2.resize(np.nan_to_num(working, nan=-1e4).astype(np.float32), (w, h), interpolation=cv2.INTER_LINEAR)
    return cv2.remap(mask.astype(np.uint8), maps, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0  # type: ignore[call-overload]
