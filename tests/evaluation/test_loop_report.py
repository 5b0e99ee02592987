"""The report of a closed loop: each of its values, with a known answer."""

import json

import numpy as np
import pytest

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.evaluation.loop_report import bound_margins, natural_frequency, reference_frequency


@pytest.fixture(scope="module")
def record(by_hand, trial):
    controller, plant = by_hand(), trial.ModelPlant(trial.oscillators())
    return simulate(plant, controller, controller.task, noise_std=1e-5)


def test_a_circle_and_a_sine_have_their_own_frequency_and_a_point_none():
    time = np.linspace(0.0, 10 * np.pi, 20001)
    circle = 0.3 + 0.01 * np.stack([np.cos(2.0 * time), np.sin(2.0 * time)], axis=1)
    assert reference_frequency(time, circle) == pytest.approx(2.0, rel=1e-2)
    assert reference_frequency(time, np.sin(3.0 * time)[:, None]) == pytest.approx(3.0, rel=1e-2)
    assert reference_frequency(time, 0.0 * circle) == 0.0


def test_the_first_natural_frequency_is_that_of_the_slowest_resonance():
    assert natural_frequency([-0.1, -1 + 10j, -1 - 10j, -0.2 + 30j]) == pytest.approx(np.hypot(1.0, 10.0))
    assert natural_frequency([-3.0, -0.5, -4.0 + 3.0j, -4.0 - 3.0j]) is None  # overdamped: nothing resonates
    assert natural_frequency([complex("nan"), 2j]) == 2.0


def test_margins_are_the_smallest_distances_and_the_share_of_time_at_a_bound():
    lowest, highest, low, high = bound_margins([[0.1, 0.0], [0.5, 0.0], [0.3, 2.0], [0.2, 1.0]],
                                               [[0.0, 0.0], [1.0, 2.0]], ["a", "b"])
    assert (lowest.input, lowest.side, lowest.distance, lowest.share) == ("a", "lowest", 0.1, 0.0)
    assert (highest.side, highest.distance) == ("highest", 0.5)
    assert (low.distance, low.share) == (0.0, 0.5) and (high.distance, high.share) == (0.0, 0.25)


def test_a_designed_loop_reports_errors_speed_minutes_tuning_counts_and_margins(record, trial, tmp_path):
    report = ClosedLoopRecord.load(record.save(tmp_path / "record.h5")).report()
    facts = json.loads(json.dumps(report.facts, allow_nan=False))
    assert facts["tuned"] == "designed from 2.5 min of recordings" and facts["minutes"] == 2.5
    assert facts["share_of_reach"] == pytest.approx(facts["rmse"] / 0.02)
    assert facts["control_rate"] == pytest.approx(100.0)
    natural = natural_frequency(trial.oscillators().rates)
    assert facts["speed"] == pytest.approx(reference_frequency(record.time, record.reference) / natural)
    assert facts["gated"] == 0 and facts["late"] == 0 and facts["fallbacks"] == 0
    assert len(facts["margins"]) == 8 and facts["margins"][0]["input"] == "u0"
    said = repr(report)
    for part in ("% of the reach; ISE", "of the first natural frequency", "100 Hz; 0 of", "recordings used: 2.5 min",
                 "gated samples: 0", "u0, lowest: "):
        assert part in said, said
    assert "tuned: designed from 2.5 min of recordings" in repr(record)


def test_unknown_values_are_reported_as_not_known(record):
    bare = ClosedLoopRecord(**{**vars(record), "provenance": {"period": 0.01, "task": "mine"}}).report()
    assert bare.speed is None and bare.margins == () and bare.gated is None
    for part in ("tuned: not told", "recordings used: not known", "speed of the reference: not known",
                 "gated samples: not counted", "bounds: not known"):
        assert part in repr(bare)
