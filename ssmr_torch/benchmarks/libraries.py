"""Times and errors of kept libraries and of the product's own code, side by side.

One row for each part; docs/libraries.md draws the conclusions.
"""

from __future__ import annotations

import csv
import importlib.util
import pickle
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
from torch import nn
from torch.func import functional_call, jacrev
from torch.nn.utils import parametrizations, parametrize

from ssmr_torch.control.quadratic_program import QuadraticProgram
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.data.run_boundaries import find_seams
from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.rollout_sensitivities import coefficients, rollout_sensitivities
from ssmr_torch.fitting.scaled_adam import ScaledAdam
from ssmr_torch.fitting.streamed_least_squares import Factor, StreamedRegression, singular_values
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.recording_files.reading import read_tables
from ssmr_torch.wire.messages import Kind, Message, unpack

REPEATS = 5


def timed(function: Callable, *arguments) -> tuple[float, object]:
    """Shortest of some calls, s, and what the last one returned."""
    times, found = [], None
    for _ in range(REPEATS):
        start = perf_counter()
        found = function(*arguments)
        times.append(perf_counter() - start)
    return min(times), found


def row(part: str, ours: str, library: str, times: tuple[float, float], said: str) -> dict:
    return {"part": part, "own": ours, "library": library, "own, ms": 1e3 * times[0], "library, ms": 1e3 * times[1],
            "found": said}


