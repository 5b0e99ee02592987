"""Checks of the constructors that training receives, and a model built with the sizes of the data."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Signature, signature

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.fitting.dimension import choose_dimension
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.trajectory import TrajectoryDataset


def check_call(what: str, build: Callable, *arguments: str, **keywords: object) -> None:
    """Raises ValueError unless `build` can be called with these positional arguments and keywords and nothing else.

    what: name of the callable in the message.
    """
    try:
        _signature(what, build).bind(*arguments, **keywords)
    except TypeError as error:
        name = _name(build)
        raise ValueError(f"{what} is {name}, which cannot be called with only {', '.join([*arguments, *keywords])}: "
                         f"{error}; expected a callable that takes these and has defaults for all others, for example "
                         f"functools.partial({name}, …) with the missing arguments") from error


def default_of(what: str, build: Callable, name: str) -> object:
    """The default of a parameter, or the value that functools.partial binds to it; None without a default."""
    found = _signature(what, build).parameters.get(name)
    return None if found is None or found.default is found.empty else found.default


def sized_model(build: Callable[..., TorchModel], dataset: TrajectoryDataset,
                module: TrajectoryDataModule) -> TorchModel:
    """The model with input_dim, output_dim and timestep of the data, and with state_dim if it has a default for it.

    A timestep that functools.partial binds replaces that of the data. A state_dim that is a rule of `choose_dimension`
    is computed from windows with the callable's default number of delays. Raises ValueError if the callable does not
    take these arguments, or needs others.
    """
    given = {"input_dim": dataset.input_dim, "output_dim": dataset.output_dim,
             "timestep": getattr(build, "keywords", {}).get("timestep") or dataset.timestep}
    check_call("model", build, **given)
    rule, delays = (default_of("model", build, name) for name in ("state_dim", "delays"))
    if rule is None:
        return build(**given)
    if isinstance(rule, str) and delays is None:
        raise ValueError(f"model is {_name(build)} with the rule state_dim={rule!r}. The rule needs the number of "
                         "delays, but the model has no parameter delays with a default; add one, or give state_dim "
                         "as a number")
    decays = [run for run in module.training if run.kind == "decay"] or list(module.training)
    return build(**given, state_dim=choose_dimension(rule, decays, delays or 0, module.transient))


def _signature(what: str, build: Callable) -> Signature:
    try:
        return signature(build)
    except (TypeError, ValueError) as error:
        if not hasattr(build, "func"):
            raise ValueError(f"{what} is {build!r}; expected a class or function with a readable signature") from error
        known = list(signature(build.func).parameters)
        unknown = [name for name in build.keywords if name not in known]
        raise ValueError(f"{what} binds {unknown or list(build.args)}, but the parameters of {_name(build)} are "
                         f"{known}") from error


def _name(build: Callable) -> str:
    """Name of a callable; for a partial, the name of the callable inside it."""
    inner = getattr(build, "func", build)
    return getattr(inner, "__qualname__", repr(inner))
