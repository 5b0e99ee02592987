"""Reads meshes from files. No other file imports meshio."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
OWN_MESHES = Path(__file__).resolve().parent.parent / "meshes"


def read_mesh(path: str | Path, length_unit: str = "mm") -> TetrahedralMesh:
    """The tetrahedra of a mesh file in any format of meshio. Other cells, and nodes that only they use, are left out.

    path: a file, or the name of a mesh of this package ("trunk", "trunk_coarse", "diamond", …).
    length_unit: of the file's coordinates, "m", "cm" or "mm".
    Raises FileNotFoundError, and ValueError for files without tetrahedra and where `TetrahedralMesh` does.
    """
    import meshio

    own = OWN_MESHES / f"{path}.vtu"
    path = own if own.is_file() else Path(path)
    if length_unit not in LENGTH_UNITS:
        raise ValueError(f"length_unit is {length_unit!r}; expected one of {tuple(LENGTH_UNITS)}")
    if not path.is_file():
        raise FileNotFoundError(f"no mesh file at {path}; give a file, or one of the package's meshes: "
                                f"{sorted(file.stem for file in OWN_MESHES.glob('*.vtu'))}")
    try:
        mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio's readers may raise anything for a wrong file
        raise ValueError(f"{path} cannot be read as a mesh ({error}); expected a format of meshio, "
                         "such as .vtu, .vtk or .msh") from error
    found = [block.data for block in mesh.cells if block.type == "tetra"]
    if not found:
        raise ValueError(f"{path} holds {sorted({block.type for block in mesh.cells})} but no linear tetrahedra "
                         "(\"tetra\"); mesh the volume of the body")
    return TetrahedralMesh(*_used(np.asarray(mesh.points, dtype=np.float64), np.concatenate(found),
                                  [block.data for block in mesh.cells], LENGTH_UNITS[length_unit]))


def _used(points: np.ndarray, tetrahedra: np.ndarray, cells: list[np.ndarray], scale: float):
    """Leave out nodes that only vertices, lines and triangles use. Nodes that no cell uses stay and are refused later.
    """
    kept = np.union1d(tetrahedra, np.setdiff1d(np.arange(len(points)), np.concatenate([c.ravel() for c in cells])))
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    return scale * points[kept], number[tetrahedra]
