"""Report of a closed-form fit, and warnings about what is doubtful in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from ssmr_torch.data.windows import RolloutBatch, RolloutDataset
from ssmr_torch.fitting.dimension import captured_variance
from ssmr_torch.models.torch_model import TorchModel

ILL_CONDITIONED = 1e8
STARTS_AT_ONCE = 512


@torch.no_grad()
def training_divergence(model: TorchModel, trajectories: Sequence, horizon: float = 1.0,
                        transient: float = 0.0) -> dict[str, float]:
    """Share of diverged rollouts of the training data, by kind of run. A mean error over the other rollouts hides them.

    Decays are rolled out from `transient` s to their end; other runs are cut into pieces of `horizon` s.
    """
    shares = {}
    for kind in ("decay", "controlled"):
        runs = [_without(transient, run) if kind == "decay" else run for run in trajectories if run.kind == kind]
        outcomes = [_diverged(model, starts) for starts in _batches(model, runs, kind, horizon)]
        if outcomes:
            shares[kind] = float(torch.cat(outcomes).double().mean())
    return shares


def _without(transient: float, run):
    first = round(transient / run.timestep)
    return run.part(first) if first else run


def _batches(model: TorchModel, trajectories: Sequence, kind: str, horizon: float) -> Iterator[list[RolloutBatch]]:
    batch = []
    for run in trajectories:
        sampling = max(round(model.timestep / run.timestep), 1)
        steps = (run.length - 1) // sampling - model.delays
        if steps < 1:
            continue
        if kind == "controlled":
            steps = min(steps, max(round(horizon / model.timestep), 1))
        starts = RolloutDataset([run], delays=model.delays, horizon=steps, stride=steps * sampling, sampling=sampling)
        for index in range(len(starts)):
            batch.append(starts[index])
            if len(batch) == STARTS_AT_ONCE:
                yield batch
                batch = []
    if batch:
        yield batch


def _diverged(model: TorchModel, starts: list[RolloutBatch]) -> Tensor:
    """Whether each rollout diverges within its own length. Shorter rollouts are padded with zero input."""
    lengths = torch.tensor([len(start.inputs) for start in starts])
    windows, inputs = (torch.stack([getattr(start, name) for start in starts]) for name in ("window", "window_inputs"))
    held = pad_sequence([start.inputs for start in starts], batch_first=True)
    return model.rollout(model.encode(windows, inputs), held).diverged_at <= lengths


@torch.no_grad()
def diagnose(fit, trajectories: Sequence, transient: float = 0.0) -> dict:
    """Report of a fit as plain values: regressions, singular values, eigenvalues, shares of diverged rollouts,
    warnings.
    """
    model = fit.model
    diverged = training_divergence(model, trajectories, transient=transient)
    report = {"regressions": getattr(fit, "solutions", {}), "diverged": diverged,
              "trajectories": {kind: sum(t.kind == kind for t in trajectories) for kind in ("decay", "controlled")}}
    if "dynamics" in model.tables:
        report["eigenvalues"] = [[float(value.real), float(value.imag)] for value in model.reduced.rates]
    singular = getattr(getattr(fit, "procedure", None), "singular_values", None)
    if singular is not None:
        values = singular.cpu().numpy()
        report["singular_values"] = values.tolist()
        report["captured_variance"] = float(captured_variance(values)[model.state_dim - 1])
    report["window_dim"], report["state_dim"] = model.window_dim, model.state_dim
    report["repairs"] = getattr(fit, "repairs", {})
    report["warnings"] = warnings(report, model) + getattr(fit, "remarks", [])
    report["found"], report["facts"] = getattr(fit, "found", []), getattr(fit, "facts", {})
    return report


def warnings(report: dict, model: TorchModel) -> list[str]:
    """Sentences on what is doubtful about a fit, and what to do about it."""
    found = []
    if model.tables and len(model.reduced.parametrization) == model.window_dim:
        found += _geometry_warnings(report, model)
    unstable = [value for value in report.get("eigenvalues", []) if value[0] >= 0]
    if unstable:
        found.append(f"{len(unstable)} eigenvalues of the reduced dynamics are unstable (largest real part "
                     f"{max(v[0] for v in unstable):.3g} 1/s); cut a shorter transient, use more decays, or add ridge.")
    for name, regression in report["regressions"].items():
        if regression["condition"] > ILL_CONDITIONED:
            found.append(f"The {name} regression has condition number {regression['condition']:.2g}; add ridge, lower "
                         "the degree, or record runs with more varied inputs.")
    found += [f"The stability guard repaired the fit: {what} {amount:g}." for what, amount
              in report.get("repairs", {}).items()]
    joint = "use calibration=joint, " if "drift" in report["regressions"] else ""
    for kind, share in report["diverged"].items():
        if share > 0:
            found.append(f"{100 * share:.3g} % of the {kind} training rollouts diverge; add ridge, lower the degree, "
                         f"smooth the derivative, {joint}or refine with fit=rollout.")
    return found


def _geometry_warnings(report: dict, model: TorchModel) -> list[str]:
    found = []
    if model.window_dim == model.state_dim:
        found.append(f"The window holds p = {model.window_dim} values and there are n = {model.state_dim} reduced "
                     "coordinates. The parametrization is therefore linear, and all nonlinearity is in the dynamics. "
                     "More outputs or delays allow a curved manifold.")
    decays = report["trajectories"]["decay"]
    of_state = [factors for factors in model.structure.dynamics.factors if factors[-1] < model.state_dim]
    needed = len(of_state)
    frozen = "drift" in report["regressions"]
    if decays < needed / 4 and max(map(len, of_state)) > 1 and frozen:
        found.append(f"{decays} decays are too few for {needed} coefficients per row of the reduced dynamics (degree "
                     f"{max(map(len, of_state))}); use calibration=joint, more decays, or a lower degree.")
    if decays == 0:
        found.append("No decays: the tangent space was computed from controlled runs, which leave the manifold.")
    if report.get("captured_variance", 1.0) < 0.95:
        found.append(f"The {model.state_dim} leading directions capture {100 * report['captured_variance']:.1f} % of "
                     "the variance, less than 95 %; take a larger state_dim.")
    return found
