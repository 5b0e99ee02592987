"""An analytic soft robot whose spectral submanifold is known in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.compiled_functions import compiled
from ssmr_torch.plants.base import PlantSheet, finite_vector, input_range
from ssmr_torch.quantities import INPUT_BOUNDS, TIMESTEP
from ssmr_torch.ranges import Number, OneOf, Whole

SLOW_DIM, FAST_DIM, CABLES = 6, 4, 4

STIFFNESS = np.array([90.0, 110.0, 170.0])      # 1/s², of the bending shapes q1, q2 and the elongation q3
DAMPING = np.array([2.4, 2.8, 4.4])             # 1/s
HARDENING, AXIAL_HARDENING = 32.0, 20.0         # 1/s²
SHORTENING, ASYMMETRY = 26.0, 7.0               # 1/s², bending coupled with elongation, q1 with q2
CABLE_BENDING, CABLE_COMPRESSION = 100.0, 34.0  # 1/(N s²)
CABLE_STIFFENING, LEVER_ARM = 14.0, 24.0        # 1/(N s²), the control field's dependence on the shape
FAST_RATES = np.array([45.3, 61.1, 83.7, 110.9])  # 1/s
SAG_LAG = 0.02                                  # s, how much the manifold depends on the velocity

# Displacement of the two markers (tip x, y, z, mid-body x, y, z) per unit of q and of η, m.
SHAPE_OUTPUT = 1e-3 * np.array([[21.0, 0.8, 0.5],
                                [-0.6, 21.0, 0.3],
                                [0.4, -0.7, 14.0],
                                [6.0, -1.1, 0.2],
                                [1.3, 5.6, -0.4],
                                [0.3, 0.2, 7.5]])
FAST_OUTPUT = 1e-3 * np.array([[0.1, -0.9, 0.0, 0.3],
                               [-0.1, 0.0, -0.9, 0.4],
                               [-2.4, 0.1, -0.1, 0.0],
                               [0.1, 0.5, 0.1, 0.4],
                               [0.0, -0.1, 0.5, -0.3],
                               [-0.8, 0.0, 0.1, 0.2]])
FAST_INPUT = np.array([[0.06, 0.06, 0.06, 0.06],  # 1/N, offset of η from the manifold at rest, per cable force
                       [0.15, -0.15, 0.0, 0.0],
                       [0.0, 0.0, 0.15, -0.15],
                       [0.08, 0.08, -0.08, -0.08]])
MARKER_REST = np.array([0.0, 0.0, 0.20, 0.0, 0.0, 0.10])  # m, base at the origin
LENGTH = 0.02                                   # m per unit of q, when the whole state is observed
MARKER_NAMES = ("tip_x", "tip_y", "tip_z", "mid_x", "mid_y", "mid_z")
STATE_NAMES = ("q1", "q2", "q3", "v1", "v2", "v3", "eta1", "eta2", "eta3", "eta4")


@compiled()
def _elastic(q1, q2, q3):
    """-∇V(q), with V as in `SlowManifold.energy`."""
    bending = q1 * q1 + q2 * q2
    isotropic = 2 * SHORTENING * q3 + HARDENING * bending
    return (-(STIFFNESS[0] + isotropic) * q1 - ASYMMETRY * (q1 * q1 - q2 * q2),
            -(STIFFNESS[1] + isotropic) * q2 + 2 * ASYMMETRY * q1 * q2,
            -STIFFNESS[2] * q3 - SHORTENING * bending - AXIAL_HARDENING * q3 ** 3)


@compiled()
def _tension(q1, q2, q3, u1, u2, u3, u4):
    """Generalized force of the cables at +x, -x, +y, -y: linear in u, affine in q."""
    arm = CABLE_BENDING + LEVER_ARM * q3
    return ((u1 - u2) * arm - CABLE_STIFFENING * (u1 + u2) * q1,
            (u3 - u4) * arm - CABLE_STIFFENING * (u3 + u4) * q2,
            LEVER_ARM * ((u1 - u2) * q1 + (u3 - u4) * q2) - CABLE_COMPRESSION * (u1 + u2 + u3 + u4))


@compiled()
def _slow_rate(xi, u, rate):
    elastic = _elastic(xi[0], xi[1], xi[2])
    tension = _tension(xi[0], xi[1], xi[2], u[0], u[1], u[2], u[3])
    for i in range(3):
        rate[i] = xi[3 + i]
        rate[3 + i] = elastic[i] - DAMPING[i] * xi[3 + i] + tension[i]


@compiled()
def _slow_flow(xi, u, duration, substeps):
    """Classical Runge-Kutta of order four over rows of slow states (N, 6), inputs (N, 4) held."""
    h = duration / substeps
    xi = xi.copy()
    k1, k2, k3, k4 = np.empty(SLOW_DIM), np.empty(SLOW_DIM), np.empty(SLOW_DIM), np.empty(SLOW_DIM)
    for row in range(len(xi)):
        for _ in range(substeps):
            x = xi[row]
            _slow_rate(x, u[row], k1)
            _slow_rate(x + 0.5 * h * k1, u[row], k2)
            _slow_rate(x + 0.5 * h * k2, u[row], k3)
            _slow_rate(x + h * k3, u[row], k4)
            xi[row] = x + (h / 6) * (k1 + 2 * k2 + 2 * k3 + k4)
    return xi


class SlowManifold(PlantSheet):
    """A cable-driven trunk: slow state ξ = (q, v) ∈ R⁶, fast modes η ∈ R⁴ that relax to a known manifold.

        q̇ = v,   v̇ = -∇V(q) - D v + T(q) u,              so ξ̇ = f(ξ) + b(ξ) u, b affine in ξ,
        η̇ = Dh(ξ) ξ̇ - Λ (η - h(ξ)) + Λ E u,
        y = C_q q + C_η η.

    V is a quartic potential, D and Λ are diagonal and positive, u ≥ 0 are the forces of four antagonistic
    V is a quartic potential, D and Λ are diagonal and positive, u ≥ 0 are the forces in N of four antagonistic cables.
    q and η are dimensionless (q = 1 moves the tip by about 21 mm); h has degrees 2 and 3. Hence the graph η = h(ξ) is
    invariant for u = 0, is tangent to the slow eigenspace (h(0) = 0, Dh(0) = 0), attracts at the rates Λ, and carries
    exactly the ξ-equations. The slow spectrum is -D/2 ± i √(K - D²/4), the fast one -Λ. No non-negative integer
    combination of slow eigenvalues equals a fast one. The imaginary parts are rationally independent, so only the real
    combinations -(m₁D₁ + m₂D₂ + m₃D₃) could; these are multiples of 0.4 1/s, and no default rate is such a multiple.
    The graph is thus the unique smoothest spectral submanifold (paper, "Spectral Submanifold theory"). For u ≠ 0,
    η - h(ξ) relaxes to E u, the error of the autonomous manifold under load.
    With u held, η - h(ξ) is integrated exactly, and ξ by `substeps` Runge-Kutta steps of order four.

    observe: "markers" gives the tip and a marker in the middle, p = 6; "state" gives 0.02 m times q, v / 10 s⁻¹
    and η / 10, p = 10, in which manifold, drift and control field are polynomials of degree 3 at most.
    input_bounds: lowest and highest force in N, (2,) or (2, 4).
    fast_rate_scale multiplies Λ, fast_input_gain multiplies E.
    state: (10,), ξ then η.
    Raises ValueError for wrong bounds, for times or rates that are not positive, and for an unknown `observe`.

    >>> SlowManifold()
    SlowManifold 'slow manifold': 4 inputs, 6 outputs
    ├─ sampling time: 0.01 s (100 Hz)
    ├─ outputs: tip_x, tip_y, tip_z, mid_x, mid_y, mid_z; displacement from rest, m
    ├─ inputs
    │  ├─ cable_+x: 0 … 1.5 N
    │  ├─ cable_-x: 0 … 1.5 N
    │  ├─ cable_+y: 0 … 1.5 N
    │  └─ cable_-y: 0 … 1.5 N
    └─ rest: 0, 0, 200, 0, 0, 100 mm
    """

    name = "slow manifold"
    input_unit = "N"
    input_names = ("cable_+x", "cable_-x", "cable_+y", "cable_-y")

    @checked(observe=OneOf("markers", "state"), timestep=TIMESTEP, input_bounds=INPUT_BOUNDS,
             fast_rate_scale=Number(1e-3, 1e4), fast_input_gain=Number(-1e4, 1e4), substeps=Whole(1, 10_000))
    def __init__(self, observe: str = "markers", timestep: float = 0.01, input_bounds: Sequence = (0.0, 1.5),
                 fast_rate_scale: float = 1.0, fast_input_gain: float = 1.0, substeps: int = 8):
        if observe not in ("markers", "state"):
            raise ValueError(f"observe is {observe!r}; expected 'markers' or 'state'")
        if not (timestep > 0 and fast_rate_scale > 0 and substeps >= 1):
            raise ValueError(f"timestep {timestep} s, fast_rate_scale {fast_rate_scale} and "
                             f"substeps {substeps} must be positive")
        self.observe, self.timestep, self.substeps = observe, float(timestep), int(substeps)
        self.fast_rate_scale, self.fast_input_gain = float(fast_rate_scale), float(fast_input_gain)
        self.input_bounds = input_range(input_bounds, CABLES, self.input_unit)
        self.output_names = MARKER_NAMES if observe == "markers" else STATE_NAMES
        self.output_matrix = _output_matrix(observe)
        self.rest = MARKER_REST.copy() if observe == "markers" else np.zeros(len(STATE_NAMES))
        self.fast_rates = self.fast_rate_scale * FAST_RATES
        self.fast_offset = self.fast_input_gain * FAST_INPUT
        self._relaxation = np.exp(-self.fast_rates * self.timestep)
        self._state = np.zeros(SLOW_DIM + FAST_DIM)

    @property
    def parameters(self) -> dict:
        """The constructor's arguments, as plain values."""
        return {"observe": self.observe, "timestep": self.timestep,
                "input_bounds": self.input_bounds.tolist(), "fast_rate_scale": self.fast_rate_scale,
                "fast_input_gain": self.fast_input_gain, "substeps": self.substeps}

    @property
    def state(self) -> np.ndarray:
        return self._state.copy()

    @property
    def displacement(self) -> np.ndarray:
        return self.output_matrix @ self._state

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state` (default: rest). `seed` has no effect, because nothing is random."""
        size = SLOW_DIM + FAST_DIM
        self._state = np.zeros(size) if state is None else finite_vector(state, size, "state")
        return self.displacement

    def step(self, input: np.ndarray) -> np.ndarray:
        """Hold the forces (4,) for one timestep, clipped to the bounds. Raises ValueError for a wrong size."""
        u = np.clip(finite_vector(input, CABLES, "input"), *self.input_bounds)
        xi, eta = self._state[:SLOW_DIM], self._state[SLOW_DIM:]
        offset = self.fast_offset @ u
        deviation = offset + self._relaxation * (eta - self.manifold(xi) - offset)
        xi = _slow_flow(xi[None], u[None], self.timestep, self.substeps)[0]
        self._state = np.concatenate([xi, self.manifold(xi) + deviation])
        return self.displacement

    def rate(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The full vector field that `step` integrates, (..., 10), (..., 4) → (..., 10)."""
        xi, eta = state[..., :SLOW_DIM], state[..., SLOW_DIM:]
        xi_rate = self.slow_rate(xi, u)
        relaxation = self.fast_rates * (u @ self.fast_offset.T - (eta - self.manifold(xi)))
        return np.concatenate([xi_rate, _apply(self.manifold_jacobian(xi), xi_rate) + relaxation], axis=-1)

    def reduced_drift(self, xi: np.ndarray) -> np.ndarray:
        """f(ξ) on the manifold, (..., 6) → (..., 6), 1/s and 1/s²."""
        q, v = xi[..., :3], xi[..., 3:]
        elastic = np.stack(_elastic.py_func(*_components(q)), axis=-1)
        return np.concatenate([v, elastic - DAMPING * v], axis=-1)

    def reduced_control_field(self, xi: np.ndarray) -> np.ndarray:
        """b(ξ) on the manifold, (..., 6) → (..., 6, 4), 1/(N s²)."""
        q = _components(xi[..., :3])
        columns = [np.stack([*np.zeros_like(q), *_tension.py_func(*q, *unit)], axis=-1)
                   for unit in np.eye(CABLES)]
        return np.stack(columns, axis=-1)

    def slow_rate(self, xi: np.ndarray, u: np.ndarray) -> np.ndarray:
        """ξ̇ = f(ξ) + b(ξ) u, (..., 6)."""
        return self.reduced_drift(xi) + _apply(self.reduced_control_field(xi), u)

    def manifold(self, xi: np.ndarray) -> np.ndarray:
        """h(ξ): (..., 6) → (..., 4): sag, shortening by the two bendings, and their coupling."""
        q1, q2, q3, v1, v2, _ = _components(xi)
        bending = q1 * q1 + q2 * q2
        return np.stack([bending + SAG_LAG * (q1 * v1 + q2 * v2), q1 * (bending + q3), q2 * (bending + q3),
                         q1 * q2 + 0.5 * q3 * q3], axis=-1)

    def manifold_jacobian(self, xi: np.ndarray) -> np.ndarray:
        """Dh(ξ): (..., 6) → (..., 4, 6)."""
        q1, q2, q3, v1, v2, _ = _components(xi)
        jacobian = np.zeros(xi.shape[:-1] + (FAST_DIM, SLOW_DIM))
        jacobian[..., 0, 0], jacobian[..., 0, 1] = 2 * q1 + SAG_LAG * v1, 2 * q2 + SAG_LAG * v2
        jacobian[..., 0, 3], jacobian[..., 0, 4] = SAG_LAG * q1, SAG_LAG * q2
        jacobian[..., 1, 0], jacobian[..., 2, 1] = 3 * q1 * q1 + q2 * q2 + q3, q1 * q1 + 3 * q2 * q2 + q3
        jacobian[..., 1, 1] = jacobian[..., 2, 0] = 2 * q1 * q2
        jacobian[..., 1, 2], jacobian[..., 2, 2] = q1, q2
        jacobian[..., 3, 0], jacobian[..., 3, 1], jacobian[..., 3, 2] = q2, q1, q3
        return jacobian

    def on_manifold(self, xi: np.ndarray) -> np.ndarray:
        """The full state (ξ, h(ξ)), (..., 6) → (..., 10)."""
        return np.concatenate([xi, self.manifold(xi)], axis=-1)

    def energy(self, xi: np.ndarray, u: np.ndarray | float = 0.0) -> np.ndarray:
        """½|v|² + V(q) - Σ uᵢ σᵢ(q), 1/s², σᵢ the shortening of cable i; its rate is -vᵀ D v for held u.

        V = ½ qᵀ K q + α (q₁² + q₂²) q₃ + β (q₁³/3 - q₁ q₂²) + ¼ γ (q₁² + q₂²)² + ¼ γ₃ q₃⁴,
        σᵢ = (a + c q₃) pᵢ - ½ d pᵢ² - e q₃ with p = (q₁, -q₁, q₂, -q₂).
        """
        q1, q2, q3, *velocity = _components(xi)
        bending = q1 * q1 + q2 * q2
        potential = (0.5 * (xi[..., :3] ** 2 @ STIFFNESS) + SHORTENING * bending * q3
                     + ASYMMETRY * (q1 ** 3 / 3 - q1 * q2 * q2)
                     + 0.25 * HARDENING * bending ** 2 + 0.25 * AXIAL_HARDENING * q3 ** 4)
        towards = np.stack([q1, -q1, q2, -q2], axis=-1)
        shortening = ((CABLE_BENDING + LEVER_ARM * q3)[..., None] * towards
                      - 0.5 * CABLE_STIFFENING * towards ** 2 - CABLE_COMPRESSION * q3[..., None])
        return 0.5 * sum(v * v for v in velocity) + potential - (shortening * u).sum(axis=-1)

    @property
    def eigenvalues(self) -> np.ndarray:
        """(10,) of the linearization at rest, 1/s: three slow conjugate pairs, then the fast ones."""
        frequency = np.sqrt(STIFFNESS - DAMPING ** 2 / 4)
        pairs = np.stack([-DAMPING / 2 + 1j * frequency, -DAMPING / 2 - 1j * frequency], axis=-1)
        return np.concatenate([pairs.reshape(-1), -self.fast_rates])

    def flow(self, xi: np.ndarray, duration: float, u: np.ndarray | float = 0.0) -> np.ndarray:
        """Slow state `duration` s later (earlier if negative) with u held: (..., 6) → (..., 6)."""
        xi = np.asarray(xi, dtype=np.float64)
        inputs = np.broadcast_to(np.float64(u), xi.shape[:-1] + (CABLES,)).reshape(-1, CABLES)
        substeps = max(1, int(np.ceil(self.substeps * abs(duration) / self.timestep - 1e-9)))
        return _slow_flow(xi.reshape(-1, SLOW_DIM), inputs, float(duration), substeps).reshape(xi.shape)

    def observe_slow(self, xi: np.ndarray) -> np.ndarray:
        """y on the manifold, (..., 6) → (..., p), m."""
        return self.on_manifold(xi) @ self.output_matrix.T

    def observe_slow_rate(self, xi: np.ndarray, u: np.ndarray | float = 0.0) -> np.ndarray:
        """dy/dt along the manifold, (..., 6) → (..., p), m/s."""
        xi_rate = self.slow_rate(xi, np.broadcast_to(u, xi.shape[:-1] + (CABLES,)))
        state_rate = np.concatenate([xi_rate, _apply(self.manifold_jacobian(xi), xi_rate)], axis=-1)
        return state_rate @ self.output_matrix.T

    def window(self, xi: np.ndarray, delays: int) -> np.ndarray:
        """The delay window that ends in ξ, with u = 0: (..., 6) → (..., delays + 1, p), oldest sample first."""
        return self.observe_slow(self._history(xi, delays))

    def window_rate(self, xi: np.ndarray, delays: int) -> np.ndarray:
        """d/dt of `window` without input: ż = Vᵀ window_rate for any linear chart z = Vᵀ window."""
        return self.observe_slow_rate(self._history(xi, delays))

    def _history(self, xi: np.ndarray, delays: int) -> np.ndarray:
        return np.stack([self.flow(xi, -k * self.timestep) for k in range(delays, -1, -1)], axis=-2)


def _components(vectors: np.ndarray) -> np.ndarray:
    return np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0)


def _apply(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]


def _output_matrix(observe: str) -> np.ndarray:
    if observe == "state":
        return LENGTH * np.diag([1.0] * 3 + [0.1] * (3 + FAST_DIM))
    return np.concatenate([SHAPE_OUTPUT, np.zeros((len(SHAPE_OUTPUT), 3)), FAST_OUTPUT], axis=-1)
