# SPDX-License-Identifier: GPL-3.0-or-later
"""Training on a small textured wall: it learns, repeats itself, and goes on after a stop as if never stopped."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from mgf_engine.errors import BadInput, Cancelled
from mgf_engine.field import trainer
from mgf_engine.field.checkpoint import read_checkpoint, read_field
from mgf_engine.field.trainer import train, training_views
from mgf_engine.messages import Reporter
from mgf_engine.native.library import set_threads
from mgf_engine.options.config import Config, make_config
from mgf_engine.raster import device
from mgf_engine.raster.cuda import tile_list_capacity

#: From points: masks that fill the picture leave the starting surface without a silhouette.
OPTIONS = {"iterations": 120, "densify_every": 20, "max_gaussians": 1500, "geometry_from": 0.3, "start": "dense"}
CENTRES = [[x, y, -3.0] for x in (-0.5, 0, 0.5) for y in (0, 0.4)]


@pytest.fixture(autouse=True)
def two_threads():
    torch.set_num_threads(2)
    set_threads(2)


def same(a, b) -> bool:
    return all(torch.equal(getattr(a, n), getattr(b, n)) for n in ("positions", "log_scales", "opacity_logits", "sh"))


def test_it_learns_the_wall(make_wall, tmp_path) -> None:
    scene, masks = make_wall(CENTRES)
    field, figures = train(scene, masks, make_config(OPTIONS), tmp_path / "run", Reporter())
    curve = figures["curve"]
    assert np.mean([p["psnr"] for p in curve[-12:]]) > 20
    assert np.mean([p["psnr"] for p in curve[-12:]]) > np.mean([p["psnr"] for p in curve[:6]]) + 3
    assert len(field) <= 1500
    solid = field.opacities > 0.5
    assert np.quantile(np.abs(field.positions[solid][:, 2].numpy()), 0.9) < 0.1
    assert same(read_field(tmp_path / "run" / "field.npz"), field)


@pytest.mark.parametrize("by", ["gradient", "absolute_gradient"])
def test_by_gradient_it_grows_and_learns_and_resets_opacities_until_densification_ends(
    make_wall, tmp_path, monkeypatch, by: str
) -> None:
    scene, masks = make_wall(CENTRES)
    resets, reset = [], trainer.reset_opacities
    monkeypatch.setattr(trainer, "reset_opacities", lambda *a: resets.append(a[1]) or reset(*a))
    options = {**OPTIONS, "densify_by": by, "gradient_densification.reset_every": 20, "prune_opacity": 0.005}
    # The cameras stand close together, so that their extent is small beside the wall.
    options |= {"densify_until": 0.3, "gradient_densification.largest": 10.0}
    field, figures = train(scene, masks, make_config(options), tmp_path, Reporter())
    counts = [p["gaussians"] for p in figures["curve"]]
    assert resets == [0.01]  # after 20 of 120 iterations; densification ends after 36
    assert counts[0] < counts[-1] == counts[40] == len(field) <= 1500
    assert np.mean([p["psnr"] for p in figures["curve"][-12:]]) > 20


def test_the_same_seed_gives_the_same_field_and_another_seed_another(make_wall, tmp_path) -> None:
    scene, masks = make_wall(CENTRES)
    options = {**OPTIONS, "iterations": 50}
    fields = [
        train(scene, masks, make_config({**options, "seed": seed}), tmp_path / f"{k}", Reporter())[0]
        for k, seed in enumerate((3, 3, 4))
    ]
    assert same(fields[0], fields[1])
    assert not same(fields[0], fields[2])


@pytest.mark.parametrize(("every", "complete"), [(3, False), (12, True)])
def test_gaussians_are_not_called_unseen_before_every_photo_had_a_turn(
    make_wall, tmp_path, monkeypatch, every: int, complete: bool
) -> None:
    scene, masks = make_wall(CENTRES)
    asked, densify = [], trainer.densify_and_prune
    monkeypatch.setattr(
        trainer, "densify_and_prune", lambda *a, prune_unseen: asked.append(prune_unseen) or densify(*a)
    )
    train(scene, masks, make_config({**OPTIONS, "iterations": 24, "densify_every": every}), tmp_path, Reporter())
    assert len(asked) == 24 // every and set(asked) == {complete}


@pytest.mark.parametrize("backend", ["cpu", "cuda-source-on-cpu"])
def test_a_stopped_run_goes_on_as_if_never_stopped(make_wall, tmp_path, monkeypatch, backend) -> None:
    monkeypatch.setattr(device, "CPU_BACKEND", backend)
    if backend != "cpu":
        monkeypatch.setattr(
            tile_list_capacity, "_SPARE", 0.98
        )  # so tight that renderings are lost, and it matters which
        monkeypatch.setattr(tile_list_capacity, "_STEP", 1)
    scene, masks = make_wall(CENTRES)
    config = make_config({**OPTIONS, "iterations": 60})
    whole, _ = train(scene, masks, config, tmp_path / "whole", Reporter())

    def stop_at_half(message: dict) -> None:
        if message["type"] == "progress" and message["fraction"] > 0.55:
            reporter.cancel()

    reporter = Reporter(stop_at_half, min_interval=0)
    reporter.stage("field")
    with pytest.raises(Cancelled):
        train(scene, masks, config, tmp_path / "halves", reporter)
    assert not (tmp_path / "halves" / "field.npz").exists()
    resumed, figures = train(scene, masks, config, tmp_path / "halves", Reporter())
    assert same(whole, resumed)
    assert figures["iterations"] == 60


def test_a_damaged_checkpoint_is_not_used(tmp_path) -> None:
    path = tmp_path / "training.npz"
    for content in (b"", b"PK\x03\x04 garbage", b"x" * 1000):
        path.write_bytes(content)
        assert read_checkpoint(path) is None


def test_training_says_when_it_starts_over_from_a_damaged_checkpoint(make_wall, tmp_path) -> None:
    scene, masks = make_wall(CENTRES)
    config = make_config({**OPTIONS, "iterations": 5})
    fresh, _ = train(scene, masks, config, tmp_path / "fresh", Reporter())
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "training.npz").write_bytes(b"PK\x03\x04 garbage")
    reporter = Reporter()
    field, _ = train(scene, masks, config, tmp_path / "run", reporter)
    assert any("checkpoint" in text for text in reporter.warnings)
    assert same(field, fresh)


@pytest.mark.parametrize("switch", ["multilevel_loss", "boundary_loss", "coarse_to_fine", "use_masks", "masked_images"])
def test_every_ingredient_can_be_switched_on_and_off(make_wall, tmp_path, switch) -> None:
    scene, masks = make_wall(CENTRES)
    config = make_config({**OPTIONS, "iterations": 21, switch: not getattr(Config(), switch)})
    field, _ = train(scene, masks, config, tmp_path / "run", Reporter())
    assert all(bool(torch.isfinite(v).all()) for v in (field.positions, field.log_scales, field.sh))


def test_no_usable_mask_is_refused(make_wall) -> None:
    scene, masks = make_wall(CENTRES)
    with pytest.raises(BadInput, match="usable mask"):
        training_views(scene, replace(masks, used=np.zeros(6, bool)))
