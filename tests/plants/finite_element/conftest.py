"""A square arm of silicone with four cables, meshed with numpy alone, and bodies and robots made of it."""

from itertools import permutations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from ssmr_torch.plants.finite_element.cables import Cables
from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh
from ssmr_torch.plants.finite_element.robot import FiniteElementRobot
from ssmr_torch.plants.finite_element.structure import Mechanics, Structure

WIDTH, LENGTH = 0.020, 0.100  # m
# It bends by 15 mm/N; its first mode swings at 4 Hz and decays by a third in a period.
SILICONE = {"young": 60e3, "poisson": 0.45, "mass": 0.04, "mass_damping": 1.0, "stiffness_damping": 0.01,
            "gravity": (0.0, 0.0, -9.81)}
NAMES = ("+x", "+y", "-x", "-y")
SIDES = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


def split_box(cells, size):
    """A box from (−w/2, −d/2, 0) to (w/2, d/2, h), each of its cells split into six tetrahedra along a diagonal.

    Neighbours in x and in y are mirrored, so that a mesh with even counts is its own mirror image. Tetrahedra that
    would be inverted have their nodes 0 and 1 swapped.
    """
    counts = np.array(cells) + 1
    nodes, corners = _lattice(counts), _lattice(cells)
    mirrored = corners % 2 * [1, 1, 0]
    tetrahedra = []
    for axes in permutations(range(3)):
        units = np.eye(3, dtype=int)[list(axes)]
        path = np.abs(np.vstack([[0, 0, 0], np.cumsum(units, axis=0)]) - mirrored[:, None])
        numbers = np.ravel_multi_index(tuple(np.moveaxis(corners[:, None] + path, -1, 0)), counts)
        inverted = np.linalg.det(units) * (-1) ** mirrored.sum(axis=1) < 0
        numbers[inverted] = numbers[inverted][:, [1, 0, 2, 3]]
        tetrahedra.append(numbers)
    return TetrahedralMesh((nodes / cells - [0.5, 0.5, 0.0]) * size, np.concatenate(tetrahedra))


def _lattice(counts):
    return np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)


def _cables(mesh):
    """Four cables 8 mm off the axis, from 10 mm below the base to the tip."""
    sides = 0.008 * SIDES
    heights = np.linspace(0.01, LENGTH, 7)
    return Cables(mesh, np.column_stack([sides, np.full(4, -0.01)]),
                  [np.column_stack([np.tile(side, (7, 1)), heights]) for side in sides])


def _base(mesh):
    return np.flatnonzero(mesh.nodes[:, 2] == 0)


@pytest.fixture(scope="module", autouse=True)
def one_blas_thread():
    """The dense references of these tests are small: threads would wait for each other."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def box():
    """(cells, size) -> mesh of a box."""
    return split_box


@pytest.fixture(scope="session")
def arm(box):
    """99 nodes; symmetric about the planes x = 0 and y = 0."""
    return box((2, 2, 10), (WIDTH, WIDTH, LENGTH))


@pytest.fixture(scope="session")
def cables():
    """(mesh) -> the four cables, embedded in any mesh of the arm."""
    return _cables


@pytest.fixture(scope="session")
def body(arm):
    """(law, mesh=, clamped=, changes of the material by name) -> Structure, clamped at its base."""

    def make(law="neo_hookean", mesh=arm, clamped=None, **changes):
        mechanics = Mechanics(**{**SILICONE, "law": law, **changes})
        return Structure(mesh, _cables(mesh), mechanics, _base(mesh) if clamped is None else np.array(clamped, int),
                         mesh.nearest_node((0.0, 0.0, LENGTH)))

    return make


@pytest.fixture(scope="session")
def robot(arm):
    """(scheme, options, changes of the material by name) -> the arm as a robot; its markers are tip and middle."""

    def make(scheme="backward_euler", mesh=arm, timestep=0.01, linear_solver="block_ldl", input_bounds=(0.0, 2.0),
             **changes):
        law = "corotational" if scheme == "backward_euler" else "neo_hookean"
        return FiniteElementRobot("arm", mesh, _cables(mesh), Mechanics(**{**SILICONE, "law": law, **changes}),
                                  _base(mesh), {"tip": (0.0, 0.0, LENGTH), "middle": (0.0, 0.0, LENGTH / 2)}, NAMES,
                                  input_bounds, timestep, scheme, linear_solver)

    return make


@pytest.fixture(scope="session")
def deform():
    """(nodes, seed=) -> the arm bent by half a radian, twisted by a quarter, and shaken by 0.3 mm."""

    def bent_and_twisted(nodes, seed=0):
        x, y, z = nodes.T
        twist, bend = 0.25 * z / LENGTH, 0.5 * z / LENGTH
        x, y = x * np.cos(twist) - y * np.sin(twist), x * np.sin(twist) + y * np.cos(twist)
        radius = LENGTH / 0.5
        turned = np.column_stack([radius - (radius - x) * np.cos(bend), y, (radius - x) * np.sin(bend)])
        return turned + np.random.default_rng(seed).uniform(-3e-4, 3e-4, nodes.shape)

    return bent_and_twisted
