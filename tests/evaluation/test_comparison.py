"""The table that compares many models."""

import numpy as np

from ssmr_torch.evaluation.comparison import comparison_table
from ssmr_torch.evaluation.open_loop import HorizonScore, OpenLoopScore


def score(*errors):
    parts = [HorizonScore(label, 5, 0.05, np.array(values), np.array(values)[:, None], 0)
             for label, values in zip(("50 ms", "full"), errors)]
    return OpenLoopScore(tuple(parts), 1, 0, (0,))


def test_means_and_medians_are_in_millimetres_and_divergence_is_never_averaged_away():
    text = comparison_table({"good": score([1e-3, 3e-3, 5e-3], [2e-3]), "wild": score([1e-3, np.inf, 2e-3], [np.inf])},
                            {"good": {"state_dim": 6.0, "parameters": 240.0, "fit_time": 1.234}})
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]
    assert rows[0] == ["model", "50 ms", "full", "diverged", "n", "parameters", "fit"]
    assert rows[2] == ["good", "3 / 3", "2 / 2", "0 %", "6", "240", "1.23 s"]
    assert rows[3] == ["wild", "∞ / 2", "∞ / ∞", "100 %", "–", "–", "–"]
