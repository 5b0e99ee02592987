"""Reading meshes: the only file that knows meshio."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
OWN_MESHES = Path(__file__).resolve().parent.parent / "meshes"


def read_mesh(path: str | Path, length_unit: str = "mm") -> TetrahedralMesh:
    """The tetrahedra of a file of any format that meshio reads; other cells, and nodes that only they use, are left.

    path: a file, or the name of a mesh that comes with the package ("trunk", "trunk_coarse", "diamond", …).
    length_unit: of the file's coordinates, "m", "cm" or "mm".
    Raises FileNotFoundError; ValueError for files without tetrahedra and for what `TetrahedralMesh` refuses.
    """
    import meshio

    own = OWN_MESHES / f"{path}.vtu"
    path = own if own.is_file() else Path(path)
    if length_unit not in LENGTH_UNITS:
        raise ValueError(f"length_unit is {length_unit!r}; expected one of {tuple(LENGTH_UNITS)}")
    if not path.is_file():
        raise FileNotFoundError(f"no mesh file at {path}; the package's own are "
                                f"{sorted(file.stem for file in OWN_MESHES.glob('*.vtu'))}")
    try:
        mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio's readers raise whatever a foreign file leads them to
        raise ValueError(f"{path} cannot be read as a mesh ({error}); expected a format that meshio knows, "
                         "such as .vtu, .vtk or .msh") from error
    found = [block.data for block in mesh.cells if block.type == "tetra"]
    if not found:
        raise ValueError(f"{path} holds {sorted({block.type for block in mesh.cells})} but no linear tetrahedra "
                         "(\"tetra\"); mesh the volume")
    return TetrahedralMesh(*_used(np.asarray(mesh.points, dtype=np.float64), np.concatenate(found),
                                  [block.data for block in mesh.cells], LENGTH_UNITS[length_unit]))


def _used(points: np.ndarray, tetrahedra: np.ndarray, cells: list[np.ndarray], scale: float):
    """Drop the nodes that only vertices, lines and triangles use; an orphan of all cells stays, to be refused."""
    kept = np.union1d(tetrahedra, np.setdiff1d(np.arange(len(points)), np.concatenate([c.ravel() for c in cells])))
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    return scale * points[kept], number[tetrahedra]
