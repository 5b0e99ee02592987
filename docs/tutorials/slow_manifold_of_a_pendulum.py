"""The slow manifold of a damped pendulum: computed by hand, and learned from the measured angle.

    θ̈ = −c θ̇ − (g/l) sin θ + u

python docs/tutorials/slow_manifold_of_a_pendulum.py stores the numbers of the tutorial and draws its figure.
"""

from __future__ import annotations

import logging
import tempfile
import warnings
from functools import partial
from math import factorial
from pathlib import Path

import lightning
import numpy as np
from numpy.polynomial.polynomial import polyval

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.documents.results import store_tables
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import METHODS, WIDTH, panels
from ssmr_torch.fitting.training import least_squares, train
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

FIGURES = Path(__file__).resolve().parents[1] / "figures"

# --8<-- [start:pendulum]
GRAVITY, LENGTH, DAMPING = 9.81, 0.5, 14.0  # m/s², m, 1/s
STIFFNESS = GRAVITY / LENGTH                # 1/s²
TIMESTEP = 0.01                             # s, of the measurements
SLOW, FAST = -DAMPING / 2 + np.array([1, -1]) * np.sqrt(DAMPING**2 / 4 - STIFFNESS)  # 1/s, the eigenvalues


def rate(state, torque):
    """d(θ, θ̇)/dt; torque in rad/s²."""
    angle, velocity = state[..., 0], state[..., 1]
    return np.stack([velocity, -DAMPING * velocity - STIFFNESS * np.sin(angle) + torque], axis=-1)
# --8<-- [end:pendulum]


