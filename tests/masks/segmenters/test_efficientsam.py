# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole path through ONNX Runtime, on a small pair that segments by colour (the real weights are not here)."""

import io
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import onnxruntime
import pytest
from support.segmenters import hints, install, iou
from support.small_sam import write_pair

from benchmarks.synthetic.house import House
from mgf_engine.errors import BadInput
from mgf_engine.masks.build import build_masks, choose_segmenter
from mgf_engine.masks.elements import sam_elements
from mgf_engine.masks.segmenters.efficientsam import EfficientSam, point_prompts, sample_spread_points
from mgf_engine.masks.segmenters.messages import describe_used_segmenter
from mgf_engine.masks.segmenters.random_walker import MaskDrawingOptions, RandomWalker
from mgf_engine.messages import Reporter
from mgf_engine.model.masks import building
from mgf_engine.model.scene import Scene
from mgf_engine.options.config import make_config
from mgf_engine.weights import WEIGHTS

RED, GREEN = (200, 60, 50), (60, 150, 70)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_pair(tmp_path_factory.mktemp("weights"))


@pytest.fixture
def sam(pair: tuple[Path, Path], tmp_path: Path) -> EfficientSam:
    return EfficientSam(*pair, tmp_path / "cache", threads=1, gpu=False)


@pytest.fixture
def photo() -> np.ndarray:
    image = np.full((160, 240, 3), GREEN, np.uint8)
    image[40:120, 60:180] = RED
    return image


def test_segments_what_the_points_are_on(sam: EfficientSam, photo: np.ndarray):
    truth = (photo == RED).all(-1)
    found = sam.segment(photo, hints(truth.shape, positive=np.array([[120.0, 80]])))
    assert found.mask.shape == truth.shape and found.mask.dtype == bool
    assert iou(found.mask, truth) > 0.93 and found.score == 1.0


def test_rejected_points_choose_the_candidate(sam: EfficientSam, photo: np.ndarray):
    photo[40:60, 60:180] = (225, 85, 75)  # a shade that only the wider masks take in
    clicks = np.array([[120.0, 100]])
    wide = sam.segment(photo, hints((160, 240), positive=clicks, accepted=np.array([[120.0, 50]] * 20)))
    narrow = sam.segment(photo, hints((160, 240), positive=clicks, negative=np.array([[120.0, 50]])))
    assert wide.mask[50, 120] and not narrow.mask[50, 120] and narrow.mask[100, 120]


def test_embeddings_are_cached_on_disk(sam: EfficientSam, photo: np.ndarray, pair: tuple[Path, Path], tmp_path: Path):
    first = sam.embed(photo)
    assert first.shape == (1, 256, 64, 64) and first.dtype == np.float32
    files = list((tmp_path / "cache").glob("*.npy"))
    assert len(files) == 1 and files[0].stat().st_size < 2.2e6
    again = EfficientSam(*pair, tmp_path / "cache", threads=1, gpu=False)
    again._encoder = None  # would fail if it were needed
    assert (again.embed(photo) == first).all()
    files[0].write_bytes(b"broken")
    assert (sam.embed(photo) == first).all()


def test_large_photos_ask_for_small_masks(sam: EfficientSam):
    photo = np.full((1500, 3000, 3), GREEN, np.uint8)
    photo[300:1200, 600:2400] = RED
    masks, quality = sam.predict(sam.embed(photo), photo.shape[:2], np.array([[1500.0, 700]]), np.array([1.0]))
    assert masks.shape == (3, 512, 1024) and quality.shape == (3,)
    found = sam.segment(photo, hints(photo.shape[:2], positive=np.array([[1500.0, 700]])))
    # One cell of the 64 x 64 grid is 47 px wide here: that is all the small pair can resolve.
    assert found.mask.shape == (1500, 3000) and iou(found.mask, (photo == RED).all(-1)) > 0.92


def test_without_a_point_on_the_building_nothing_is_asked(sam: EfficientSam, photo: np.ndarray):
    sam._encoder = None  # would fail if it were needed
    found = sam.segment(photo, hints((160, 240), rejected=np.array([[120.0, 80]])))
    assert not found.mask.any() and found.score == 0.0


def test_options_of_specks_and_holes_are_those_of_the_job(pair: tuple[Path, Path], photo: np.ndarray, tmp_path: Path):
    photo[70:90, 100:120] = GREEN
    for hole in (0.0, 0.1):
        options = MaskDrawingOptions(hole=hole)
        sam = EfficientSam(*pair, tmp_path / "cache", threads=1, gpu=False, options=options)
        found = sam.segment(photo, hints((160, 240), positive=np.array([[80.0, 60]])))
        assert found.mask[60, 80] and bool(found.mask[80, 110]) == (hole > 0)


