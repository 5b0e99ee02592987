"""A model as torch.export programs with a dynamic batch size, and these as ONNX graphs."""

from __future__ import annotations

import json
import logging
import warnings
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram
from torch.overrides import TorchFunctionMode

from ssmr_torch.models.base import ContinuousTimeModel, ReducedModel
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.control_augmented_tables import ControlAugmentedTables
from ssmr_torch.models.integrators import map_linearization, rk4_linearization
from ssmr_torch.models.kalman import Noise, filter_window
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.koopman_tables import KoopmanTables
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.neural_tables import NeuralTables
from ssmr_torch.models.polynomial_tables import PolynomialTables
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.models.tables import ModelTables
from ssmr_torch.models.tpwl import TPWL
from ssmr_torch.models.tpwl_tables import TPWLTables

MODELS: dict[type[ModelTables], type[ReducedModel]] = {
    PolynomialTables: SSMR, ControlAugmentedTables: ControlAugmentedSSMR, KoopmanTables: Koopman,
    NeuralTables: NeuralODE, TPWLTables: TPWL}


class Signature(NamedTuple):
    """What a function of a deployed model takes, by the names in an artifact's reference batch, and what it gives."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


SIGNATURES = {"encode": Signature(("window", "window_input"), ("z",)), "decode": Signature(("state",), ("y",)),
              "step": Signature(("state", "input"), ("next",)),
              "step_jacobians": Signature(("state", "input"), ("next", "A", "B"))}


class Encode(nn.Module):
    """(window (batch, n_d + 1, p), window_input (batch, n_d, m)) → z (batch, n)."""

    def __init__(self, model: ReducedModel):
        super().__init__()
        self.model = model

    def forward(self, window: Tensor, window_input: Tensor) -> Tensor:
        model = self.model
        if isinstance(model, TPWL):
            noise = Noise(model.mean, model.covariance, model.process, model.measurement)
            return filter_window(model, window, window_input, noise, model._window_steps, solve)
        return model.encode(window, window_input)


class Decode(nn.Module):
    """state (batch, n) → y (batch, p)."""

    def __init__(self, model: ReducedModel):
        super().__init__()
        self.model = model

    def forward(self, state: Tensor) -> Tensor:
        return self.model.decode(state)


class Step(nn.Module):
    """(state (batch, n), input (batch, m)) → next (batch, n)."""

    def __init__(self, model: ReducedModel):
        super().__init__()
        self.model = model

    def forward(self, state: Tensor, input: Tensor) -> Tensor:
        return self.model.step(state, input)


class StepJacobians(nn.Module):
    """(state (batch, n), input (batch, m)) → next (batch, n), A (batch, n, n), B (batch, n, m)."""

    def __init__(self, model: ReducedModel):
        super().__init__()
        self.model = model

    def forward(self, state: Tensor, input: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        model = self.model
        if isinstance(model, ContinuousTimeModel):
            return rk4_linearization(
                lambda x: model.rate(x, input), lambda x: (model.rate_jacobian(x, input), model.control_field(x)),
                state, model.identity, model.timestep, model.substeps)
        following, A, B = map_linearization(lambda x: model.advance_linearization(x, input), state, model.repeats)
        return following, A + 0.0, B + 0.0  # a table that is the same for the whole batch, copied


class DoubleConstants(TorchFunctionMode):
    """Numbers in arithmetic become float64 tensors: as plain numbers, the way to ONNX rounds them to float32."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if getattr(func, "__name__", "") in self.ARITHMETIC:
            args = tuple(torch.tensor(each, dtype=torch.float64) if isinstance(each, float) else each for each in args)
        return func(*args, **(kwargs or {}))

    ARITHMETIC = frozenset({"add", "sub", "mul", "div", "__radd__", "__rsub__", "__rmul__", "__rtruediv__",
                            "__add__", "__sub__", "__mul__", "__truediv__", "true_divide", "rsub"})


FUNCTIONS = {"encode": Encode, "decode": Decode, "step": Step, "step_jacobians": StepJacobians}


def solve(S: Tensor, X: Tensor) -> Tensor:
    """S⁻¹ X of positive definite S (..., p, p) and X (..., p, n) by elimination: ONNX has no solver."""
    rows = [torch.cat([S, X], dim=-1)[..., k, :] for k in range(S.shape[-1])]
    for k in range(len(rows)):
        pivot = rows[k] / rows[k][..., k:k + 1]
        rows = [pivot if i == k else row - row[..., k:k + 1] * pivot for i, row in enumerate(rows)]
    return torch.stack(rows, dim=-2)[..., S.shape[-1]:]


def torch_model(tables: ModelTables) -> ReducedModel:
    """The Torch model with these tables, fixed. Raises ValueError for a kind that has none."""
    if type(tables) not in MODELS:
        raise ValueError(f"a {type(tables).__name__} has no Torch form; those that have one are "
                         f"{', '.join(sorted(kind.__name__ for kind in MODELS))}; leave torch and onnx out of the "
                         "formats")
    model = MODELS[type(tables)].from_tables(tables).requires_grad_(False).eval()
    for module in model.modules():  # torch.export.save fails on what is registered and empty
        for kept, registered in ((tuple, module._parameters), (Tensor.detach, module._buffers)):
            for name in [name for name, table in registered.items() if not table.numel()]:
                empty = registered.pop(name)
                setattr(module, name, kept(empty))
    return model


def programs(tables: ModelTables, batch: dict[str, np.ndarray]) -> dict[str, ExportedProgram]:
    """The programs of `SIGNATURES`, float64; batch: arrays by whose shapes they are traced, any batch size serves."""
    model, size, exported = torch_model(tables), Dim("batch"), {}
    for name, (inputs, _) in SIGNATURES.items():
        arguments = {key: torch.from_numpy(batch[key]) for key in inputs}
        with _quiet(), torch.no_grad(), DoubleConstants():
            exported[name] = torch.export.export(FUNCTIONS[name](model), (), arguments,
                                                 dynamic_shapes={key: {0: size} for key in inputs}, strict=False)
        exported[name].graph.eliminate_dead_code()  # such as a walk over no hidden layers, which cannot be stored
        exported[name].graph_module.recompile()
    return exported


def save_program(program: ExportedProgram, path: Path, card: dict) -> None:
    """A .pt2 file with the artifact's card in it, for `torch.export.load(path, extra_files={"card.json": ""})`."""
    torch.export.save(program, path, extra_files={"card.json": json.dumps(card)})


def run_program(path: Path, name: str, *batches: dict[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    """What the function `name` stored in a .pt2 file makes of each batch, by the names of its outputs."""
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
    """Without what the exporters say of themselves."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx._internal.exporter._registration", "onnx_ir")]
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