def simulate(start, torque, timestep=TIMESTEP, substeps=5):
    """States (..., T, 2) from starts (..., 2) under held torques (T,), by Runge-Kutta steps of order four."""
    states, h = [np.asarray(start, dtype=np.float64)], timestep / substeps
    for u in torque[:-1]:
        x = states[-1]
        for _ in range(substeps):
            k1 = rate(x, u)
            k2 = rate(x + h / 2 * k1, u)
            k3 = rate(x + h / 2 * k2, u)
            k4 = rate(x + h * k3, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        states.append(x)
    return np.stack(states, axis=-2)


# --8<-- [start:taylor]
def taylor(order):
    """Coefficients a_0 … a_order of θ̇ = h(θ) = Σ a_m θᵐ, from h'(θ) h(θ) = −c h(θ) − (g/l) sin θ."""
    a = np.zeros(order + 1)
    a[1] = SLOW
    for m in range(2, order + 1):
        sine = 0.0 if m % 2 == 0 else (-1) ** (m // 2) / factorial(m)
        known = sum(k * a[k] * a[m + 1 - k] for k in range(2, m))
        a[m] = -(known + STIFFNESS * sine) / (m * SLOW - FAST)
    return a
# --8<-- [end:taylor]


def upright_branch():
    """(angles, velocities), both of the trajectory that leaves the upright position: what decays collapse on."""
    growth = -DAMPING / 2 + np.sqrt(DAMPING**2 / 4 + STIFFNESS)
    offset = 1e-6
    path = simulate([np.pi - offset, -offset * growth], np.zeros(8000), timestep=2e-3, substeps=1)[::-1]
    return np.append(0.0, path[:, 0]), np.append(0.0, path[:, 1])


# --8<-- [start:releases]
def releases(largest, pairs, duration):
    """States (2 · pairs, T, 2) of a pendulum let go at ±θ with ±θ̇, up to `largest` rad and 3 · `largest` rad/s."""
    rng = np.random.default_rng(0)
    start = largest * np.stack([np.linspace(0.3, 1, pairs), 3 * rng.uniform(-1, 1, pairs)], axis=-1)
    return simulate(np.concatenate([start, -start]), np.zeros(round(duration / TIMESTEP)))


def dataset(decays):
    """What is measured of the decays, the angle alone, and 20 s under a slow torque."""
    time = TIMESTEP * np.arange(2000)
    torque = 0.8 * np.abs(decays[..., 0]).max() * np.sin(0.9 * time) * np.sin(0.37 * time + 1)
    driven = simulate(np.zeros(2), torque)
    clock = TIMESTEP * np.arange(decays.shape[1])
    runs = [Trajectory(clock, run[:, :1], np.zeros((len(clock), 1)), "decay", name=f"release {number}")
            for number, run in enumerate(decays)]
    runs.append(Trajectory(time, driven[:, :1], torque[:, None], "controlled", name="driven"))
    return TrajectoryDataset(runs, rest=[0.0], output_names=("angle",), input_names=("torque",))
# --8<-- [end:releases]


# --8<-- [start:fit]
TRAINER = partial(lightning.Trainer, accelerator="cpu", devices=1, use_distributed_sampler=False,
                  enable_model_summary=False, enable_progress_bar=False)


def fit(data, degree, transient):
    """The tables of an SSMR with one reduced coordinate, seen through two samples of the angle."""
    with tempfile.TemporaryDirectory() as directory:
        training = train(
            data, directory=directory, trainer=TRAINER,
            model=partial(SSMR, state_dim=1, delays=1, parametrization_degree=degree, dynamics_degree=degree,
                          control_degree=0),
            fits={"closed_form": partial(least_squares, calibration="frozen", ridge=0.0)},
            module=partial(TrajectoryDataModule, transient=transient, validation_share=0))
    return training.model.reduced.numpy()
# --8<-- [end:fit]


# --8<-- [start:compare]
def learned_curve(model, largest):
    """(angles, velocities) on the learned manifold: θ = w(z), θ̇ = w'(z) R z^{1:n_r}."""
    z = np.linspace(-1.5, 1.5, 801)[:, None] * largest
    slope, _ = model.linearize_output(z)
    angle, velocity = model.decode(z)[:, 0], (slope @ model.rate(z, np.zeros((len(z), 1)))[..., None])[:, 0, 0]
    inside = np.abs(angle) <= largest
    return angle[inside], velocity[inside]


def learned_series(model):
    """a_1 and a_3 of θ̇ = h(θ), from z's own series; all even terms vanish, as the releases come in pairs ±."""
    (w1, _, w3), (r1, _, r3) = model.parametrization[-1, :3], model.dynamics[0, :3]
    return r1, (w1 * r3 + 2 * w3 * r1) / w1**3
# --8<-- [end:compare]


def collapse_rate(decays, branch):
    """Rate at which |θ̇ − h(θ)| shrinks, 1/s: slope of its logarithm between 0.2 and 0.8 s, median over decays."""
    time = TIMESTEP * np.arange(20, 80)
    distance = np.log(off_manifold(decays, branch)[:, 20:80])
    return float(np.median([np.polyfit(time, row, 1)[0] for row in distance]))


def off_manifold(decays, branch):
    angle, velocity = decays[..., 0], decays[..., 1]
    return np.abs(velocity - np.sign(angle) * np.interp(np.abs(angle), *branch))


@figures.styled
def draw(decays, branch, model, largest):
    """The collapse in the plane, the distance from the manifold over time, and the error of each curve."""
    figure, (plane, distance, error) = panels(WIDTH, 2.9, 1, 3)
    (true, line), fitted, grey = METHODS["reference"], METHODS["SSMR"][0], METHODS["persistence"][0]
    for run in decays:
        plane.plot(run[:150, 0], run[:150, 1], color=grey, linewidth=0.6)
        plane.plot(*run[0], ".", color=grey, markersize=3)
    both = np.concatenate([-branch[0][::-1], branch[0]]), np.concatenate([-branch[1][::-1], branch[1]])
    angle, velocity = learned_curve(model, largest)
    plane.plot(angle, velocity, color=fitted, linewidth=2.5, label="learned")
    plane.plot(*both, line, color=true, linewidth=1.0, label="true")
    plane.set(xlabel=r"angle $\theta$ (rad)", ylabel=r"velocity $\dot\theta$ (rad/s)", ylim=(-9, 13))
    plane.legend(loc="upper right")
    time = TIMESTEP * np.arange(130)
    distance.semilogy(time, off_manifold(decays, branch)[:, :130].T, color=grey, linewidth=0.6)
    distance.semilogy(time, 15 * np.exp(FAST * time), line, color=true, label=r"$e^{\lambda_2 t}$")
    distance.set(xlabel="time (s)", ylabel="distance in velocity (rad/s)", ylim=(1e-5, 50))
    distance.legend(loc="upper right")
    draw_errors(error, branch, angle, velocity)
    return figure


def draw_errors(axes, branch, angle, velocity):
    looks = {1: ("#999999", ":"), 3: ("#E69F00", "-"), 5: ("#D55E00", "--"), 7: ("#CC79A7", "-.")}
    grid = np.linspace(0.05, 2.0, 300)
    exact = np.interp(grid, *branch)
    for order, (colour, line) in looks.items():
        axes.semilogy(grid, np.abs(polyval(grid, taylor(order)) - exact), line, color=colour, label=f"Taylor {order}")
    axes.semilogy(grid, np.abs(np.interp(grid, angle, velocity) - exact), color=METHODS["SSMR"][0], label="learned")
    axes.set(xlabel=r"angle $\theta$ (rad)", ylabel="error of the velocity (rad/s)", ylim=(1e-5, 30))
    axes.legend(loc="upper left", fontsize=7)


def curve_errors(branch, model, largest):
    """Largest error of θ̇ over 0 to 0.5, 1 and 1.5 rad, of three Taylor polynomials and of the learned curve."""
    grid, curve = np.linspace(0.0, 1.5, 301), learned_curve(model, largest)
    exact = np.interp(grid, *branch)
    found = {f"taylor {order}": np.abs(polyval(grid, taylor(order)) - exact) for order in (1, 3, 5, 7)}
    found["learned"] = np.abs(np.interp(grid, *curve) - exact)
    return {name: {reach: float(error[grid <= reach].max()) for reach in (0.5, 1.0, 1.5)}
            for name, error in found.items()}


def main(directory=FIGURES, quick=False):
    """The numbers of the tutorial; quick: fewer releases, the same claims."""
    logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", ".*LeafSpec|.*does not have many workers|.*Checkpoint directory")
    branch, pairs = upright_branch(), 6 if quick else 12
    small, large = releases(0.5, pairs, duration=4.0), releases(2.5, pairs, duration=4.0)
    cuts = (0.0, 1.0) if quick else (0.0, 0.3, 0.6, 1.0)
    cuts = {cut: fit(dataset(small), degree=5, transient=cut) for cut in cuts}
    near = cuts[1.0]
    whole = fit(dataset(large), degree=9, transient=0.6)
    slope, cubic = learned_series(near)
    gain = near.control_field(np.zeros(1))[0, 0]
    numbers = {"slow": SLOW, "fast": FAST, "ratio": FAST / SLOW, "collapse rate": collapse_rate(small, branch),
               "taylor": taylor(7)[1::2].tolist(), "learned slow": slope, "learned cubic": cubic,
               "learned slow, large releases": float(whole.dynamics[0, 0]),
               "learned slow by transient": {cut: float(model.dynamics[0, 0]) for cut, model in cuts.items()},
               "errors": curve_errors(branch, whole, largest=2.0),
               "static gain": -float(gain * near.parametrization[-1, 0] / near.dynamics[0, 0]),
               "true static gain": 1 / STIFFNESS}
    figures.save(draw(large, branch, whole, largest=2.2), Path(directory) / "tutorial_pendulum.svg")
    return numbers


def tables(found):
    """What the page shows, by name of the store."""
    third, fifth, seventh = (f"{value:.4f}" for value in found["taylor"][1:4])
    series = [["λ₁ (1/s), releases up to 0.5 rad, degree 5", found["slow"], found["learned slow"]],
              ["λ₁ (1/s), releases up to 2.5 rad, degree 9", found["slow"], found["learned slow, large releases"]],
              ["λ₂ (1/s): how fast decays fall onto the curve", found["fast"], found["collapse rate"]],
              ["a₃, releases up to 0.5 rad", third, found["learned cubic"]], ["a₅", fifth, None], ["a₇", seventh, None],
              ["angle per torque (s²)", found["true static gain"], found["static gain"]]]
    errors = {name: {angle: float(value) for angle, value in by_angle.items()}
              for name, by_angle in found["errors"].items()}
    angles = list(next(iter(errors.values())))
    return {"tutorial_pendulum_series": (["", "by hand", "learned"], [[name, exact(one), exact(other)]
                                                                      for name, one, other in series]),
            "tutorial_pendulum_errors": (["largest error of the velocity (rad/s), up to",
                                          *(f"{angle} rad" for angle in angles)],
                                         [[name, *by_angle.values()] for name, by_angle in errors.items()]),
            "tutorial_pendulum_transient": (["cut from every start (s)", "λ₁ (1/s)"], [
                [f"{cut:g}", exact(value)] for cut, value in found["learned slow by transient"].items()])}


def exact(value):
    """Five digits, as differences are small here."""
    return f"{value:.5g}".replace("-", "−") if isinstance(value, float) else value


if __name__ == "__main__":
    store_tables(FIGURES.parents[1], tables(main()), "python docs/tutorials/slow_manifold_of_a_pendulum.py")
