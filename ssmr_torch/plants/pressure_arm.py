"""A planar arm of two bellows. Their pressure follows the command with a lag."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.compiled_functions import compiled
from ssmr_torch.plants.base import input_range
from ssmr_torch.plants.flat_state import FlatStatePlant
from ssmr_torch.quantities import INPUT_BOUNDS, TIMESTEP
from ssmr_torch.ranges import Number, Whole

GRAVITY = 9.81                       # m/s²
BELLOWS = 2
LINKS = 4                            # rigid links per arc that carry its mass
OUTPUTS = ("tip_x", "tip_y", "middle_x", "middle_y")
INPUTS = ("proximal_difference", "distal_difference")


@compiled()
def _acceleration(q, v, pressure, shape, inertia, weight, stiffness, hardening, damping, drag, gain):
    """q̈ of the arcs, rad/s²; see the equation in `PressureArm`."""
    angle, rate = shape @ q, shape @ v
    size = len(angle)
    mass, force = np.empty((size, size)), np.empty(size)
    for i in range(size):
        force[i] = -weight[i] * np.sin(angle[i])
        for j in range(size):
            mass[i, j] = inertia[i, j] * np.cos(angle[i] - angle[j])
            force[i] -= inertia[i, j] * np.sin(angle[i] - angle[j]) * rate[j] * rate[j]
    moment = shape.T @ force - stiffness * q * (1 + hardening * q * q) - damping * v + gain @ pressure
    if not np.isfinite(moment).all():
        return np.full(len(q), np.nan)
    return np.linalg.solve(shape.T @ mass @ shape, moment) - drag * v


@compiled()
def _flow(state, u, h, substeps, lag, constants):
    """Runge-Kutta of order four for the arcs; the pressure, which is linear and independent, is exact."""
    n = (len(state) - len(u)) // 2
    q, v, p = state[:n].copy(), state[n:2 * n].copy(), state[2 * n:].copy()
    for _ in range(substeps):
        middle, end = p, p
        if lag > 0:
            middle, end = u + (p - u) * np.exp(-0.5 * h / lag), u + (p - u) * np.exp(-h / lag)
        else:
            p, middle, end = u, u, u
        a1 = _acceleration(q, v, p, *constants)
        v2 = v + 0.5 * h * a1
        a2 = _acceleration(q + 0.5 * h * v, v2, middle, *constants)
        v3 = v + 0.5 * h * a2
        a3 = _acceleration(q + 0.5 * h * v2, v3, middle, *constants)
        v4 = v + h * a3
        a4 = _acceleration(q + h * v3, v4, end, *constants)
        q, v = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        p = end
    return np.concatenate((q, v, p))


class PressureArm(FlatStatePlant):
    """Two bellows of silicone in a row that hang and bend in a vertical plane, each by a difference of pressures.

        τ ṗ = u − p,
        M(q) (q̈ + α q̇) + h(q, q̇) + ∂V/∂q + K (q + β q³) + C q̇ = B p.

    q: (2 arcs,) rad, bending of each arc of constant curvature. M, h and V are those of a chain of rigid links on the
    arcs, four per arc. p: (2,) Pa, pressure differences in the chambers, which act as moments. They follow the command
    u late, because valves and tubes of a metre and more settle within tenths of a second.

    arcs: per bellows.   length: m, of the arm.   line_density: kg/m, silicone of 1,070 kg/m³ in a tube of 30 mm, a
    third of it hollow.   bending_stiffness EI: N m², with 0.3 MPa.   hardening β: 1/rad², of bellows that close.
    material_damping: s, C is K times this (Kelvin-Voigt).   drag α: 1/s, of tubes and air.
    lever: m³, change of a chamber's volume per radian: its area of 150 mm² times 7 mm to the middle line.
    pressure_lag τ: s, 0 for none.   timestep: s, of a camera at 50 Hz.
    substeps: of Runge-Kutta; the fastest bending mode decays within 0.1 ms.   input_bounds: Pa, signed.
    state: (4 arcs + 2,), q, q̇, p.   Outputs: tip and middle, x sideways and y up, from the base.
    The noise of the camera belongs to the rig: rig=camera.

    >>> PressureArm()
    PressureArm 'pressure arm': 2 inputs, 4 outputs
    ├─ sampling time: 0.02 s (50 Hz)
    ├─ outputs: tip_x, tip_y, middle_x, middle_y; displacement from rest, m
    ├─ inputs
    │  ├─ proximal_difference: -6e+04 … 6e+04 Pa
    │  └─ distal_difference: -6e+04 … 6e+04 Pa
    └─ rest: 0, -240, 0, -120 mm
    """

    name, input_unit = "pressure arm", "Pa"
    output_names, input_names = OUTPUTS, INPUTS

    @checked(arcs=Whole(1, 20), length=Number(1e-4, 100.0, "m"), line_density=Number(1e-4, 1e4, "kg/m"),
             bending_stiffness=Number(1e-8, 1e6, "N m²"), hardening=Number(0.0, 1e6),
             material_damping=Number(0.0, 1e3, "s"), drag=Number(0.0, 1e6), lever=Number(1e-12, 1.0, "m³"),
             pressure_lag=Number(0.0, 100.0, "s"), timestep=TIMESTEP, input_bounds=INPUT_BOUNDS,
             substeps=Whole(1, 10_000), gravity=Number(-1e3, 1e3, "m/s²"))
    def __init__(self, *, arcs: int = 2, length: float = 0.24, line_density: float = 0.5,
                 bending_stiffness: float = 0.0134, hardening: float = 1.0, material_damping: float = 0.03,
                 drag: float = 1.5, lever: float = 1.05e-6, pressure_lag: float = 0.08, timestep: float = 0.02,
                 substeps: int = 100, input_bounds: Sequence = (-6e4, 6e4), gravity: float = GRAVITY):
        if not (min(length, line_density, bending_stiffness, lever, timestep) > 0 and min(arcs, substeps) >= 1
                and min(hardening, material_damping, drag, pressure_lag) >= 0):
            raise ValueError(f"arcs {arcs}, length {length} m, line_density {line_density} kg/m, bending_stiffness "
                             f"{bending_stiffness} N m², lever {lever} m³, timestep {timestep} s and substeps "
                             f"{substeps} must be positive, hardening {hardening}, material_damping "
                             f"{material_damping} s, drag {drag} 1/s and pressure_lag {pressure_lag} s 0 or more")
        self.timestep, self.substeps = float(timestep), int(substeps)
        self.input_bounds = input_range(input_bounds, BELLOWS, self.input_unit)
        self.parameters = {"arcs": arcs, "length": length, "line_density": line_density,
                           "bending_stiffness": bending_stiffness, "hardening": hardening,
                           "material_damping": material_damping, "drag": drag, "lever": lever,
                           "pressure_lag": pressure_lag, "timestep": timestep, "substeps": substeps,
                           "input_bounds": self.input_bounds.tolist(), "gravity": gravity}
        pieces = BELLOWS * arcs
        self.link_length = length / (pieces * LINKS)
        self._shape = _shape(pieces)
        inertia, weight = _chain(pieces * LINKS, self.link_length, line_density * self.link_length, gravity)
        stiffness = np.full(pieces, bending_stiffness * pieces / length)
        gain = np.repeat(np.eye(BELLOWS), arcs, axis=0) * lever
        self._lag = float(pressure_lag)
        self._constants = (self._shape, inertia, weight, stiffness, float(hardening),
                           material_damping * stiffness, float(drag), gain)
        self._settle(np.zeros(2 * pieces + BELLOWS))

    @property
    def pressure(self) -> np.ndarray:
        """(2,) Pa, the present pressure differences in the chambers."""
        return self._state[-BELLOWS:].copy()

    def energy(self) -> float:
        """Kinetic, gravitational and elastic energy, J, zero at rest; without pressure it never grows."""
        q, v = np.split(self._state[:-BELLOWS], 2)
        shape, inertia, weight, stiffness, hardening, *_ = self._constants
        angle, rate = shape @ q, shape @ v
        kinetic = 0.5 * rate @ (inertia * np.cos(angle[:, None] - angle)) @ rate
        return float(kinetic + weight @ (1 - np.cos(angle)) + stiffness @ (q ** 2 / 2 + hardening * q ** 4 / 4))

    def _flow(self, state: np.ndarray, u: np.ndarray, substeps: int) -> np.ndarray:
        return _flow(state, u, self.timestep / self.substeps, substeps, self._lag, self._constants)

    def _observe(self, state: np.ndarray) -> np.ndarray:
        angle = self._shape @ np.split(state[:-BELLOWS], 2)[0]
        places = self.link_length * np.cumsum(np.stack([np.sin(angle), -np.cos(angle)], axis=1), axis=0)
        return np.concatenate([places[-1], places[len(angle) // 2 - 1]])


def _shape(pieces: int) -> np.ndarray:
    """(links, arcs): angle of every link from the vertical per bending of each arc; a link sits at its arc's middle."""
    within = (np.arange(LINKS) + 0.5) / LINKS
    blocks = [[np.ones(LINKS) if arc < row else within if arc == row else np.zeros(LINKS) for arc in range(pieces)]
              for row in range(pieces)]
    return np.concatenate([np.stack(row, axis=1) for row in blocks])


def _chain(count: int, length: float, mass: float, gravity: float) -> tuple[np.ndarray, np.ndarray]:
    """A chain of rigid hinged links with absolute angles θ: T = ½ Σ a_ij cos(θ_i − θ_j) θ̇_i θ̇_j, V = −Σ g_i cos θ_i.

    Returns a (count, count) kg m² and g (count,) N m.
    """
    after = count - 1 - np.arange(count)
    inertia = mass * length ** 2 * (np.minimum(after[:, None], after) + 0.5 * (1 - np.eye(count)) + np.eye(count) / 3)
    return inertia, gravity * mass * length * (after + 0.5)
