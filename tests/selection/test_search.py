"""The stages of a search: the forms that they try, and the recovery of a known memory."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.selection import search as stages
from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.search import search
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.trial import Trial


@pytest.fixture
def small(monkeypatch):
    """One chart and two kinds of features, so that a search takes seconds."""
    monkeypatch.setattr(stages, "_first", lambda names, decays: [Specification(memory=("shift", 1), ridge=1e-6)])
    monkeypatch.setattr(stages, "_FEATURES", (("linear", 0), ("bilinear", 0)))
    monkeypatch.setattr(stages, "_sizes", lambda each: ())


def through_an_actuator(tau, timestep=0.02, runs=3, steps=500):
    """q_{k+1} of a damped oscillator under s_k, s⁺ = a s + (1 − a) u, a = exp(−timestep / tau), and s times q."""
    found, a = [], float(np.exp(-timestep / tau))
    for seed in range(runs):
        u = np.repeat(np.random.default_rng(seed).uniform(-0.5, 1.0, (steps // 8 + 1, 2)), 8, axis=0)[:steps]
        y, d, s, rows = np.zeros(2), np.zeros(2), np.zeros(2), []
        for now in u:
            rows.append(y)
            d = 0.85 * d - 0.06 * y + 2e-3 * s + 0.05 * s * y[::-1]
            y, s = y + d, a * s + (1.0 - a) * now
        found.append((np.array(rows), u))
    return Samples([], found, timestep, coordinates={"identity": None}, targets=[0, 1])


@pytest.mark.parametrize("tau", [0.02, 0.05])
def test_an_actuator_of_known_time_constant_is_found(small, tau):
    trial = Trial(through_an_actuator(tau))
    search(trial, decays=False)
    best = trial.best(1)[0]
    assert best.memory == ("pole", round(float(np.exp(-0.02 / tau)), 4)) and best.features == "bilinear"
    assert trial.outcomes[best].e.max() < 1e-3


def test_inputs_that_act_at_once_need_no_actuator(small, systems):
    trial = Trial(systems.samples(systems.configuration_affine, decays=0))
    search(trial, decays=False)
    assert trial.best(1)[0].memory[0] == "shift"


def test_after_its_time_the_search_tries_nothing_and_counts_what_is_left(systems):
    trial = Trial(systems.samples(decays=0))
    search(trial, decays=False, minutes=0.0)
    assert not trial.outcomes and trial.left_out > 50 and not trial.best()


def test_every_first_specification_fits_the_data_that_it_needs(systems):
    first = list(stages._first(["identity"], True))
    assert len(first) == len(set(first)) and {each.chart for each in first} == {"delay", "predictive", "tangent_space"}
    assert not any(each.chart == "tangent_space" for each in stages._first(["identity"], False))


def test_neighbours_in_size_stay_within_the_window(systems):
    for each in (Specification(delays=3), Specification(chart="predictive", states=4, delays=12)):
        assert all(0 < other.delays <= 19 and other.states != 1 for other in stages._sizes(each))
        assert all(replace(other, delays=each.delays, states=each.states) == each for other in stages._sizes(each))