def moving(seed: int, samples: int = 1000) -> np.ndarray:
    """Outputs (T, p) of the analytic trunk under random steps of its inputs, m."""
    plant, rng = SlowManifold(), np.random.default_rng(seed)
    levels = rng.uniform(*plant.input_bounds, (samples // 50 + 1, len(plant.input_names)))
    plant.reset(seed)
    return np.array([plant.step(levels[k // 50]) for k in range(samples)])


def reading(cells: int = 400_000) -> dict:
    """A CSV file by pandas, as the product reads it, and by the standard library with NumPy, as it did before."""
    table = np.random.default_rng(0).normal(size=(cells // 8, 8))

    def by_rows(path: Path) -> np.ndarray:
        with path.open(encoding="utf-8") as file:
            return np.array(list(csv.reader(file))[1:], dtype=np.float64)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        np.savetxt(path, table, delimiter=",", header="a,b,c,d,e,f,g,h", comments="", fmt="%.17g")
        slow, _ = timed(by_rows, path)
        quick, tables = timed(read_tables, path)
    wrong = np.count_nonzero(tables[0].numbers(list(tables[0].columns), path.name) != table)
    return row("CSV", "csv and NumPy", "pandas", (slow, quick), f"{cells} cells; {wrong} differ in the last bit")


def seams() -> Iterator[dict]:
    """Three runs in one file: rows at which another run begins, beside general change-point detection."""
    glued = np.concatenate([moving(seed) + [0.05 * seed] * 6 for seed in range(3)])
    own, found = timed(find_seams, glued)
    alone = find_seams(moving(7)).tolist()
    said = f"at 1000 and 2000: own {found.tolist()}, and {alone} in one run"
    if importlib.util.find_spec("ruptures") is None:
        yield row("seams", "find_seams", "not installed", (own, np.nan), said)
        return
    import ruptures

    time, places = timed(lambda: ruptures.Binseg(model="l2").fit(glued).predict(n_bkps=2)[:-1])
    penalty = np.log(1000) * moving(7).var(axis=0).sum()
    false = len(ruptures.Pelt(model="l2", jump=5).fit(moving(7)).predict(pen=penalty)) - 1
    yield row("seams", "find_seams", "ruptures", (own, time),
              f"{said}; library, told that there are two, {places}, and {false} in one run (Pelt, BIC)")


def tangent_space(steps: int = 1000, states: int = 4) -> dict:
    """Directions of most variance of windows: in closed form, and by Adam on Torch's orthogonal parametrization."""
    y = torch.from_numpy(moving(1))
    rows = torch.cat([y[k:len(y) - 7 + k] for k in range(8)], dim=1)
    factor = Factor.of(rows)
    own, (_, vectors) = timed(singular_values, factor)
    triangle = factor.triangle / torch.linalg.matrix_norm(factor.triangle)
    layer = parametrizations.orthogonal(nn.Linear(states, rows.shape[1], bias=False, dtype=torch.float64))
    optimizer = torch.optim.Adam(layer.parameters(), lr=1e-2)

    def left(directions: torch.Tensor) -> torch.Tensor:
        return 1 - (triangle @ directions).square().sum()

    start = perf_counter()
    for _ in range(steps):
        optimizer.zero_grad()
        left(layer.weight).backward()
        optimizer.step()
    ratio = float(left(layer.weight).detach() / left(vectors[:, :states]))
    return row("tangent space", "SVD", "Adam, orthogonal", (own, perf_counter() - start),
               f"library's residual {ratio:.6f} times the SVD's, which none can be below, after {steps} steps")


def scaled_adam(steps: int = 200) -> dict:
    """Adam on coefficients over their scales: as an optimizer, and as a parametrization of the module."""
    scale = torch.logspace(-3, 6, 12, dtype=torch.float64).reshape(3, 4)

    class Scaled(nn.Module):
        def forward(self, original):
            return original * scale

        def right_inverse(self, value):
            return value / scale

    def trained(build: Callable) -> torch.Tensor:
        torch.manual_seed(0)
        layer = nn.Linear(4, 3, bias=False, dtype=torch.float64)
        with torch.no_grad():
            layer.weight.mul_(scale)
        optimizer = build(layer)
        for _ in range(steps):
            optimizer.zero_grad()
            ((layer.weight / scale - 1.5) ** 4).sum().backward()
            optimizer.step()
        return layer, (layer.weight / scale).detach()

    def parametrized(layer: nn.Module) -> torch.optim.Optimizer:
        parametrize.register_parametrization(layer, "weight", Scaled())
        return torch.optim.Adam(layer.parameters(), lr=0.05)

    own, (_, one) = timed(trained, lambda layer: ScaledAdam([{"params": [layer.weight], "scale": scale}], lr=0.05))
    time, (layer, other) = timed(trained, parametrized)
    names = ", ".join(layer.state_dict())
    return row("scaled Adam", "ScaledAdam", "Torch parametrize", (own, time),
               f"coefficients differ by {float((one - other).abs().max()):.1g}; the checkpoint's key is then {names}")


def regression(rows: int = 20_000, columns: int = 40) -> dict:
    """Regression on columns that are nearly dependent: streamed triangular factors, and NumPy's normal equations."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(rows, 1)) + 1e-7 * rng.normal(size=(rows, columns))
    true = rng.normal(size=(3, columns))
    targets = features @ true.T

    def streamed() -> np.ndarray:
        found = StreamedRegression()
        for first in range(0, rows, 1000):
            batch = slice(first, first + 1000)
            found.accumulate(torch.from_numpy(features[batch]), torch.from_numpy(targets[batch]))
        return found.solve().coefficients.numpy()

    own, one = timed(streamed)
    time, other = timed(lambda: np.linalg.lstsq(features.T @ features, features.T @ targets, rcond=None)[0].T)
    errors = [np.linalg.norm(found - true) / np.linalg.norm(true) for found in (one, other)]
    return row("regression", "streamed QR", "normal equations", (own, time),
               f"errors of the coefficients {errors[0]:.2g} and {errors[1]:.2g}, of a condition of "
               f"{np.linalg.cond(features):.1g}")


def sensitivities(starts: int = 20, horizon: int = 30) -> dict:
    """Jacobian of rollouts for Levenberg-Marquardt: from the model's structure, and by torch.func."""
    torch.manual_seed(0)
    model = SSMR(4, 2, 4, 2, dynamics_degree=3, parametrization_degree=2)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.05 * torch.randn_like(table))
        model.state_scale.fill_(1.0)
    batch = RolloutBatch(*(torch.randn(starts, size, width).double() for size, width in
                           ((3, 4), (2, 2), (horizon, 2), (horizon, 4))))
    steps = tuple(range(5, horizon + 1, 5))

    class Predicted(nn.Module):
        def __init__(self):
            super().__init__()
            self.model = model

        def forward(self):
            return self.model(batch.window, batch.window_inputs, batch.inputs)[:, [step - 1 for step in steps]]

    predicted = Predicted()
    parameters = {name: value.detach() for name, value in predicted.named_parameters()}
    own, _ = timed(lambda: list(rollout_sensitivities(model, batch, steps, ("dynamics",))))
    time, _ = timed(jacrev(lambda given: functional_call(predicted, given, ())), parameters)
    size = sum(table.numel() for table in coefficients(model, ("dynamics",)))
    return row("Levenberg-Marquardt", "from the structure", "torch.func.jacrev", (own, time),
               f"{size} coefficients, {starts} rollouts of {horizon} steps")


def quadratic_program(size: int = 40, rows: int = 20) -> dict:
    """One program of a loop, warm: ProxQP's own workspace, and the same ProxQP through qpsolvers."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(size, size))
    program = QuadraticProgram(root @ root.T + np.eye(size), rng.normal(size=size), -np.ones(size), np.ones(size),
                               rng.normal(size=(rows, size)), -np.ones(rows), np.ones(rows))
    solvers = [solver_named("proxqp", size, rows), solver_named("qpsolvers:proxqp", size, rows, eps_abs=1e-9)]
    (own, one), (time, other) = (timed(lambda solver=solver: [solver.solve(program) for _ in range(20)][-1])
                                 for solver in solvers)
    return row("quadratic program", "ProxQP's workspace", "qpsolvers", (own / 20, time / 20),
               f"{size} variables, {rows} rows; solutions differ by {np.abs(one.x - other.x).max():.1g}")


def wire(count: int = 1000) -> dict:
    """A measurement to bytes and back: the wire's messages, and pickle, which runs whatever a sender puts into it."""
    message = Message(Kind.MEASUREMENT, 1, 7, 0.07, values=np.random.default_rng(0).normal(size=6))
    own, _ = timed(lambda: [unpack(message.pack()) for _ in range(count)])
    time, _ = timed(lambda: [pickle.loads(pickle.dumps(message)) for _ in range(count)])
    return row("wire", "32 bytes and doubles", "pickle", (own / count, time / count),
               f"{len(message.pack())} and {len(pickle.dumps(message))} bytes")


def rows() -> Iterator[dict]:
    """One row for each part."""
    torch.set_num_threads(1)
    yield reading()
    yield from seams()
    for measure in (tangent_space, scaled_adam, regression, sensitivities, quadratic_program, wire):
        yield measure()
