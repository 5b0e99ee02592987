"""A plant by finite elements: a clamped elastic body that is pulled by cables."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np

from ssmr_torch.plants.base import PlantSheet, finite_vector, input_range
from ssmr_torch.plants.finite_element.cables import Cables
from ssmr_torch.plants.finite_element.equilibrium import equilibrium
from ssmr_torch.plants.finite_element.linear_solvers import linear_solver
from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh
from ssmr_torch.plants.finite_element.modes import continuous_eigenvalues, step_map_eigenvalues
from ssmr_torch.plants.finite_element.structure import Linearization, Mechanics, Structure
from ssmr_torch.plants.finite_element.time_stepping import SCHEMES, DivergenceError, State

AXES = ("x", "y", "z")
SLOWEST = 12


class FiniteElementRobot(PlantSheet):
    """A clamped elastic body of tetrahedra, pulled by cables.

    markers: name → number of a node, or a point (3,) m in the undeformed body, for which the nearest node is taken. The
    first is the tip, which carries the payload; None leaves a marker out. The observation is the displacement of the
    markers from the rest of the nominal robot (no payload, stiffness_scale 1). A loaded robot starts at its own rest,
    so that its first observation is not zero.
    input_bounds: (2,) or (2, m) N, the lowest zero or more, because cables only pull.
    scheme: "backward_euler" (the reference), "generalized_alpha" or "bdf2"; the last two need the neo-Hookean law.
    linear_solver: "block_ldl", "superlu" or "pardiso".

    state: positions of all nodes (3 N), velocities of the free degrees of freedom (n), memory of the scheme.
    clipped: number of steps since the reset with an input out of bounds.   A step that diverges (not finite, or further
    away than `FARTHEST` times the body's size) raises DivergenceError and leaves the state as it was.
    Raises ValueError for impossible markers, bounds, times or schemes.
    """

    FARTHEST = 3.0
    input_unit = "N"

    def __init__(self, name: str, mesh: TetrahedralMesh, cables: Cables, mechanics: Mechanics, clamped: np.ndarray,
                 markers: Mapping[str, int | Sequence[float]], input_names: Sequence[str], input_bounds: Sequence,
                 timestep: float, scheme: str, solver: str):
        if not (0 < timestep < np.inf):
            raise ValueError(f"timestep is {timestep} s; expected a positive time")
        if scheme not in SCHEMES:
            raise ValueError(f"scheme is {scheme!r}; expected one of {tuple(SCHEMES)}")
        if (scheme == "backward_euler") != (mechanics.law == "corotational"):
            raise ValueError(f"scheme {scheme!r} does not work with law {mechanics.law!r}: Newton's method is slow "
                             "with the corotational law, and backward_euler oscillates with the neo-Hookean one; use "
                             "backward_euler with corotational, generalized_alpha or bdf2 with neo_hookean")
        _refuse_loose(mesh, clamped)
        self.name, self.timestep = name, float(timestep)
        self.markers = {marker: _node(mesh, marker, place) for marker, place in markers.items() if place is not None}
        if not self.markers:
            raise ValueError("there are no markers; name one or more, the tip first")
        self.output_names = tuple(f"{marker}_{axis}" for marker in self.markers for axis in AXES)
        self.input_names = tuple(input_names)
        self.input_bounds = input_range(input_bounds, cables.count, "N")
        if (self.input_bounds[0] < 0).any():
            raise ValueError(f"the lowest inputs are {self.input_bounds[0].tolist()} N; expected 0 or more, because "
                             "cables only pull")
        self._nodes = np.array(list(self.markers.values()))
        tip = int(self._nodes[0])
        self.structure = Structure(mesh, cables, mechanics, clamped, tip)
        self._solver, self._scheme = linear_solver(solver, self.structure.sparsity), SCHEMES[scheme]()
        slack = self.input_bounds[0]
        self._rest = equilibrium(self.structure, slack)
        nominal = self._rest if mechanics == mechanics.nominal else equilibrium(
            Structure(mesh, cables, mechanics.nominal, clamped, tip), slack, self._rest)
        self.rest = nominal[self._nodes].ravel()
        self.clipped = 0
        self._state = self._resting(self._rest)

    @property
    def origin(self) -> dict:
        """Size and hash of the mesh from which the robot was made."""
        mesh = self.structure.mesh
        content = hashlib.sha256(mesh.nodes.tobytes() + mesh.tetrahedra.tobytes()).hexdigest()
        return {"nodes": len(mesh.nodes), "tetrahedra": len(mesh.tetrahedra), "sha256": content}

    @property
    def state(self) -> np.ndarray:
        return np.concatenate([self._state.positions.ravel(), self._state.velocities, self._state.memory.ravel()])

    @property
    def displacement(self) -> np.ndarray:
        return self._state.positions[self._nodes].ravel() - self.rest

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) m, the present positions of all nodes."""
        return self._state.positions.copy()

    @property
    def eigenvalues(self) -> np.ndarray:
        """(12,) 1/s, the slowest ones at rest: of one step, or in continuous time for schemes of second order."""
        exact = self.structure.mechanics.law == "neo_hookean"
        return (continuous_eigenvalues if exact else step_map_eigenvalues)(self, SLOWEST)

    @property
    def resting(self) -> np.ndarray:
        """(N, 3) m, the positions of all nodes at rest, with the payload."""
        return self._rest.copy()

    @property
    def surface(self) -> np.ndarray:
        """(F, 3) nodes of the triangles on the surface."""
        return self.structure.mesh.surface

    @property
    def hangs(self) -> bool:
        """Whether gravity pulls the tip away from the clamp along +z."""
        return self.structure.mechanics.gravity[2] > 0

    @property
    def undeformed(self) -> np.ndarray:
        """The state of the undeformed mesh, without motion."""
        nodes, still = self.structure.mesh.nodes, np.zeros(self.structure.sparsity.size)
        start = self._scheme.start(self.structure, nodes, still, self.input_bounds[0], self.timestep)
        return np.concatenate([start.positions.ravel(), start.velocities, start.memory.ravel()])

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state` (default: rest). `seed` has no effect, because nothing is random."""
        self._state = self._resting(self._rest) if state is None else self._unpacked(state)
        self.clipped = 0
        return self.displacement

    def step(self, input: np.ndarray) -> np.ndarray:
        """Hold the tensions (m,) N for one timestep. Values out of bounds are clipped and counted.

        Raises ValueError for a wrong size or non-finite values.
        """
        tensions = finite_vector(input, len(self.input_names), "input")
        within = np.clip(tensions, *self.input_bounds)
        with np.errstate(all="ignore"):  # an overflow is refused below
            found = self._scheme.step(self.structure, self._solver, self._state, within, self.timestep)
        self._refuse_divergence(found, within)
        self._state = found
        self.clipped += int((within != tensions).any())
        return self.displacement

    def settle(self, input: np.ndarray) -> np.ndarray:
        """Go to the static equilibrium under tensions (m,) N within the bounds; returns the observation there."""
        tensions = np.clip(finite_vector(input, len(self.input_names), "input"), *self.input_bounds)
        self._state = self._resting(equilibrium(self.structure, tensions, self._state.positions))
        return self.displacement

    def linearization(self, state: np.ndarray | None = None, input: np.ndarray | None = None) -> Linearization:
        """Mass, damping, stiffness and input matrices at a state (default: now) and tensions (default: lowest)."""
        positions = (self._state if state is None else self._unpacked(state)).positions
        tensions = self.input_bounds[0] if input is None else finite_vector(input, len(self.input_names), "input")
        if (tensions < 0).any():
            raise ValueError(f"tensions are {tensions.tolist()} N; expected 0 or more, because cables only pull")
        return self.structure.linearization(positions, tensions)

    @property
    def output_matrix(self) -> np.ndarray:
        """(p, n), from displacements of the free degrees of freedom to the observation; zero for clamped markers."""
        sparsity = self.structure.sparsity
        matrix = np.zeros((len(self.output_names), sparsity.size))
        for row, node in enumerate(self._nodes):
            if sparsity.number[node] >= 0:
                for axis in range(3):
                    matrix[3 * row + axis, 3 * sparsity.number[node] + axis] = 1.0
        return matrix

    def _resting(self, positions: np.ndarray) -> State:
        size = self.structure.sparsity.size
        return State(positions.copy(), np.zeros(size), np.zeros((self._scheme.memory_rows, size)))

    def _unpacked(self, state: np.ndarray) -> State:
        shape, size, rows = self._rest.shape, self.structure.sparsity.size, self._scheme.memory_rows
        vector = finite_vector(state, self._rest.size + (1 + rows) * size, "state")
        positions, velocities, memory = np.split(vector, [self._rest.size, self._rest.size + size])
        found = State(positions.reshape(shape), velocities, memory.reshape(rows, size))
        clamped = self.structure.sparsity.number < 0
        moved = np.abs(found.positions - self.structure.mesh.nodes)[clamped].max()
        if moved:
            raise ValueError(f"state has clamped nodes up to {moved:.3g} m away from their place; expected them at "
                             "their place: give a state that this robot returned")
        return found

    def _refuse_divergence(self, found: State, tensions: np.ndarray) -> None:
        size = self.structure.mesh.size
        farthest = np.abs(found.positions - self._rest).max()
        if not (np.isfinite(found.velocities).all() and farthest <= self.FARTHEST * size):
            raise DivergenceError(f"{self.name} diverged under the tensions {tensions.tolist()} N: a node moved "
                                  f"{farthest:.3g} m, the size of the body is {size:.3g} m. The robot keeps the state "
                                  "before this step; lower the inputs or the timestep")


def plain(value):
    """A constructor's argument as a JSON value."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    return value if isinstance(value, str) or value is None else np.asarray(value).tolist()


def _node(mesh: TetrahedralMesh, marker: str, place: int | Sequence[float]) -> int:
    if np.ndim(place) == 0:
        whole = isinstance(place, (int, np.integer)) and not isinstance(place, bool)
        if not (whole and 0 <= place < len(mesh.nodes)):
            raise ValueError(f"marker {marker!r} is {place!r}; expected a node's number from 0 to "
                             f"{len(mesh.nodes) - 1}, or a point, three numbers in m")
        return int(place)
    node = mesh.nearest_node(finite_vector(place, 3, f"marker {marker!r}"))
    away = float(np.linalg.norm(mesh.nodes[node] - np.asarray(place, dtype=np.float64)))
    if away > 0.5 * mesh.size:
        raise ValueError(f"marker {marker!r} is {away:.3g} m from the nearest node of a body of {mesh.size:.3g} m; "
                         "expected a point on the body, three numbers in m")
    return node


def _refuse_loose(mesh: TetrahedralMesh, clamped: np.ndarray) -> None:
    """Raise ValueError where too few nodes are clamped, or all in a line, so that the body can rotate."""
    offsets = mesh.nodes[clamped] - mesh.nodes[clamped].mean(axis=0)
    if np.linalg.matrix_rank(offsets, tol=1e-6 * mesh.size) < 2:
        raise ValueError(f"{len(clamped)} nodes of a body of {mesh.size:.3g} m are clamped, all in a line, so that it "
                         "can rotate; expected three or more that span a plane: check the unit of the mesh and the "
                         "position of the clamp")
