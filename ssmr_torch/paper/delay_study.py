"""What delays do to a manifold under control (paper, Fig. 3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.data.windows import SegmentDataset, delay_windows
from ssmr_torch.fitting.closed_form_fit import ExactSolve
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import Trajectory


def controlled_run(record: str | None, dataset):
    """The record of a closed loop in the dataset's outputs, or without one the longest controlled test run.

    Raises ValueError where there is neither.
    """
    if record is not None:
        found = ClosedLoopRecord.load(record)
        columns = [found.output_names.index(name) for name in dataset.output_names]
        return Trajectory(found.time, found.observation[:, columns], found.input)
    runs = dataset.select("test", "controlled")
    if not runs:
        raise ValueError("the data hold no controlled test run; give record=FILE.h5 of ssmr control")
    return max(runs, key=lambda run: run.length).read()


def reconstruction_study(decays: Sequence, run, *, delays: Sequence[int] = (4, 10, 15, 20), state_dim: int = 6,
                         degree: int = 3, control_delays: int = 1, transient: float = 0.0,
                         ridge: float = 0.0) -> list[dict]:
    """A controlled run seen through manifolds of the decays: ŷ = w(v(window)), newest sample.

    For each number of delays n_d, once with windows of n_d delays, once reparametrized to `control_delays`. Rows of
    {"delays", "reparametrized", "ratio", "error", "outputs"}: 100 ‖ŷ‖ / ‖y‖, which the paper calls reconstruction and
    which is 100 for any error that keeps the size, the error 100 ‖ŷ − y‖ / ‖y‖, %, and ŷ (K, p), m. All see the same
    last K samples of the run, those with the longest window before them.
    Raises ValueError without decays, or where a run is shorter than a window.
    """
    if not decays:
        raise ValueError("no decays; the manifold is learned from them")
    rows = []
    for count in delays:
        for reparametrized in (False, True):
            if reparametrized and count <= control_delays:
                continue
            model = SSMR(state_dim, run.input.shape[1], run.observation.shape[1],
                         control_delays if reparametrized else count, parametrization_degree=degree)
            procedure = SSMRLeastSquares(model, detection_delays=count)
            _fit_manifold(procedure, decays, transient, ridge)
            rows.append({"delays": count, "reparametrized": reparametrized} | _reconstruction(model, run, max(delays)))
    return rows


def format_reconstruction(rows: Sequence[dict]) -> str:
    """The rows as text, one line per number of delays."""
    lines = ["delays  reparametrized   ‖ŷ‖/‖y‖     error"]
    lines += [f"{row['delays']:>6}  {'yes' if row['reparametrized'] else 'no':>14}  {row['ratio']:7.1f} %  "
              f"{row['error']:7.1f} %" for row in rows]
    return "\n".join(lines)


def _fit_manifold(procedure: SSMRLeastSquares, decays: Sequence, transient: float, ridge: float) -> None:
    for stage in procedure.stages[:-1]:
        solver = ExactSolve(procedure.model.parameters(), ridge)
        for segment in SegmentDataset(decays, before=procedure.before, after=procedure.after, transient=transient):
            for name, found in procedure.regressions(segment, stage).items():
                solver.accumulate(name, found.features, found.targets)
        solver.step()
        procedure.assign(stage, solver.solutions)


@torch.no_grad()
def _reconstruction(model: SSMR, run, before: int) -> dict:
    whole = run.read().observation[before - model.delays:]
    windows = delay_windows(torch.from_numpy(np.array(whole, dtype=np.float64)), model.delays)
    measured = windows[:, -1]
    found = model.decode(model.encode(windows))
    size = torch.linalg.vector_norm(measured)
    return {"ratio": float(100 * torch.linalg.vector_norm(found) / size),
            "error": float(100 * torch.linalg.vector_norm(found - measured) / size), "outputs": found.numpy()}
