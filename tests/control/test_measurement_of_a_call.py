"""Claims about measurements of any form, and about those that no displacement can be."""

import numpy as np
import pytest
import torch

from ssmr_torch.control.outlier_gate import MOST_IN_A_ROW, InnovationGate
from ssmr_torch.control.sampling import BEYOND, RecordedRange, read


@pytest.mark.parametrize("given", [
    [1, 2, 3], (1.0, 2.0, 3.0), np.array([1, 2, 3]), np.array([1, 2, 3], dtype=np.float32), np.array([1, 2, 3], object),
    torch.tensor([1.0, 2.0, 3.0]), ["1", "2", 3]])
def test_numbers_are_read_from_any_container(given):
    np.testing.assert_array_equal(read(given, 3)[0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("given", [
    np.ma.array([1.0, 99.0, 3.0], mask=[False, True, False]), np.ma.array([1, 99, 3], mask=[False, True, False]),
    [1.0, None, 3.0], [1.0, "lost", 3.0], np.array([1.0, 2.0 + 1j, 3.0], object), [1.0, "", 3.0],
    [1.0, np.nan, 3.0]])
def test_masked_values_and_values_that_are_not_numbers_are_missing(given):
    np.testing.assert_array_equal(read(given, 3)[0], [1.0, np.nan, 3.0])


@pytest.mark.parametrize(("given", "readable"), [
    (np.zeros(3), True), ([1, 2, 3], True), (np.ma.zeros(3), True), ([None, 1, 2], True), (["lost", 1, 2], False),
    ([[1], [1, 2], 3], False), (np.zeros(3, complex), False), (torch.zeros(3, requires_grad=True), False),
    ([10**400, 0, 0], False)])
def test_reading_tells_whether_every_value_was_a_number(given, readable):
    assert read(given, 3)[1] is readable


@pytest.mark.parametrize("given", [np.zeros(4), [1.0, 2.0], 5.0, [[1.0, 2.0, 3.0]], None, "measurement"])
def test_only_a_wrong_shape_is_refused(given):
    with pytest.raises(ValueError, match=r"the observation has shape .*; expected \(3,\)"):
        read(given, 3)


def test_the_array_of_the_caller_is_copied():
    given = np.zeros(3)
    read(given, 3)[0][:] = 1.0
    np.testing.assert_array_equal(given, 0.0)


def test_the_range_of_a_model_that_is_observed_in_full_is_that_of_its_states(trial):
    known = RecordedRange(trial.oscillators())
    np.testing.assert_allclose(known.limit, BEYOND * 0.04)
    y = np.array([0.0, 0.079, -0.081, np.nan, np.inf, -np.inf])
    np.testing.assert_array_equal(known.holds(y), [True, True, False, False, False, False])
    said = known.complaint(np.array([0.0, 0.0, -0.3, 0.1, np.nan, 0.0]))
    assert "output 2 is -300 mm" in said and "within 40 mm" in said


def test_a_gate_passes_what_lies_within_six_deviations_and_shuts_out_the_rest():
    gate = InnovationGate()
    assert all(gate.passes(1.0) for _ in range(600))
    assert gate.passes(35.0) and not gate.passes(1e4) and gate.passes(1.0)


def test_a_gate_follows_innovations_that_grow_and_forgets_them_again():
    gate = InnovationGate()
    assert all(gate.passes(1.2**k) for k in range(100))
    assert all(gate.passes(1.0) for _ in range(1500)) and not gate.passes(100.0)


def test_a_gate_that_shuts_out_everything_opens_again():
    gate = InnovationGate()
    for _ in range(600):
        gate.passes(1.0)
    assert [gate.passes(1e6) for _ in range(MOST_IN_A_ROW + 1)] == [False] * MOST_IN_A_ROW + [True]
    assert not any(gate.passes(spoilt) for spoilt in [np.nan, np.inf] * 10)


def test_an_outlier_of_thousands_of_deviations_is_shut_out_from_the_start():
    gate = InnovationGate()
    assert gate.passes(100.0) and not gate.passes(1e7)
