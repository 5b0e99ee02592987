"""Writes deployable forms of an artifact: each is checked against the model, then moved into the folder `deployed`.

    c       NAME.c, NAME.h                                  C99, from the model's arrays alone
            NAME_controller.c, NAME_controller.h            only with a designed controller: its observer and actuators
    torch   encode.pt2, decode.pt2, step.pt2, step_jacobians.pt2     torch.export programs
    onnx    the same four as .onnx                          ONNX graphs, needs the extra `onnx`
    casadi  NAME_encode.casadi, and the other three likewise         casadi.Function, needs the extra `casadi`
"""

from __future__ import annotations

import importlib.util
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.artifact import Artifact
from ssmr_torch.deployment.c.c_text import identifier
from ssmr_torch.deployment.c.compiled_library import FLAGS, CLibrary, compile_library, compiler
from ssmr_torch.deployment.c.model_source import write_c
from ssmr_torch.deployment.reference_batch import Sought, check, expected, horizon_inputs

FORMATS = ("c", "torch", "onnx", "casadi")
MODULES = {"c": (), "torch": ("torch",), "onnx": ("torch", "onnx", "onnxruntime", "onnxscript"),
           "casadi": ("casadi",)}

EXTRAS = {"torch": "train"}  # the extra that installs a format's packages, where it is not named like the format


CONTROLLER_TOLERANCE = 1e-12  # relative, over 200 samples of observer and actuators


class Form(NamedTuple):
    """A format, its files, and the largest relative difference from the model; None where it could not be checked."""

    format: str
    files: tuple[str, ...]
    error: float | None

    def __str__(self) -> str:
        checked = ("NOT CHECKED: no C compiler was found (cc, gcc, clang, or the program in the variable CC)"
                   if self.error is None else f"equal to the model within {self.error:.1e} relative")
        return f"{self.format}: {', '.join(self.files)}: {checked}"


def deploy(directory: str | Path, formats: Sequence[str]) -> list[Form]:
    """Write these formats of the artifact in a directory into its folder `deployed`. Other formats there are kept.

    Each format is run on the artifact's reference batch and must agree with the model within 1e-12 relative, or within
    ten times the model's own rounding where that is more (see `expected`). Files are replaced only after all formats
    agree. Raises ValueError where one does not agree (with both numbers), for an unknown format, for a format whose
    packages are missing, and where `artifact.load` does.
    """
    formats = list(dict.fromkeys(formats))
    _refuse_unavailable(formats)
    directory, forms = Path(directory), []
    loaded, batch = artifact.load(directory), artifact.reference(directory)

    def write(copy: Path) -> None:
        with tempfile.TemporaryDirectory(dir=copy.parent) as aside:
            forms.extend(WRITERS[name](loaded, batch, Path(aside)) for name in formats)
            (copy / artifact.DEPLOYED).mkdir(exist_ok=True)
            for path in sorted(Path(aside).iterdir()):
                os.replace(path, copy / artifact.DEPLOYED / path.name)

    artifact.add_files(directory, write)
    return forms


def _refuse_unavailable(formats: Sequence[str]) -> None:
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise ValueError(f"unknown format {unknown[0]!r}; expected some of {', '.join(FORMATS)}, such as "
                         "formats=[c,torch]")
    for name in formats:
        missing = [module for module in MODULES[name] if importlib.util.find_spec(module) is None]
        if missing:
            raise ValueError(f"the format {name} needs {', '.join(missing)}: pip install "
                             f"'ssmr_torch[{EXTRAS.get(name, name)}]', or leave {name} out of the formats")


def _write_c(loaded: Artifact, batch: dict[str, np.ndarray], aside: Path) -> Form:
    name, source, header = write_c(loaded.model, loaded.card)
    (aside / f"{name}.c").write_text(source, encoding="utf-8")
    (aside / f"{name}.h").write_text(header, encoding="utf-8")
    files, steering = [f"{name}.c", f"{name}.h"], _write_c_controller(loaded, aside)
    if steering is not None:
        files += [f"{name}_controller.c", f"{name}_controller.h"]
    if compiler() is None:
        return Form("c", tuple(files), None)
    with tempfile.TemporaryDirectory() as build:
        compile_library(aside / f"{name}.c", Path(build) / f"{name}.so")
        library = CLibrary(Path(build) / f"{name}.so", name, loaded.model)
        error = check_c(library, loaded.model, batch)
        if steering is not None:
            error = max(error, check_c_controller(steering, aside, Path(build)))
        return Form("c", tuple(files), error)


