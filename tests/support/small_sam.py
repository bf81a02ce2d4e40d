# SPDX-License-Identifier: GPL-3.0-or-later
"""An ONNX pair with EfficientSAM's names, types and shapes that segments by colour.

The encoder averages the photo's colours on a 64 x 64 grid; the decoder compares each cell with the cells under the
first six prompted points and answers with three masks, from narrow to wide.
"""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = [helper.make_opsetid("", 17)]
FLOAT, INT = TensorProto.FLOAT, TensorProto.INT64


def write_pair(
    folder: Path, encoder: str = "encoder.onnx", decoder: str = "decoder.onnx", points: int | str = "N"
) -> tuple[Path, Path]:
    """Write both files; returns their paths. ``points``: how many the decoder takes, a number or a free axis."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = folder / encoder, folder / decoder
    onnx.save(_model(_encoder()), paths[0])
    onnx.save(_model(_decoder(points)), paths[1])
    return paths


def _model(graph: onnx.GraphProto) -> onnx.ModelProto:
    model = helper.make_model(graph, opset_imports=OPSET, ir_version=9)
    onnx.checker.check_model(model)
    return model


def _constant(name: str, value: object, kind: type) -> onnx.TensorProto:
    return numpy_helper.from_array(np.array(value, kind), name)


def _encoder() -> onnx.GraphProto:
    node = helper.make_node
    nodes = [
        node("Resize", ["batched_images", "", "", "full"], ["resized"], mode="linear"),
        node("AveragePool", ["resized"], ["mean"], kernel_shape=[16, 16], strides=[16, 16]),
        node("Pad", ["mean", "pads"], ["image_embeddings"]),
    ]
    constants = [
        _constant("full", [1, 3, 1024, 1024], np.int64),
        _constant("pads", [0, 0, 0, 0, 0, 253, 0, 0], np.int64),
    ]
    inputs = [helper.make_tensor_value_info("batched_images", FLOAT, [1, 3, "H", "W"])]
    outputs = [helper.make_tensor_value_info("image_embeddings", FLOAT, [1, 256, 64, 64])]
    return helper.make_graph(nodes, "encoder", inputs, outputs, constants)


def _decoder(points: int | str = "N") -> onnx.GraphProto:
    node = helper.make_node
    nodes = [
        node("Slice", ["image_embeddings", "zero", "three", "axis1"], ["rgb"]),
        node("Reshape", ["rgb", "cells"], ["colours"]),  # [3, 4096]
        node("Reshape", ["batched_point_coords", "pairs"], ["all_points"]),
        node("Slice", ["all_points", "zero", "six", "axis0"], ["points"]),  # more are silently dropped
        node("Reshape", ["batched_point_labels", "flat"], ["all_labels"]),
        node("Slice", ["all_labels", "zero", "six", "axis0"], ["labels"]),
        node("Gather", ["orig_im_size", "swap"], ["size_xy"]),
        node("Cast", ["size_xy"], ["size_float"], to=FLOAT),
        node("Div", ["points", "size_float"], ["share"]),
        node("Mul", ["share", "grid"], ["place"]),
        node("Floor", ["place"], ["floor"]),
        node("Clip", ["floor", "low", "high"], ["clipped"]),
        node("Cast", ["clipped"], ["cell"], to=INT),
        node("Mul", ["cell", "strides"], ["parts"]),
        node("ReduceSum", ["parts", "axis1"], ["index"], keepdims=0),
        node("Gather", ["colours", "index"], ["wanted"], axis=1),  # [3, N]
        node("Unsqueeze", ["colours", "axis1"], ["a"]),
        node("Unsqueeze", ["wanted", "axis2"], ["b"]),
        node("Sub", ["a", "b"], ["difference"]),
        node("Mul", ["difference", "difference"], ["square"]),
        node("ReduceSum", ["square", "axis0"], ["sum"], keepdims=0),
        node("Sqrt", ["sum"], ["distance"]),  # [N, 4096]
        node("Equal", ["labels", "one"], ["is_point"]),
        node("Not", ["is_point"], ["is_corner"]),
        node("Cast", ["is_corner"], ["corner"], to=FLOAT),
        node("Mul", ["corner", "ten"], ["penalty"]),
        node("Unsqueeze", ["penalty", "axis1"], ["penalty_column"]),
        node("Add", ["distance", "penalty_column"], ["usable"]),
        node("ReduceMin", ["usable"], ["nearest"], axes=[0], keepdims=0),
        node("Reshape", ["nearest", "map"], ["nearest_map"]),
        node("Sub", ["widths", "nearest_map"], ["margin"]),
        node("Mul", ["margin", "steep"], ["small"]),  # [1, 3, 64, 64]
        node("Concat", ["batch", "orig_im_size"], ["sizes"], axis=0),
        node("Resize", ["small", "", "", "sizes"], ["large"], mode="linear"),
        node("Unsqueeze", ["large", "axis0"], ["output_masks"]),
        node("Identity", ["quality"], ["iou_predictions"]),
        node("Unsqueeze", ["small", "axis0"], ["1234"]),  # the export's third output has a number for a name
    ]
    constants = [
        _constant("zero", [0], np.int64), _constant("three", [3], np.int64), _constant("six", [6], np.int64),
        _constant("axis0", [0], np.int64), _constant("axis1", [1], np.int64), _constant("axis2", [2], np.int64),
        _constant("cells", [3, 4096], np.int64), _constant("pairs", [-1, 2], np.int64), _constant("flat", [-1], np.int64),  # noqa: E501
        _constant("swap", [1, 0], np.int64), _constant("grid", 64, np.float32), _constant("low", 0, np.float32),
        _constant("high", 63, np.float32), _constant("strides", [1, 64], np.int64), _constant("one", 1, np.float32),
        _constant("ten", 10, np.float32), _constant("map", [1, 1, 64, 64], np.int64), _constant("steep", 40, np.float32),  # noqa: E501
        _constant("widths", np.reshape([0.08, 0.14, 0.2], (1, 3, 1, 1)), np.float32),
        _constant("batch", [1, 3], np.int64), _constant("quality", [[[0.9, 0.95, 0.85]]], np.float32),
    ]  # fmt: skip
    inputs = [
        helper.make_tensor_value_info("image_embeddings", FLOAT, [1, 256, 64, 64]),
        helper.make_tensor_value_info("batched_point_coords", FLOAT, [1, 1, points, 2]),
        helper.make_tensor_value_info("batched_point_labels", FLOAT, [1, 1, points]),
        helper.make_tensor_value_info("orig_im_size", INT, [2]),
    ]
    outputs = [
        helper.make_tensor_value_info("output_masks", FLOAT, [1, 1, 3, "H", "W"]),
        helper.make_tensor_value_info("iou_predictions", FLOAT, [1, 1, 3]),
        helper.make_tensor_value_info("1234", FLOAT, [1, 1, 3, 64, 64]),
    ]
    return helper.make_graph(nodes, "decoder", inputs, outputs, constants)
