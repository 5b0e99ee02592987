"""ONNX graphs of a model: everything in float64, with the artifact's card inside, run by onnxruntime."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto

FLOATS = {TensorProto.DataType.Value(name) for name in ("FLOAT", "FLOAT16", "BFLOAT16")}


def finish(path: Path, card: dict) -> None:
    """Write the artifact's card into the metadata of a graph (key "card") and name its batch dimension.

    Raises ValueError where a float in the graph has less than 64 bits.
    """
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    narrow = narrow_floats(model)
    if narrow:
        raise ValueError(f"{path.name} holds {', '.join(narrow[:3])} with less than 64 bits. No file was replaced. "
                         "Leave onnx out of the formats, or report this as an error of the package")
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.shape.dim[0].dim_param = "batch"
    del model.graph.value_info[:]  # intermediate values, which would give the batch dimension other names
    onnx.helper.set_model_props(model, {"card": json.dumps(card)})
    onnx.save(model, path)


def narrow_floats(model: onnx.ModelProto) -> list[str]:
    """Names of inputs, outputs, tables and values of a graph that are floats of less than 64 bits."""
    graph = onnx.shape_inference.infer_shapes(model).graph
    found = [each.name for each in (*graph.input, *graph.output, *graph.value_info)
             if each.type.tensor_type.elem_type in FLOATS]
    found += [each.name for each in graph.initializer if each.data_type in FLOATS]
    for node in graph.node:
        for attribute in node.attribute:
            constant = attribute.type == onnx.AttributeProto.TENSOR and attribute.t.data_type in FLOATS
            if constant or (node.op_type == "Cast" and attribute.name == "to" and attribute.i in FLOATS):
                found.append(node.name)
    return found


def run_graph(path: Path, batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The outputs of a graph for a batch, by name. The graph takes only the entries that it needs."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    found = session.run(None, {each.name: batch[each.name] for each in session.get_inputs()})
    return dict(zip((each.name for each in session.get_outputs()), found))
