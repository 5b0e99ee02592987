"""Training takes any callable that makes a model, a fit, a data module or a trainer."""

from functools import partial

import lightning
import numpy as np
import pytest

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.fitting.constructor_checks import sized_model
from ssmr_torch.fitting.gauss_newton import GaussNewtonFit
from ssmr_torch.fitting.training import koopman_least_squares, least_squares, train
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.ssmr import SSMR

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:lightning", "ignore:.*LeafSpec",
                                        "ignore:.*does not have many workers")


class Narrow(SSMR):
    """An SSMR of two states without delays unless asked for more."""

    def __init__(self, input_dim, output_dim, timestep, state_dim=2, delays=0):
        super().__init__(state_dim, input_dim, output_dim, delays, dynamics_degree=1, timestep=timestep)


class Ruled(Narrow):
    def __init__(self, input_dim, output_dim, timestep, state_dim="gap", delays=1):
        super().__init__(input_dim, output_dim, timestep, state_dim, delays)


def written_out(*, input_dim, output_dim, timestep):
    return Narrow(input_dim, output_dim, timestep)


class Factory:
    def __call__(self, **sizes):
        return Narrow(**sizes)


CALLABLES = {
    "class": Narrow, "function": written_out, "object": Factory(),
    "lambda": lambda input_dim, output_dim, timestep: Narrow(input_dim, output_dim, timestep),
    "lambda of anything": lambda **sizes: Narrow(**sizes),
    "partial": partial(SSMR, state_dim=2, delays=0, dynamics_degree=1),
    "partial of a partial": partial(partial(SSMR, state_dim=2), delays=0, dynamics_degree=1),
    "partial by position": partial(SSMR, 2, delays=0, dynamics_degree=1),
}


@pytest.fixture(scope="module")
def dataset(known):
    return known.dataset()


@pytest.fixture(scope="module")
def module(dataset):
    return TrajectoryDataModule(dataset)


@pytest.mark.parametrize("kind", CALLABLES)
def test_a_model_is_made_by_any_callable_that_takes_the_sizes_of_the_data(dataset, module, kind):
    model = sized_model(CALLABLES[kind], dataset, module)
    assert (model.state_dim, model.input_dim, model.output_dim, model.delays) == (2, 2, 4, 0)
    assert model.timestep == dataset.timestep


@pytest.mark.parametrize("build", [Ruled, partial(Narrow, state_dim="gap", delays=1), partial(SSMR, state_dim="gap")])
def test_a_rule_for_the_dimension_is_followed_wherever_it_is_the_default(dataset, module, build):
    assert sized_model(build, dataset, module).state_dim == 2


@pytest.mark.parametrize(("build", "step"), [
    (Koopman, 0.005), (partial(Koopman, timestep=None), 0.005), (partial(Koopman, timestep=0.02), 0.02)])
def test_a_timestep_bound_by_a_partial_replaces_that_of_the_data(known, module, build, step):
    assert sized_model(build, known.dataset(timestep=0.005), module).timestep == step


@pytest.mark.parametrize(("build", "message"), [
    (SSMR, "model is SSMR, which cannot be called with only input_dim, output_dim, timestep: missing a required "
           r"argument: 'state_dim'; expected .* for example functools.partial\(SSMR, …\)"),
    (lambda input_dim, output_dim: None, "got an unexpected keyword argument 'timestep'"),
    (lambda: None, "model is .*<lambda>, which cannot be called with only input_dim"),
    (partial(SSMR, state_dim=2, input_dims=2), r"model binds \['input_dims'\], but the parameters of SSMR are "
                                               r"\['state_dim', 'input_dim',"),
    ("SSMR", "model is 'SSMR'; expected a class or function with a readable signature"),
    (lambda input_dim, output_dim, timestep, state_dim="gap": None, "the rule state_dim='gap'. The rule needs"),
])
def test_a_callable_without_the_needed_arguments_is_refused_by_name(dataset, module, build, message):
    with pytest.raises(ValueError, match=message):
        sized_model(build, dataset, module)


def quiet(**options):
    return lightning.Trainer(accelerator="cpu", devices=1, enable_model_summary=False, enable_progress_bar=False,
                             use_distributed_sampler=False, **options)


def short(dataset):
    return TrajectoryDataModule(dataset, validation_horizon=0.1, starts=20)


def small(input_dim, output_dim, timestep):
    return SSMR(2, input_dim, output_dim, 0, dynamics_degree=1, timestep=timestep)


def test_fits_module_and_trainer_may_be_plain_functions_and_classes(dataset, tmp_path):
    found = train(dataset, model=small, fits={"closed_form": lambda model: least_squares(model, ridge=1e-8)},
                  module=short, trainer=quiet, directory=tmp_path / "plain")
    bound = train(dataset, model=partial(SSMR, state_dim=2, delays=0, dynamics_degree=1),
                  fits={"closed_form": partial(least_squares, ridge=1e-8)}, trainer=partial(quiet),
                  module=partial(TrajectoryDataModule, validation_horizon=0.1, starts=20), directory=tmp_path / "bound")
    assert found.scores == bound.scores and found.report["closed_form"] == bound.report["closed_form"]
    koopman = train(dataset, model=Koopman, fits={"closed_form": koopman_least_squares}, module=short, trainer=quiet,
                    directory=tmp_path / "koopman")
    assert np.isfinite(koopman.scores["test/rmse"])


@pytest.mark.parametrize("none", [lambda model: GaussNewtonFit(model, epochs=0), partial(GaussNewtonFit, epochs=0)])
def test_a_fit_with_zero_epochs_is_left_out(dataset, tmp_path, none):
    found = train(dataset, model=small, fits={"closed_form": least_squares, "refinement": none}, module=short,
                  trainer=quiet, directory=tmp_path)
    assert set(found.report) == {"closed_form"}


@pytest.mark.parametrize(("changes", "message"), [
    ({"module": lambda: None}, "module is .*<lambda>, which cannot be called with only dataset"),
    ({"trainer": lambda max_epochs: None}, "trainer is .*<lambda>, which cannot be called with only max_epochs"),
    ({"fits": {"closed_form": lambda: None}}, r"fits\['closed_form'\] is .*cannot be called with only the model"),
    ({"fits": {"closed_form": 3}}, r"fits\['closed_form'\] is 3; expected a class or function"),
])
def test_what_cannot_be_called_is_refused_before_any_work(dataset, tmp_path, changes, message):
    options = {"model": small, "fits": {"closed_form": least_squares}, "module": short, "trainer": quiet} | changes
    with pytest.raises(ValueError, match=message):
        train(dataset, directory=tmp_path, **options)
    assert not list(tmp_path.iterdir())
