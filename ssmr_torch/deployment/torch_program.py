"""A model as torch.export programs with any batch size, and these programs as ONNX graphs."""

from __future__ import annotations

import json
import logging
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram
from torch.overrides import TorchFunctionMode

from ssmr_torch.deployment.reference_batch import SIGNATURES, Signature
from ssmr_torch.models.base import Model
from ssmr_torch.models.torch_model import FixedModel, TorchModel


class Encode(nn.Module):
    """(window (batch, n_d + 1, p), window_input (batch, n_d, m)) → z (batch, n)."""

    def __init__(self, model: TorchModel):
        super().__init__()
        self.model = model

    def forward(self, window: Tensor, window_input: Tensor) -> Tensor:
        return self.model.encode(window, window_input)


class Decode(nn.Module):
    """state (batch, n) → y (batch, p)."""

    def __init__(self, model: TorchModel):
        super().__init__()
        self.model = model

    def forward(self, state: Tensor) -> Tensor:
        return self.model.decode(state)


class Step(nn.Module):
    """(state (batch, n), input (batch, m)) → next (batch, n)."""

    def __init__(self, model: TorchModel):
        super().__init__()
        self.model = model

    def forward(self, state: Tensor, input: Tensor) -> Tensor:
        return self.model.step(state, input)


class StepJacobians(nn.Module):
    """(state (batch, n), input (batch, m)) → next (batch, n), A (batch, n, n), B (batch, n, m)."""

    def __init__(self, model: TorchModel):
        super().__init__()
        self.model = model

    def forward(self, state: Tensor, input: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        following, A, B = self.model.reduced.step_jacobians(state, input)
        return following, A + 0.0, B + 0.0  # copied: a table may be the same for the whole batch


class DoubleConstants(TorchFunctionMode):
    """Turns numbers in arithmetic into float64 tensors. The ONNX exporter would round plain numbers to float32."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if getattr(func, "__name__", "") in self.ARITHMETIC:
            args = tuple(torch.tensor(each, dtype=torch.float64) if isinstance(each, float) else each for each in args)
        return func(*args, **(kwargs or {}))

    ARITHMETIC = frozenset({"add", "sub", "mul", "div", "__radd__", "__rsub__", "__rmul__", "__rtruediv__",
                            "__add__", "__sub__", "__mul__", "__truediv__", "true_divide", "rsub"})


FUNCTIONS = {"encode": Encode, "decode": Decode, "step": Step, "step_jacobians": StepJacobians}


def programs(model: Model, batch: dict[str, np.ndarray]) -> dict[str, ExportedProgram]:
    """The programs of `SIGNATURES`, float64. batch: arrays with the shapes for tracing; the size does not matter."""
    module, size, exported = FixedModel(model).eval(), Dim("batch"), {}
    for name, (inputs, _) in SIGNATURES.items():
        arguments = {key: torch.from_numpy(batch[key]) for key in inputs}
        with _quiet(), torch.no_grad(), DoubleConstants():
            exported[name] = torch.export.export(FUNCTIONS[name](module), (), arguments,
                                                 dynamic_shapes={key: {0: size} for key in inputs}, strict=False)
        exported[name].graph.eliminate_dead_code()  # for example a loop over no hidden layers, which cannot be stored
        exported[name].graph_module.recompile()
    return exported


def save_program(program: ExportedProgram, path: Path, card: dict) -> None:
    """A .pt2 file with the artifact's card in it, for `torch.export.load(path, extra_files={"card.json": ""})`."""
    torch.export.save(program, path, extra_files={"card.json": json.dumps(card)})


def run_program(path: Path, name: str, *batches: dict[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    """The outputs of the function `name` in a .pt2 file for each batch, by name."""
    function = torch.export.load(path).module()
    return [_run(function, SIGNATURES[name], batch) for batch in batches]


def _run(function: nn.Module, signature: Signature, batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    found = function(**{key: torch.from_numpy(batch[key]) for key in signature.inputs})
    return dict(zip(signature.outputs, (part.numpy() for part in (found if isinstance(found, tuple) else (found,)))))


def save_onnx(program: ExportedProgram, path: Path, name: str) -> None:
    """The program of the function `name` as an ONNX graph; needs onnx and onnxscript."""
    with _quiet():
        torch.onnx.export(program, (), path, dynamo=True, input_names=list(SIGNATURES[name].inputs),
                          output_names=list(SIGNATURES[name].outputs), external_data=False, verbose=False)


@contextmanager
def _quiet():
    """Suppress the messages of the exporters."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx._internal.exporter._registration", "onnx_ir",
                                                       "onnxscript")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels):
            logger.setLevel(level)
