"""Closed-form fits of SSMR: the solving optimizer, and known models that must be recovered."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ssmr_torch.data.derivatives import central_difference
from ssmr_torch.data.windows import SegmentDataset
from ssmr_torch.fitting.closed_form_fit import ExactSolve
from ssmr_torch.fitting.lightning_fit import LeastSquaresFit
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.ssmr import SSMR


def ssmr(runs, **changes):
    return SSMR(**{"state_dim": 2, "input_dim": 2, "output_dim": 4, "delays": 0, "parametrization_degree": 2,
                   "dynamics_degree": 3, "control_degree": 1, "timestep": runs[0].timestep} | changes)


def every_second(runs):
    return [replace(run, time=run.time[::2], observation=run.observation[::2], input=run.input[::2]) for run in runs]


def orders(errors):
    """Observed orders of convergence of errors at timesteps that double from one to the next."""
    return {name: np.log2([coarse[name] / fine[name] for fine, coarse in zip(errors, errors[1:])])
            for name in ("drift", "control")}


@pytest.fixture(scope="module")
def smooth(known):
    """Runs sampled every 5, 10 and 20 ms whose inputs never change, so that every derivative in time exists."""
    finest = known.decays(0.005) + known.held_runs(0.005)
    return [finest, every_second(finest), every_second(every_second(finest))]


@pytest.mark.parametrize("calibration", ["joint", "frozen"])
@pytest.mark.parametrize("order", [4, 6])
def test_a_known_model_is_recovered_at_the_order_of_the_difference(known, smooth, solve_stages, calibration, order):
    errors = [known.errors(solve_stages(SSMRLeastSquares(ssmr(runs), calibration=calibration,
                                                         derivative=central_difference(order)), runs))
              for runs in smooth]
    for observed in orders(errors).values():
        np.testing.assert_allclose(observed, order, atol=0.35)
    assert max(error["outputs"] for error in errors) < 1e-12
    if order == 6:
        assert errors[0]["drift"] < 1e-9 and errors[0]["control"] < 2e-9


@pytest.mark.parametrize(("alignment", "order"), [("held", 2), ("sample", 1)])
def test_held_inputs_give_second_order_and_inputs_at_the_sample_first_order(
        known, solve_stages, alignment, order):
    errors = []
    for timestep in (0.005, 0.01):
        runs = known.decays(timestep, finest=1e-3) + known.excited_runs(timestep, finest=1e-3)
        errors.append(known.errors(solve_stages(SSMRLeastSquares(ssmr(runs), input_alignment=alignment), runs)))
    for observed in orders(errors).values():
        np.testing.assert_allclose(observed, order, atol=0.3)
    assert errors[0]["control"] < (2e-4 if alignment == "held" else 5e-2)


def test_the_fit_does_not_depend_on_how_runs_are_cut_into_segments(known, solve_stages):
    runs = known.decays(0.01, finest=1e-3) + known.excited_runs(0.01, duration=1.0, finest=1e-3)
    fits = [solve_stages(SSMRLeastSquares(ssmr(runs, delays=2), detection_delays=5), runs, rows=rows).reduced.numpy()
            for rows in (10**6, 64, 7, 3)]
    for other in fits[1:]:
        free = [factors[-1] < fits[0].state_dim for factors in fits[0].structure.dynamics.factors]
        for table, columns in (("chart", slice(None)), ("parametrization", slice(None)), ("dynamics", free),
                               ("dynamics", np.logical_not(free))):
            whole, cut = (getattr(fit, table)[:, columns] for fit in (fits[0], other))
            assert np.linalg.norm(cut - whole) < 1e-9 * np.linalg.norm(whole), table


def test_the_memory_of_the_solver_does_not_grow_with_the_run(known):
    run = known.excited_runs(0.01, count=1, finest=1e-2)[0]
    long = replace(run, time=0.01 * np.arange(40 * run.length), observation=np.tile(run.observation, (40, 1)),
                   input=np.tile(run.input, (40, 1)))

    def kept(trajectory):
        procedure = SSMRLeastSquares(ssmr([run]), calibration="joint")
        solver = ExactSolve(procedure.model.parameters())
        for index, segment in enumerate(SegmentDataset([trajectory], before=procedure.before, after=procedure.after,
                                                       rows=50)):
            for name, found in procedure.regressions(segment, "control").items():
                solver.accumulate(name, found.features, found.targets, index % 5)
        factors = [factor for regression in solver.regressions.values() for factor in regression.folds.values()]
        return sum(factor.triangle.numel() for factor in factors), sum(factor.rows for factor in factors)

    (small, rows), (large, many_rows) = kept(run), kept(long)
    assert small == large == 5 * (9 + 6 + 2) ** 2
    assert rows == run.length - 6 and many_rows == long.length - 6


@pytest.fixture
def rows():
    generator = torch.Generator().manual_seed(3)
    features = torch.randn(90, 4, generator=generator, dtype=torch.float64)
    noise = torch.randn(90, 2, generator=generator, dtype=torch.float64)
    return features, features @ torch.arange(8.0, dtype=torch.float64).reshape(4, 2) + noise


def solver(ridge=0.0):
    return ExactSolve([torch.nn.Parameter(torch.zeros(1))], ridge)


def test_batches_give_the_solution_of_all_rows_and_each_step_starts_empty(rows):
    features, targets = rows
    optimizer = solver()
    for chosen in (slice(0, 1), slice(1, 50), slice(50, 90)):
        optimizer.accumulate("a", features[chosen], targets[chosen], fold=chosen.start)
    optimizer.accumulate("b", features, targets[:, :1])
    assert optimizer.step(lambda: 0.25) == 0.25
    expected = np.linalg.lstsq(features.numpy(), targets.numpy(), rcond=None)[0].T
    np.testing.assert_allclose(optimizer.solutions["a"].coefficients, expected, rtol=1e-10)
    np.testing.assert_allclose(optimizer.solutions["b"].coefficients, expected[:1], rtol=1e-10)
    optimizer.accumulate("a", features[:20], targets[:20])
    optimizer.step()
    assert set(optimizer.solutions) == {"a"} and optimizer.solutions["a"].rows == 20


def test_a_mapping_gives_each_regression_its_own_ridge_and_the_default_or_none_to_the_others(rows):
    named = {"one": 0.1, "several": [0.0, 1e3]}
    assert ridges(rows, named | {"default": 0.5}) == [0.1, 0.0, 0.5]
    assert ridges(rows, 0.2) == [0.2, 0.2, 0.2]
    optimizer = solver(named)
    for name in ("one", "several", "unnamed"):
        for fold in range(3):
            optimizer.accumulate(name, rows[0][30 * fold:30 * fold + 30], rows[1][30 * fold:30 * fold + 30], fold)
    optimizer.step()
    found = optimizer.solutions
    assert [found[name].ridge for name in ("one", "several", "unnamed")] == [0.1, 0.0, 0.0]
    assert set(found["several"].validation) == {0.0, 1e3} and not found["one"].validation
    assert found["one"].coefficients.norm() < found["unnamed"].coefficients.norm()
    torch.testing.assert_close(found["several"].coefficients, found["unnamed"].coefficients, rtol=1e-12, atol=0)


def ridges(rows, ridge):
    optimizer = solver(ridge)
    for name in ("one", "several", "unnamed"):
        for fold in range(3):
            optimizer.accumulate(name, rows[0][30 * fold:30 * fold + 30], rows[1][30 * fold:30 * fold + 30], fold)
    optimizer.step()
    return [optimizer.solutions[name].ridge for name in ("one", "several", "unnamed")]


@pytest.mark.parametrize("ridge", [-1e-3, float("nan"), [0.0, -1.0]])
def test_a_ridge_below_zero_is_refused(rows, ridge):
    with pytest.raises(ValueError, match="expected 0 or more"):
        ridges(rows, ridge)


def test_stages_are_the_steps_of_the_paper_with_reparametrization_on_request(known):
    runs = known.decays(0.01, pairs=1, finest=1e-2)
    plain = SSMRLeastSquares(ssmr(runs, delays=1))
    detected = SSMRLeastSquares(ssmr(runs, delays=1), detection_delays=4, derivative=central_difference(4))
    assert plain.stages == ("tangent_space", "manifold", "control")
    assert detected.stages == ("tangent_space", "reparametrization", "manifold", "control")
    assert (plain.before, plain.after, detected.before, detected.after) == (4, 3, 6, 2)
    assert LeastSquaresFit(detected).epochs == 4


@pytest.mark.parametrize(("calibration", "tangent", "chosen", "message"), [
    ("joint", "decays", "controlled", "tangent_space stage.*no decay runs.*manifold_data=all"),
    ("frozen", "all", "controlled", "manifold stage.*'drift'.*no decay runs"),
    ("frozen", "decays", "decay", "control stage.*'control'.*there are no controlled runs")])
def test_missing_runs_of_a_stage_are_named(known, solve_stages, calibration, tangent, chosen,
                                                             message):
    runs = known.decays(0.01, pairs=1, finest=1e-2) + known.excited_runs(0.01, count=1, finest=1e-2)
    procedure = SSMRLeastSquares(ssmr(runs), calibration=calibration, manifold_data=tangent)
    with pytest.raises(ValueError, match=message):
        solve_stages(procedure, [run for run in runs if run.kind == chosen])


@pytest.mark.parametrize(("options", "message"), [
    ({"calibration": "both"}, "calibration is 'both'; expected"),
    ({"input_alignment": "none"}, "input_alignment is 'none'"), ({"manifold_data": ""}, "manifold_data is ''"),
    ({"parametrization_fit": "curved"}, "parametrization_fit is 'curved'"),
    ({"detection_delays": 0}, "detection_delays is 0; expected at least 1")])
def test_options_that_do_not_exist_are_refused(known, options, message):
    with pytest.raises(ValueError, match=message):
        SSMRLeastSquares(SSMR(2, 2, 4, 1), **options)


def test_cross_validation_with_a_single_fold_is_refused():
    with pytest.raises(ValueError, match="folds is 1; expected"):
        LeastSquaresFit(SSMRLeastSquares(SSMR(2, 2, 4, 1)), folds=1)


@pytest.mark.parametrize("ridge", [-1.0, float("nan"), [0.0, -1e-6], {"default": 0.0, "dynamics": [float("inf")]}, []])
def test_an_invalid_ridge_is_refused_before_any_data_are_read(ridge):
    with pytest.raises(ValueError, match=r"ridge\S* is .*; expected a number from 0 to"):
        LeastSquaresFit(SSMRLeastSquares(SSMR(2, 2, 4, 1)), ridge)


def test_assigning_the_solutions_of_the_manifold_again_changes_nothing(known, solve_stages):
    runs = known.decays(0.01, pairs=2, finest=1e-2)
    procedure = SSMRLeastSquares(ssmr(runs))
    solve_stages(procedure, runs, stages=("tangent_space",))
    solve_stages(procedure, runs, stages=("manifold",))
    once = procedure.model.parametrization.clone()
    solve_stages(procedure, runs, stages=("manifold",))
    torch.testing.assert_close(procedure.model.parametrization, once, rtol=1e-12, atol=1e-15)
    assert once[:, procedure.model.state_dim:].abs().max() > 0
