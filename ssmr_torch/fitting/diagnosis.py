"""What a closed-form fit found, and where the user should look."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ssmr_torch.data.windows import RolloutDataset, stack_rollouts
from ssmr_torch.fitting.dimension import captured_variance
from ssmr_torch.fitting.fit import rollout_errors
from ssmr_torch.models.base import ReducedModel
from ssmr_torch.models.ssmr import SSMR

ILL_CONDITIONED = 1e8


def training_divergence(model: ReducedModel, trajectories: Sequence, horizon: float = 1.0) -> dict[str, float]:
    """Share of diverged rollouts of the training data, by kind: decays over their full length, others over `horizon` s.

    Paper's protocol scores survivors only; the share says how many there were.
    """
    shares = {}
    for kind in ("decay", "controlled"):
        runs = [t for t in trajectories if t.kind == kind and t.length > model.delays + 2]
        outcomes = []
        for run in runs:
            samples = run.length - model.delays - 1
            if kind == "controlled":
                samples = min(samples, max(round(horizon / run.timestep), 1))
            starts = RolloutDataset([run], delays=model.delays, horizon=samples, stride=samples)
            outcomes.append(rollout_errors(model, stack_rollouts([starts[i] for i in range(len(starts))])).isinf())
        if outcomes:
            shares[kind] = float(torch.cat(outcomes).double().mean())
    return shares


@torch.no_grad()
def diagnose(fit, trajectories: Sequence) -> dict:
    """Report of a fitted SSMR: regressions, singular values, eigenvalues, diverged shares, and warnings, as plain values."""
    model = fit.model
    report = {"regressions": getattr(fit, "solutions", {}), "diverged": training_divergence(model, trajectories),
              "trajectories": {kind: sum(t.kind == kind for t in trajectories) for kind in ("decay", "controlled")}}
    if isinstance(model, SSMR):
        eigenvalues = torch.linalg.eigvals(model.drift_table[:, :model.state_dim])
        report["eigenvalues"] = [[float(value.real), float(value.imag)] for value in eigenvalues]
        report["window_dim"], report["state_dim"] = model.window_dim, model.state_dim
    procedure = getattr(fit, "procedure", None)
    if procedure is not None:
        values = procedure.singular_values.cpu().numpy()
        report["singular_values"] = values.tolist()
        report["captured_variance"] = float(captured_variance(values)[model.state_dim - 1])
    report["warnings"] = warnings(report, model)
    return report


def warnings(report: dict, model: ReducedModel) -> list[str]:
    """Sentences that say what is doubtful about a fit and what to do."""
    found = []
    if isinstance(model, SSMR):
        found += _geometry_warnings(report, model)
    unstable = [value for value in report.get("eigenvalues", []) if value[0] >= 0]
    if unstable:
        found.append(f"{len(unstable)} eigenvalues of the reduced dynamics are unstable (largest real part "
                     f"{max(v[0] for v in unstable):.3g} 1/s); cut a shorter transient, use more decays, or add ridge.")
    for name, regression in report["regressions"].items():
        if regression["condition"] > ILL_CONDITIONED:
            found.append(f"The {name} regression has condition {regression['condition']:.2g}; add ridge, lower the "
                         "degree, or excite the robot more widely.")
    for kind, share in report["diverged"].items():
        if share > 0:
            found.append(f"{100 * share:.3g} % of the {kind} training rollouts diverge; add ridge, lower the degree, "
                         "use calibration=joint, or refine with fit=rollout.")
    return found


def _geometry_warnings(report: dict, model: SSMR) -> list[str]:
    found = []
    if model.window_dim == model.state_dim:
        found.append(f"The window holds p = {model.window_dim} values, as many as the n = {model.state_dim} reduced "
                     "coordinates: the parametrization is linear, and all nonlinearity sits in the dynamics. "
                     "More outputs or delays give a curved manifold.")
    decays = report["trajectories"]["decay"]
    needed = len(model.drift_features)
    frozen = "drift" in report["regressions"]
    if decays < needed / 4 and model.dynamics_degree > 1 and frozen:
        found.append(f"{decays} decays for {needed} coefficients per row of the reduced dynamics: too few for degree "
                     f"{model.dynamics_degree}; use calibration=joint, more decays, or a lower degree.")
    if decays == 0:
        found.append("No decays: the tangent space was found from controlled runs, which leave the manifold.")
    if report.get("captured_variance", 1.0) < 0.95:
        found.append(f"The {model.state_dim} leading directions capture {100 * report['captured_variance']:.1f} % of "
                     "the variance, less than 95 %; take a larger state_dim.")
    return found
