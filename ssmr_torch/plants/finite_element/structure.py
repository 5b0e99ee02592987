"""The equations of motion of an elastic body with mass, damping, gravity and cables, discretized in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array

from ssmr_torch.checked_arguments import checked
from ssmr_torch.plants.base import finite_vector
from ssmr_torch.plants.finite_element import elements
from ssmr_torch.plants.finite_element.cables import Cables
from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh
from ssmr_torch.plants.finite_element.sparsity import Sparsity
from ssmr_torch.ranges import Each, Number, OneOf

MASS_DISTRIBUTIONS = ("nodal", "volume")


@checked(young=Number(1.0, 1e13, "Pa"), poisson=Number(-0.99, 0.4999), mass=Number(1e-6, 1e6, "kg"),
         mass_damping=Number(0.0, 1e6, "1/s"), stiffness_damping=Number(0.0, 1e3, "s"),
         gravity=Each(Number(-1e3, 1e3, "m/s²"), 3, 3), law=OneOf(*elements.LAWS),
         mass_distribution=OneOf(*MASS_DISTRIBUTIONS), payload=Number(0.0, 1e4, "kg"),
         stiffness_scale=Number(1e-6, 1e6))
@dataclass(frozen=True)
class Mechanics:
    """The material of the body and its model.

    young: Pa.   poisson: 1.   mass: kg, of the whole body.   mass_damping α, 1/s, and stiffness_damping β, s: Rayleigh.
    gravity: (3,) m/s².   law: "corotational" (edge frames) or "neo_hookean".
    mass_distribution: "nodal" gives all nodes the same share, also clamped ones; "volume" gives each node of a
    tetrahedron a quarter of its mass.   payload: kg, at the tip.   stiffness_scale: factor of the modulus, for a robot
    that differs a little from the modelled one.
    Raises ValueError for values out of range.
    """

    young: float
    poisson: float
    mass: float
    mass_damping: float
    stiffness_damping: float
    gravity: tuple[float, float, float]
    law: str = "corotational"
    mass_distribution: str = "nodal"
    payload: float = 0.0
    stiffness_scale: float = 1.0

    def __post_init__(self):
        object.__setattr__(self, "gravity", tuple(finite_vector(self.gravity, 3, "gravity (m/s²)").tolist()))
        elements.lame_parameters(self.young * self.stiffness_scale, self.poisson)
        if not (0 < self.mass < np.inf and 0 <= self.payload < np.inf):
            raise ValueError(f"mass is {self.mass} kg and payload {self.payload} kg; expected a positive mass and "
                             "a payload of 0 or more")
        if not (0 <= self.mass_damping < np.inf and 0 <= self.stiffness_damping < np.inf):
            raise ValueError(f"mass_damping is {self.mass_damping} 1/s and stiffness_damping "
                             f"{self.stiffness_damping} s; expected 0 or more")
        if self.law not in elements.LAWS:
            raise ValueError(f"law is {self.law!r}; expected one of {tuple(elements.LAWS)}")
        if self.mass_distribution not in MASS_DISTRIBUTIONS:
            raise ValueError(f"mass_distribution is {self.mass_distribution!r}; expected one of {MASS_DISTRIBUTIONS}")

    def changed(self, values: Mapping) -> Mechanics:
        """The same with some values changed by name. Raises ValueError for an unknown name."""
        known = [field.name for field in fields(self)]
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise ValueError(f"unknown {unknown}; expected some of {known}")
        return replace(self, **values)

    @property
    def nominal(self) -> Mechanics:
        """The same with no payload and stiffness_scale 1."""
        return replace(self, payload=0.0, stiffness_scale=1.0)


@dataclass(frozen=True, eq=False)
class Linearization:
    """M δq̈ + D δq̇ + K δq = H δu + r about a configuration; n free degrees of freedom, x, y, z of `free_nodes`.

    mass: (n,) kg, diagonal.   damping: α M + β K_w, (n, n) kg/s.   stiffness: (n, n) N/m, exact, with the tensions.
    input_matrix: (n, m).   residual: r (n,) N, the remaining force without damping.
    """

    mass: np.ndarray
    damping: csc_array
    stiffness: csc_array
    input_matrix: np.ndarray
    residual: np.ndarray
    free_nodes: np.ndarray


class Structure:
    """M q̈ + C(q) q̇ + f(q) = M g + H(q) u on the free degrees of freedom, C = α M + β K_w(q).

    K_w is the warped stiffness R K_e Rᵀ for every law, because an exact hyperelastic tangent would make a hanging body
    overdamped.   clamped: numbers of the nodes that do not move.   tip: the node that carries the payload.
    positions: (N, 3) m of all nodes.   Vectors (n,) hold the free degrees of freedom in the order of `sparsity`.
    """

    def __init__(self, mesh: TetrahedralMesh, cables: Cables, mechanics: Mechanics, clamped: np.ndarray, tip: int):
        self.mesh, self.cables, self.mechanics = mesh, cables, mechanics
        self.law = elements.LAWS[mechanics.law]
        exact = mechanics.law == "neo_hookean"
        groups = [mesh.tetrahedra, cables.stretches] if exact else [mesh.tetrahedra]
        self.sparsity = Sparsity(len(mesh.nodes), groups, clamped)
        self._places = self.sparsity.places(mesh.tetrahedra)
        self._cable_places = self.sparsity.places(cables.stretches) if exact else None
        self._gradients, self._volumes = mesh.shape_gradients, mesh.volumes
        self._rest_frames = elements.rest_frames(mesh.nodes, mesh.tetrahedra)
        self._lame = elements.lame_parameters(mechanics.young * mechanics.stiffness_scale, mechanics.poisson)
        self.nodal_mass = _nodal_mass(mesh, mechanics)
        self.nodal_mass[tip] += mechanics.payload
        self.mass = np.repeat(self.nodal_mass[self.sparsity.order], 3)
        self._weight = self.nodal_mass[:, None] * np.asarray(mechanics.gravity, dtype=np.float64)

    @property
    def weight(self) -> float:
        """‖M g‖ of the free nodes, N; tolerances are relative to it."""
        return float(np.linalg.norm(self._weight[self.sparsity.order]))

    @property
    def rounding(self) -> float:
        """The rounding error of forces in balance, N: about 10⁻¹⁵ E size²."""
        return 1e-15 * self.mechanics.young * self.mechanics.stiffness_scale * self.mesh.size ** 2

    def forces(self, positions: np.ndarray, tensions: np.ndarray, stiffness: np.ndarray | None = None) -> np.ndarray:
        """M g + H(q) u − f(q), (n,) N. Adds the law's tangent, and −∂(H u)/∂q for an exact law, to `stiffness`."""
        internal = np.zeros_like(positions)
        data = np.empty(0) if stiffness is None else stiffness
        self._assemble(self.law, positions, internal, data)
        force = self._weight - internal
        self.cables.add_force(positions, tensions, force)
        if stiffness is not None and self._cable_places is not None:
            self.cables.add_stiffness(positions, tensions, *self._cable_places, stiffness)
        return self.sparsity.gather(force)

    def internal_force(self, positions: np.ndarray) -> np.ndarray:
        """f(q) on all nodes, (N, 3) N."""
        internal = np.zeros_like(positions)
        self._assemble(self.law, positions, internal, np.empty(0))
        return internal

    def warped_stiffness(self, positions: np.ndarray) -> np.ndarray:
        """Entries of K_w(q), N/m."""
        data = self.zeros()
        self._assemble(elements.COROTATIONAL, positions, np.zeros_like(positions), data)
        return data

    def energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """Kinetic, elastic (neo-Hookean law only) and gravitational, J. velocities: (n,) m/s."""
        if self.law != elements.NEO_HOOKEAN:
            raise ValueError("the corotational law has no energy; use the neo_hookean law")
        deformation = np.einsum("eai,eaj->eij", positions[self.mesh.tetrahedra], self._gradients)
        lame, shear = self._lame
        logarithm = np.log(np.linalg.det(deformation))
        density = shear / 2 * ((deformation ** 2).sum(axis=(1, 2)) - 3) - shear * logarithm + lame / 2 * logarithm ** 2
        return float(0.5 * (self.mass * velocities ** 2).sum() + (self._volumes * density).sum()
                     - (self._weight * positions).sum())

    def zeros(self) -> np.ndarray:
        """The entries of a zero matrix."""
        return np.zeros(len(self.sparsity.indices))

    def tangent(self, positions: np.ndarray, tensions: np.ndarray) -> csc_array:
        """∂(f(q) − H(q) u)/∂q, (n, n) N/m, exact: with the cables; unsymmetric for the corotational law."""
        sparsity, places, cable_places = self._coupled
        data = np.zeros(len(sparsity.indices))
        self._assemble(self.law, positions, np.zeros_like(positions), data, places)
        if self.law == elements.COROTATIONAL:
            elements.add_frame_stiffness(positions, self.mesh.tetrahedra, self._gradients, self._volumes,
                                         self._rest_frames, *self._lame, *places, data)
        self.cables.add_stiffness(positions, tensions, *cable_places, data)
        return sparsity.matrix(data)

    def linearization(self, positions: np.ndarray, tensions: np.ndarray) -> Linearization:
        """The matrices at these positions and tensions."""
        damping = self.mechanics.stiffness_damping * self.warped_stiffness(positions)
        damping[self.sparsity.diagonal] += self.mechanics.mass_damping * self.mass
        inputs = self.cables.input_matrix(positions)[self.sparsity.order].reshape(self.sparsity.size, -1)
        return Linearization(self.mass.copy(), self.sparsity.matrix(damping), self.tangent(positions, tensions), inputs,
                             self.forces(positions, tensions), self.sparsity.order.copy())

    @cached_property
    def _coupled(self) -> tuple[Sparsity, tuple, tuple]:
        """The pattern with the coupling by cables, in the same order, and the places of tetrahedra and stretches."""
        if self._cable_places is not None:
            return self.sparsity, self._places, self._cable_places
        sparsity = Sparsity(len(self.mesh.nodes), [self.mesh.tetrahedra, self.cables.stretches],
                            np.flatnonzero(self.sparsity.number < 0), self.sparsity.order)
        return sparsity, sparsity.places(self.mesh.tetrahedra), sparsity.places(self.cables.stretches)

    def _assemble(self, law: int, positions: np.ndarray, force: np.ndarray, data: np.ndarray,
                  places: tuple | None = None) -> None:
        elements.assemble(law, positions, self.mesh.tetrahedra, self._gradients, self._volumes, self._rest_frames,
                          *self._lame, force, *(places or self._places), data)


def _nodal_mass(mesh: TetrahedralMesh, mechanics: Mechanics) -> np.ndarray:
    if mechanics.mass_distribution == "nodal":
        return np.full(len(mesh.nodes), mechanics.mass / len(mesh.nodes))
    volumes = np.bincount(mesh.tetrahedra.ravel(), np.repeat(mesh.volumes / 4, 4), len(mesh.nodes))
    return mechanics.mass * volumes / volumes.sum()