def test_queries_never_have_more_than_six_points():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 100, (200, 2))
    asked = list(point_prompts(hints((100, 100), positive=points[:9], accepted=points, box=(1.0, 2.0, 90.0, 95.0)), 0))
    assert len(asked) == 4
    for chosen, labels in asked:
        assert len(chosen) == len(labels) <= 6
    assert asked[1][1].tolist() == [2, 3, 1, 1, 1, 1]
    second = list(point_prompts(hints((100, 100), accepted=points, box=(1.0, 2.0, 90.0, 95.0)), 1))
    assert not any(np.array_equal(a[0], b[0]) for a in asked[1:] for b in second)
    assert not list(point_prompts(hints((100, 100)), 0))


def test_spread_points_are_far_apart():
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), -1).reshape(-1, 2)
    chosen = sample_spread_points(grid, 5)
    gaps = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1) + 99 * np.eye(5)
    assert gaps.min() > 6


def test_elements_by_a_grid_of_points(sam: EfficientSam, photo: np.ndarray):
    inside = (photo == RED).all(-1)
    photo[60:80, 90:110] = (40, 40, 200)
    elements = sam_elements(photo, inside, sam)
    window = np.zeros_like(inside)
    window[60:80, 90:110] = True
    assert any(iou(e, window) > 0.7 for e in elements)
    assert all(not (e & ~inside).any() for e in elements)


class _FixedMasks:
    """Answers every question with the same masks, as logits of 10 inside and -10 outside, and their qualities."""

    def __init__(self, masks: list[np.ndarray], quality: list[float]) -> None:
        self.logits, self.quality = [np.where(mask, 10.0, -10.0).astype(np.float32) for mask in masks], quality

    def embed(self, photo: np.ndarray) -> None:
        return None

    def predict(self, embedding: None, size: tuple[int, int], points: np.ndarray, labels: np.ndarray):
        return self.logits, self.quality


def test_of_two_masks_that_nearly_agree_the_better_is_kept() -> None:
    inside = np.ones((40, 60), bool)
    first, nearly, beside = np.zeros((3, 40, 60), bool)
    first[10:20, 10:20], nearly[10:20, 11:21], beside[10:20, 16:26] = True, True, True  # overlaps: 9 / 11, 4 / 16
    model = _FixedMasks([first, nearly, beside], [0.9, 0.95, 0.85])
    kept = sam_elements(np.zeros((40, 60, 3), np.uint8), inside, model)  # type: ignore[arg-type]
    assert len(kept) == 2 and (kept[0] == nearly).all() and (kept[1] == beside).all()


def test_whole_stage(scene: Scene, house: House, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    weights = tmp_path / "weights"
    install(weights, monkeypatch)
    config = make_config({"segmenter": "efficientsam", "weights": str(weights), "device": "cpu"})
    messages: list[dict] = []
    masks = build_masks(scene, house.prompts, None, tmp_path / "masks", config, Reporter(messages.append))
    (said,) = (m for m in messages if m["type"] == "segmenter")
    assert said["segmenter"] == "efficientsam" and "random_walker" in said["text"]
    assert describe_used_segmenter(tmp_path / "masks") == "EfficientSAM"
    scores = [iou(building(m), house.masks[v.name]) for m, v in zip(masks.labels, scene.views, strict=True)]
    assert np.mean(scores) > 0.85
    assert len(list((tmp_path / "masks/embeddings").glob("*.npy"))) == len(scene.views)


def test_choice_of_the_segmenter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "weights"
    auto = make_config({"weights": str(folder), "device": "cpu"})
    wanted = make_config({"weights": str(folder), "segmenter": "efficientsam", "device": "cpu"})
    assert isinstance(choose_segmenter(auto, tmp_path), RandomWalker)
    with pytest.raises(BadInput, match="mgf weights"):
        choose_segmenter(wanted, tmp_path)
    install(folder, monkeypatch)
    assert isinstance(choose_segmenter(auto, tmp_path), EfficientSam)
    plain = make_config({"weights": str(folder), "segmenter": "random_walker"})
    assert isinstance(choose_segmenter(plain, tmp_path), RandomWalker)
    encoder = folder / WEIGHTS["vitt"][0].name
    encoder.write_bytes(encoder.read_bytes()[:-1] + b"x")
    with pytest.raises(BadInput, match="damaged or of another version"):
        choose_segmenter(auto, tmp_path)


def test_wrong_files_have_a_sentence(pair: tuple[Path, Path], tmp_path: Path):
    with pytest.raises(BadInput, match="is not an EfficientSAM model"):
        EfficientSam(pair[1], pair[0], tmp_path)
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"\x00garbage")
    with pytest.raises(BadInput, match="cannot be loaded"):
        EfficientSam(broken, pair[1], tmp_path)


