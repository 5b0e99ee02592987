import numpy as np
import pytest
import torch
from sklearn.linear_model import Ridge

from ssmr_torch.fitting.streamed_least_squares import Factor, StreamedRegression, singular_values


@pytest.fixture
def rows():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(400, 7)) * np.logspace(0, -6, 7)
    targets = features @ rng.normal(size=(7, 3)) / np.logspace(0, -6, 7).mean() + 0.01 * rng.normal(size=(400, 3))
    return torch.from_numpy(features), torch.from_numpy(targets)


def streamed(features, targets, batches, folds=1):
    regression = StreamedRegression()
    for index, (x, y) in enumerate(zip(features.tensor_split(batches), targets.tensor_split(batches))):
        regression.accumulate(x, y, fold=index % folds)
    return regression


@pytest.mark.parametrize("batches", [1, 3, 50, 200])
def test_streamed_least_squares_equals_that_of_all_rows_however_they_are_batched(rows, batches):
    solution = streamed(*rows, batches, folds=min(batches, 4)).solve()
    expected, *_ = np.linalg.lstsq(rows[0].numpy(), rows[1].numpy(), rcond=None)
    np.testing.assert_allclose(solution.coefficients.numpy().T, expected, rtol=1e-9)
    residual = np.linalg.norm(rows[1].numpy() - rows[0].numpy() @ expected) / np.linalg.norm(rows[1].numpy())
    assert solution.residual == pytest.approx(residual, rel=1e-9)
    assert solution.rows == 400 and solution.rank == 7


def test_the_ridge_solution_equals_scikit_learn_on_features_of_unit_norm(rows):
    features, targets = rows
    norms = torch.linalg.vector_norm(features, dim=0)
    expected = Ridge(alpha=0.03, fit_intercept=False, solver="svd").fit((features / norms).numpy(), targets.numpy())
    solution = streamed(features, targets, 5).solve(0.03)
    np.testing.assert_allclose(solution.coefficients.numpy(), expected.coef_ / norms.numpy(), rtol=1e-9)


def test_units_of_a_feature_do_not_change_the_regularized_prediction(rows):
    features, targets = rows
    units = torch.tensor([1.0, 1e3, 1e-3, 1e6, 1.0, 10.0, 1e-6], dtype=torch.float64)
    metres = streamed(features, targets, 4).solve(0.01).coefficients
    others = streamed(features * units, targets, 4).solve(0.01).coefficients
    torch.testing.assert_close(others * units, metres, rtol=1e-9, atol=0)


def test_cross_validation_chooses_the_ridge_with_the_least_held_out_error(rows):
    features, targets = rows
    noisy = targets + 3 * torch.randn(targets.shape, dtype=torch.float64)
    candidates = (0.0, 1e-3, 1e-1, 1.0, 10.0)
    solution = streamed(features, noisy, 8, folds=4).solve(candidates)
    parts = list(zip(features.tensor_split(8), noisy.tensor_split(8)))
    errors = []
    for ridge in candidates:
        squared = 0.0
        for fold in range(4):
            kept = StreamedRegression()
            for index, (x, y) in enumerate(parts):
                if index % 4 != fold:
                    kept.accumulate(x, y)
            held = [(x, y) for index, (x, y) in enumerate(parts) if index % 4 == fold]
            coefficients = kept.solve(ridge).coefficients
            squared += sum(float((y - x @ coefficients.T).square().sum()) for x, y in held)
        errors.append((squared / float(noisy.square().sum())) ** 0.5)
    np.testing.assert_allclose([solution.validation[c] for c in candidates], errors, rtol=1e-9)
    assert solution.ridge == candidates[int(np.argmin(errors))]


def test_singular_values_are_those_of_all_rows(rows):
    factor = Factor.of(rows[0][:100]).merged(Factor.of(rows[0][100:105])).merged(Factor.of(rows[0][105:]))
    values, vectors = singular_values(factor)
    _, expected, right = np.linalg.svd(rows[0].numpy(), full_matrices=False)
    np.testing.assert_allclose(values.numpy(), expected, rtol=1e-9)
    np.testing.assert_allclose(np.abs(vectors.numpy().T @ right.T), np.eye(7), atol=1e-8)
    assert (vectors[vectors.abs().argmax(0), torch.arange(7)] > 0).all()


def test_rows_are_factorized_when_there_are_enough_or_on_request():
    rng, regression = np.random.default_rng(0), StreamedRegression()
    batches = [torch.from_numpy(rng.normal(size=(700, 3))) for _ in range(7)]
    for number, batch in enumerate(batches):
        regression.accumulate(batch[:, :2], batch[:, 2:], fold=number % 2)
    triangles = {fold: factor.triangle for fold, factor in regression.folds.items()}
    for fold, triangle in triangles.items():
        rows = torch.cat(batches[fold::2])
        torch.testing.assert_close(triangle.T @ triangle, rows.T @ rows, rtol=1e-12, atol=1e-12)
        assert regression.folds[fold].rows == len(rows)
    regression.accumulate(batches[0][:, :2], batches[0][:, 2:])
    assert regression.folds[0].rows == 5 * 700 and regression.total().rows == 8 * 700


def test_triangles_are_merged_as_their_rows_would_be():
    a, b = (Factor.of(torch.randn(size, 90, dtype=torch.float64)) for size in (200, 30))
    merged, stacked = a.merged(b).triangle, torch.cat([a.triangle, b.triangle])
    torch.testing.assert_close(merged.T @ merged, stacked.T @ stacked, rtol=1e-12, atol=1e-11)
    assert (merged.tril(-1) == 0).all() and a.merged(b).rows == 230


def test_a_feature_that_is_always_zero_gets_a_zero_coefficient():
    features = torch.randn(30, 3, dtype=torch.float64)
    features[:, 1] = 0
    solution = streamed(features, features[:, :1] * 2, 3).solve()
    torch.testing.assert_close(solution.coefficients, torch.tensor([[2.0, 0.0, 0.0]], dtype=torch.float64),
                               rtol=1e-12, atol=1e-12)
    assert solution.rank == 2 and solution.condition == float("inf")


def test_impossible_regressions_are_refused():
    with pytest.raises(ValueError, match="no rows were accumulated"):
        StreamedRegression().solve()
    regression = streamed(torch.randn(5, 2).double(), torch.randn(5, 1).double(), 1)
    with pytest.raises(ValueError, match="at least 2 folds, but there is 1"):
        regression.solve((0.0, 1.0))
    with pytest.raises(ValueError, match="earlier batches had"):
        regression.accumulate(torch.randn(5, 3).double(), torch.randn(5, 1).double())
