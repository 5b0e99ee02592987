"""Own parts and libraries are compared on what both compute; none of the times is judged. See docs/libraries.md."""

import re

import pytest

from ssmr_torch.benchmarks import libraries as benchmark


@pytest.fixture
def libraries(monkeypatch):
    monkeypatch.setattr(benchmark, "REPEATS", 1)
    return benchmark


def number(text, pattern):
    return float(re.search(pattern, text).group(1))


def test_pandas_reads_every_number_to_the_last_bit(libraries):
    assert "; 0 differ in the last bit" in libraries.reading(8000)["found"]


def test_both_seams_of_three_runs_are_found_and_none_in_one_run(libraries):
    assert "own [1000, 2000], and [] in one run" in next(libraries.seams())["found"]


def test_no_orthonormal_directions_leave_less_than_the_singular_vectors(libraries):
    found = libraries.tangent_space(steps=60)["found"]
    assert 1.0 <= number(found, r"residual ([\d.]+) times") < 100


def test_a_parametrization_takes_the_steps_of_scaled_adam_under_another_name(libraries):
    found = libraries.scaled_adam(steps=20)["found"]
    assert number(found, r"differ by ([\d.e-]+);") < 1e-12 and found.endswith("parametrizations.weight.original")


def test_streamed_factors_solve_what_normal_equations_cannot(libraries):
    found = libraries.regression(rows=4000, columns=10)["found"]
    assert number(found, "coefficients ([^ ]+) and") < 1e-6 < 1e-2 < number(found, "and ([^ ]+), of")


def test_solutions_through_qpsolvers_equal_those_of_the_workspace(libraries):
    pytest.importorskip("qpsolvers", reason="needs pip install 'ssmr_torch[qpsolvers]'")
    assert number(libraries.quadratic_program(10, 4)["found"], r"differ by ([^ ]+)$") < 1e-5


def test_the_other_parts_give_a_row(libraries):
    for row in (libraries.sensitivities(2, 10), libraries.wire(3)):
        assert list(row) == ["part", "own", "library", "own, ms", "library, ms", "found"] and row["own, ms"] > 0
