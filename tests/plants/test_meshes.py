"""The meshes that come with the package, as they lie in their files (mm); tools/make_meshes.py makes them."""

from itertools import combinations
from pathlib import Path

import meshio
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

FOLDER = Path(__file__).resolve().parents[2] / "ssmr_torch" / "plants" / "meshes"
NODES = {"trunk": (650, 750), "trunk_coarse": (300, 470), "diamond": (1400, 1600), "diamond_coarse": (300, 600)}
VOLUME = {"trunk": 40_500, "trunk_coarse": 40_400, "diamond": 398_900, "diamond_coarse": 398_900}  # mm³
BOX = {"trunk": [(-13, -13, 0), (13, 13, 195)], "diamond": [(-97, -97, -37), (97, 97, 125.7)]}  # standing, mm
MARKED = {"trunk": [(0, 0, 195), (0, 0, 65), (0, 0, 130)],
          "diamond": [(0, 0, 125.7), (97, 0, 46), (-97, 0, 46), (0, 97, 46), (0, -97, 46)]}
QUARTER_TURN = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
MIRROR = np.diag([1, -1, 1])
STANDING = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # the diamond's file lies on its side, 35 mm too low


@pytest.fixture(params=NODES)
def name(request):
    return request.param


@pytest.fixture
def robot(name):
    return name.removesuffix("_coarse")


@pytest.fixture
def file(name):
    return meshio.read(FOLDER / f"{name}.vtu")


@pytest.fixture
def nodes(file, robot):
    """(N, 3) mm, the robot standing on its base."""
    return file.points @ STANDING.T + [0, 0, 35] if robot == "diamond" else file.points


@pytest.fixture
def tetrahedra(file):
    return file.cells_dict["tetra"].astype(int)


def volumes(nodes, tetrahedra):
    return np.linalg.det(nodes[tetrahedra[:, 1:]] - nodes[tetrahedra[:, :1]]) / 6


def numbers_after(operation, nodes):
    """Number of the node that lies where the operation takes each node; fails where there is none."""
    places = {tuple(place): number for number, place in enumerate(np.round(nodes, 3) + 0.0)}
    return np.array([places[tuple(place)] for place in np.round(nodes @ operation.T, 3) + 0.0])


def test_the_files_are_small_and_of_the_size_that_they_promise(name, nodes):
    low, high = NODES[name]
    assert low <= len(nodes) <= high
    assert (FOLDER / f"{name}.vtu").stat().st_size < 190_000


def test_the_files_hold_tetrahedra_only_and_lengths_to_a_tenth_of_a_micrometre(file):
    assert set(file.cells_dict) == {"tetra"}
    assert file.points.dtype == np.float64
    np.testing.assert_allclose(file.points, np.round(file.points, 4), rtol=0, atol=1e-12)


def test_all_volumes_are_positive_and_add_up_to_the_robot(name, nodes, tetrahedra):
    assert volumes(nodes, tetrahedra).min() > 0
    assert volumes(nodes, tetrahedra).sum() == pytest.approx(VOLUME[name], rel=2e-3)


def test_no_tetrahedron_is_nearly_flat(nodes, tetrahedra):
    corners = nodes[tetrahedra]
    lengths = sum(((corners[:, a] - corners[:, b]) ** 2).sum(axis=1) for a, b in combinations(range(4), 2))
    assert (12 * np.cbrt(3 * volumes(nodes, tetrahedra)) ** 2 / lengths).min() > 0.25  # 1 for the regular one


def test_every_node_belongs_to_some_tetrahedron(nodes, tetrahedra):
    np.testing.assert_array_equal(np.unique(tetrahedra), np.arange(len(nodes)))


def test_the_body_is_in_one_piece(nodes, tetrahedra):
    first, others = tetrahedra[:, [0, 0, 0]].ravel(), tetrahedra[:, 1:].ravel()
    pieces, _ = connected_components(coo_array((np.ones(len(first)), (first, others)), (len(nodes),) * 2))
    assert pieces == 1


def test_tetrahedra_meet_face_to_face_and_nodes_are_apart(nodes, tetrahedra):
    faces = np.sort(np.concatenate([np.delete(tetrahedra, corner, axis=1) for corner in range(4)]), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    assert count.max() == 2
    edges = np.sort(faces[count == 1][:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), "the surface is not closed"
    assert len(np.unique(np.round(nodes, 1), axis=0)) == len(nodes)


def test_they_fill_the_box_of_the_robot(robot, nodes):
    np.testing.assert_allclose([nodes.min(axis=0), nodes.max(axis=0)], BOX[robot], rtol=0, atol=1e-9)


def test_a_node_lies_on_the_tip_and_on_every_point_that_is_observed(robot, nodes):
    for point in MARKED[robot]:
        assert np.linalg.norm(nodes - point, axis=1).min() < 1e-9, point


def test_a_quarter_turn_takes_the_body_onto_itself_with_the_order_of_its_nodes(nodes, tetrahedra):
    turned = numbers_after(QUARTER_TURN, nodes)[tetrahedra]
    assert {tuple(t) for t in turned.tolist()} == {tuple(t) for t in tetrahedra.tolist()}


@pytest.mark.parametrize("name", ["diamond", "diamond_coarse"])
def test_mirrored_tetrahedra_of_the_diamond_have_the_same_edge_and_face_for_their_frame(nodes, tetrahedra):
    mirrored = numbers_after(MIRROR, nodes)[tetrahedra][:, [1, 0, 2, 3]]
    assert {tuple(t) for t in mirrored.tolist()} == {tuple(t) for t in tetrahedra.tolist()}


def test_the_clamped_boxes_hold_a_slice_of_the_base(robot, nodes):
    if robot == "trunk":
        held = nodes[(np.abs(nodes[:, :2]) <= 20).all(axis=1) & (nodes[:, 2] >= 0) & (nodes[:, 2] <= 20)]
        assert len(held) > 40 and held[:, 2].max() > 10
        return
    held = nodes[(np.abs(nodes[:, :2]) <= 15).all(axis=1) & (nodes[:, 2] >= -40) & (nodes[:, 2] <= 10)]
    assert 50 < len(held) < 0.2 * len(nodes)
    np.testing.assert_allclose([held.min(axis=0), held.max(axis=0)], [(-14, -14, -37), (14, 14, -9.6)], atol=1e-9)