def _write_c_controller(loaded: Artifact, aside: Path):
    """C text of the observer and actuators of the artifact's controller; None where it has no controller."""
    if loaded.designed is None:
        return None
    from ssmr_torch.deployment.c.controller import write_controller  # needs Numba, which a model alone does not

    steering = write_controller(loaded.model, loaded.card, loaded.designed)
    if steering is not None:
        (aside / f"{steering.name}_controller.c").write_text(steering.source, encoding="utf-8")
        (aside / f"{steering.name}_controller.h").write_text(steering.header, encoding="utf-8")
    return steering


def check_c_controller(steering, aside: Path, build: Path) -> float:
    """Compare the compiled observer and actuators with the Python ones; returns the largest relative difference.

    Raises ValueError, with both numbers, where it exceeds the tolerance.
    """
    import ctypes

    from ssmr_torch.deployment.c.controller_library import CompiledController, differences

    compile_library(aside / f"{steering.name}.c", build / "controller.so", FLAGS,
                    aside / f"{steering.name}_controller.c")
    found = differences(CompiledController(ctypes.CDLL(str(build / "controller.so")), steering), steering)
    for what, error in zip(("the observer", "the actuators"), found):
        if not error <= CONTROLLER_TOLERANCE:
            raise ValueError(f"c: {what} differs from the controller's by {error:.3g} relative; at most "
                             f"{CONTROLLER_TOLERANCE:g} is allowed. No file was replaced. Leave c out of the formats, "
                             "or report this as an error of the package")
    return max(found)


def check_c(library: CLibrary, model, batch: dict[str, np.ndarray]) -> float:
    """Compare every function of a compiled model with the model; returns the largest relative difference."""
    z, u, sought = batch["state"], batch["input"], expected(model, batch)
    y, C = library.decode_jacobian(z)
    following, A, B = library.step_jacobians(z, u)
    found = dict(zip(("horizon states", "horizon A", "horizon B", "horizon outputs", "horizon C"),
                     library.horizon(*horizon_inputs(model, batch))))
    found |= {"encode": library.encode(batch["window"], batch["window_input"]), "decode": library.decode(z),
              "step": library.step(z, u), "A": A, "B": B, "C": C}
    return check("c", [*((name, found[name], sought[name]) for name in found),
                       ("decode_jacobian", y, sought["decode"]), ("step_jacobians", following, sought["step"])])


def _write_torch(loaded: Artifact, batch: dict[str, np.ndarray], aside: Path) -> Form:
    from ssmr_torch.deployment.torch_program import programs, run_program, save_program

    comparisons, sought = [], _by_output(loaded, batch)
    for name, program in programs(loaded.model, batch).items():
        save_program(program, aside / f"{name}.pt2", loaded.card)
        comparisons += [(f"{name}: {output}", value, sought[name, output])
                        for output, value in run_program(aside / f"{name}.pt2", name, batch)[0].items()]
    return Form("torch", tuple(sorted(path.name for path in aside.glob("*.pt2"))), check("torch", comparisons))


def _write_onnx(loaded: Artifact, batch: dict[str, np.ndarray], aside: Path) -> Form:
    from ssmr_torch.deployment.onnx_program import finish, run_graph
    from ssmr_torch.deployment.torch_program import programs, save_onnx

    comparisons, sought = [], _by_output(loaded, batch)
    for name, program in programs(loaded.model, batch).items():
        save_onnx(program, aside / f"{name}.onnx", name)
        finish(aside / f"{name}.onnx", loaded.card)
        comparisons += [(f"{name}: {output}", value, sought[name, output])
                        for output, value in run_graph(aside / f"{name}.onnx", batch).items()]
    return Form("onnx", tuple(sorted(path.name for path in aside.glob("*.onnx"))), check("onnx", comparisons))


def _write_casadi(loaded: Artifact, batch: dict[str, np.ndarray], aside: Path) -> Form:
    from ssmr_torch.deployment.casadi_program import casadi_functions, run_function, save_function

    comparisons, sought, prefix = [], _by_output(loaded, batch), identifier(loaded.card["name"])
    for name, function in casadi_functions(loaded.model).items():
        path = aside / f"{prefix}_{name}.casadi"
        save_function(function, path)
        comparisons += [(f"{name}: {output}", value, sought[name, output])
                        for output, value in run_function(path, batch).items()]
    return Form("casadi", tuple(sorted(path.name for path in aside.glob("*.casadi"))), check("casadi", comparisons))


def _by_output(loaded: Artifact, batch: dict[str, np.ndarray]) -> dict[tuple[str, str], Sought]:
    sought = expected(loaded.model, batch)
    return {("encode", "z"): sought["encode"], ("decode", "y"): sought["decode"], ("step", "next"): sought["step"],
            ("step_jacobians", "next"): sought["step"], ("step_jacobians", "A"): sought["A"],
            ("step_jacobians", "B"): sought["B"]}


WRITERS = {"c": _write_c, "torch": _write_torch, "onnx": _write_onnx, "casadi": _write_casadi}
