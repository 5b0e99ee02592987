"""Which extra brings a package that is not there."""

from __future__ import annotations

from importlib.util import find_spec

BROUGHT_BY = {  # module → extra of pyproject.toml
    "torch": "train", "lightning": "train", "hydra": "train", "omegaconf": "train", "sklearn": "train",
    "h5py": "data", "scipy": "data", "yaml": "data", "tqdm": "data", "meshio": "plants",
    "matplotlib": "plots", "fontTools": "plots", "jinja2": "plots", "wandb": "wandb", "zmq": "wire", "daqp": "daqp",
    "qpsolvers": "qpsolvers", "onnx": "onnx", "onnxruntime": "onnx", "onnxscript": "onnx", "casadi": "casadi",
    "optuna": "search", "joblib": "parallel", "rerun": "view", "mujoco": "robots", "elastica": "robots",
    "soromox": "robots", "jax": "robots",
}


def remedy(error: BaseException | None) -> str | None:
    """What to install when an error, or what caused it, is a package that an extra brings; None for another error."""
    while error is not None:
        package = str(getattr(error, "name", None)).split(".")[0]
        if isinstance(error, ModuleNotFoundError) and package in BROUGHT_BY:
            return f"{package} is not installed: pip install 'ssmr_torch[{BROUGHT_BY[package]}]'"
        error = error.__cause__
    return None


def require(package: str) -> None:
    """Raises ModuleNotFoundError, with what to install, unless the package is there."""
    if find_spec(package) is None:
        missing = ModuleNotFoundError(name=package)
        raise ModuleNotFoundError(remedy(missing), name=package)
