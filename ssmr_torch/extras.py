"""Which extra of pyproject.toml installs a missing package."""

from __future__ import annotations

from importlib.util import find_spec

BROUGHT_BY = {  # module → extra of pyproject.toml
    "torch": "train", "lightning": "train", "hydra": "train", "omegaconf": "train", "sklearn": "train",
    "h5py": "data", "pandas": "data", "pydantic": "data", "scipy": "data", "yaml": "data", "tqdm": "data",
    "pyarrow": "parquet", "c3d": "rigs", "rosbags": "rigs", "meshio": "plants",
    "matplotlib": "plots", "fontTools": "plots", "jinja2": "plots", "wandb": "wandb", "zmq": "wire", "daqp": "daqp",
    "qpsolvers": "qpsolvers", "onnx": "onnx", "onnxruntime": "onnx", "onnxscript": "onnx", "casadi": "casadi",
    "optuna": "search", "joblib": "parallel", "doit": "parallel", "submitit": "cluster",
    "ray": "ray", "rerun": "view", "mujoco": "robots", "elastica": "robots",
    "soromox": "robots", "jax": "robots",
}


def remedy(error: BaseException | None) -> str | None:
    """A sentence on what to install, if an error or its cause is a missing package of an extra; None for other errors.
    """
    while error is not None:
        package = str(getattr(error, "name", None)).split(".")[0]
        if isinstance(error, ModuleNotFoundError) and package in BROUGHT_BY:
            return f"{package} is not installed: pip install 'ssmr_torch[{BROUGHT_BY[package]}]'"
        error = error.__cause__
    return None


def require(package: str) -> None:
    """Raises ModuleNotFoundError with the install command unless the package is installed."""
    if find_spec(package) is None:
        missing = ModuleNotFoundError(name=package)
        raise ModuleNotFoundError(remedy(missing), name=package)
