"""Files are read as they are, whatever else they hold, or refused with what is wrong."""

import meshio
import numpy as np
import pytest

from ssmr_torch.plants.finite_element.mesh_files import read_mesh


@pytest.fixture
def write(tmp_path, arm):
    """(name, points=, further or other cells) -> path of a file with the arm in mm."""

    def make(name="arm.vtu", points=None, cells=None):
        path = tmp_path / name
        meshio.Mesh(1e3 * arm.nodes if points is None else points, cells or [("tetra", arm.tetrahedra)]).write(path)
        return path

    return make


@pytest.mark.parametrize("name", ["arm.vtu", "arm.vtk", "arm.msh"])
def test_every_format_gives_the_same_body(write, arm, name):
    found = read_mesh(write(name))
    np.testing.assert_allclose(found.nodes, arm.nodes, rtol=1e-13, atol=1e-18)
    np.testing.assert_array_equal(found.tetrahedra, arm.tetrahedra)


def test_lengths_are_in_the_unit_that_is_named(write, arm):
    for unit, metres in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)):
        found = read_mesh(str(write()), unit).nodes
        np.testing.assert_allclose(found, 1e3 * metres * arm.nodes, rtol=1e-13, atol=1e-18)


def test_points_and_triangles_beside_the_body_are_left(write, arm):
    points = np.vstack([[0.0, 0, 500], 1e3 * arm.nodes, [0.0, 0, 600]])
    cells = [("vertex", np.array([[0]])), ("triangle", np.array([[0, 1, 100]])), ("tetra", arm.tetrahedra + 1)]
    found = read_mesh(write(points=points, cells=cells))
    np.testing.assert_allclose(found.nodes, arm.nodes, rtol=1e-13, atol=1e-18)
    np.testing.assert_array_equal(found.tetrahedra, arm.tetrahedra)


def test_tetrahedra_in_several_blocks_are_one_body(write, arm):
    cells = [("tetra", arm.tetrahedra[:100]), ("tetra", arm.tetrahedra[100:])]
    np.testing.assert_array_equal(read_mesh(write(cells=cells)).tetrahedra, arm.tetrahedra)


def test_a_point_that_no_cell_uses_is_refused(write, arm):
    with pytest.raises(ValueError, match="1 of 100 nodes belong to no tetrahedron; the first is node 99"):
        read_mesh(write(points=np.vstack([1e3 * arm.nodes, [0, 0, 500]])))


@pytest.mark.parametrize("name", ["trunk", "trunk_coarse", "diamond", "diamond_coarse"])
def test_the_meshes_of_the_package_are_read_by_name(name):
    mesh = read_mesh(name)
    assert 0.15 < np.ptp(mesh.nodes, axis=0).max() < 0.25


@pytest.mark.parametrize(("name", "nodes"), [("trunk.vtk", 709), ("diamond.vtu", 1628)])
def test_the_authors_meshes_are_read(measurements, name, nodes):
    assert len(read_mesh(measurements("meshes") / name).nodes) == nodes


# refusals

def test_a_missing_file_is_refused_with_the_names_of_the_packages_own():
    with pytest.raises(FileNotFoundError, match="no mesh file at elephant; .*diamond_coarse.*trunk"):
        read_mesh("elephant")


def test_an_unknown_unit_is_refused(write):
    with pytest.raises(ValueError, match="length_unit is 'inch'; expected one of"):
        read_mesh(write(), "inch")


def test_a_file_without_tetrahedra_is_refused(write, arm):
    with pytest.raises(ValueError, match="holds \\['triangle'\\] but no linear tetrahedra"):
        read_mesh(write(cells=[("triangle", arm.surface)]))


@pytest.mark.parametrize("name", ["notes.txt", "notes.vtu", "notes.vtk", "notes.msh", "notes", "notes.stl",
                                  "notes.bdf"])
def test_a_file_that_is_no_mesh_is_refused(tmp_path, name):
    (tmp_path / name).write_text("Remember the milk.\n")
    with pytest.raises(ValueError, match="cannot be read as a mesh"):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize("name", ["arm.vtu", "arm.msh"])
def test_a_mesh_file_that_is_cut_short_is_refused(write, name):
    path = write(name)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ValueError, match="cannot be read as a mesh"):
        read_mesh(path)