def test_a_damaged_embedding_is_made_again(sam: EfficientSam, photo: np.ndarray, tmp_path: Path):
    first = sam.embed(photo)
    (file,) = (tmp_path / "cache").glob("*.npy")
    huge = io.BytesIO()
    np.lib.format.write_array_header_1_0(huge, {"descr": "<f2", "fortran_order": False, "shape": (1 << 40,)})
    small = io.BytesIO()
    np.save(small, np.zeros(3, np.float16))
    for damage in (huge.getvalue(), small.getvalue(), b"", b"\x93NUMPY"):
        file.write_bytes(damage)
        assert (sam.embed(photo) == first).all()


@pytest.mark.parametrize("points", [2, 6, 9])
def test_a_decoder_with_a_fixed_number_of_points(photo: np.ndarray, tmp_path: Path, points: int):
    sam = EfficientSam(*write_pair(tmp_path / "weights", points=points), tmp_path / "cache", threads=1, gpu=False)
    truth = (photo == RED).all(-1)
    given = hints(
        truth.shape, positive=np.array([[120.0, 80]]), accepted=np.array([[x, 60.0] for x in range(70, 170, 9)])
    )
    assert iou(sam.segment(photo, given).mask, truth) > 0.93


def test_a_decoder_that_takes_something_else_has_a_sentence(pair: tuple[Path, Path], photo: np.ndarray, tmp_path: Path):
    model = onnx.load(pair[1])
    for shape in ([2, 256, 64, 64], [1, 256, 32, 32]):
        for dim, size in zip(model.graph.input[0].type.tensor_type.shape.dim, shape, strict=True):
            dim.dim_value = size
        other = tmp_path / "other.onnx"
        other.write_bytes(model.SerializeToString())
        sam = EfficientSam(pair[0], other, tmp_path / "cache", threads=1, gpu=False)
        with pytest.raises(
            BadInput, match=r"^'.*other\.onnx' is not a working EfficientSAM model \(.*random_walker[^\n]*$"
        ):
            sam.segment(photo, hints((160, 240), positive=np.array([[120.0, 80]])))


class Provider:
    """ONNX Runtime with a CUDA provider that fails: while it is loaded, or while it computes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, while_loading: bool, error: str = "CUDA error 700") -> None:
        self.real, self.while_loading, self.error = onnxruntime.InferenceSession, while_loading, error
        monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CUDAExecutionProvider"])
        monkeypatch.setattr(onnxruntime, "InferenceSession", self.open)

    def open(self, path: str, options: object, providers: list[str]) -> object:
        session = self.real(path, options, providers=["CPUExecutionProvider"])
        if "CUDAExecutionProvider" not in providers:
            return session
        if self.while_loading:
            raise RuntimeError(self.error)
        return SimpleNamespace(get_inputs=session.get_inputs, get_outputs=session.get_outputs, run=self.fail)

    def fail(self, *given: object) -> None:
        raise RuntimeError(self.error)


@pytest.mark.parametrize("while_loading", [True, False])
def test_a_provider_that_fails_leaves_the_work_to_the_cpu(
    pair: tuple[Path, Path], photo: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, while_loading: bool
):
    Provider(monkeypatch, while_loading)
    said: list[str] = []
    sam = EfficientSam(*pair, tmp_path / "cache", threads=1, gpu=True, warn=said.append)
    truth = (photo == RED).all(-1)
    for _ in range(2):
        assert iou(sam.segment(photo, hints(truth.shape, positive=np.array([[120.0, 80]]))).mask, truth) > 0.93
    assert len(said) == 2 and all("CUDA provider failed (CUDA error 700)" in s and "CPU" in s for s in said)


def test_too_little_memory_is_called_that(sam: EfficientSam, photo: np.ndarray, monkeypatch: pytest.MonkeyPatch):
    def fail(*given: object) -> None:
        raise RuntimeError("[ONNXRuntimeError] : 6 : Failed to allocate memory for requested buffer of size 9")

    monkeypatch.setattr(sam._encoder, "_session", SimpleNamespace(run=fail))
    with pytest.raises(MemoryError):
        sam.embed(photo)
