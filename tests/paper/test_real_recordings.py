"""Models learned from the real recordings, as a user would, scored on runs that they have not seen."""

import numpy as np
import pytest

from ssmr_torch.data.derivatives import central_difference
from ssmr_torch.evaluation.open_loop import compare_open_loop, score_open_loop
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.paper import readers

HORIZONS = ("50 ms", "200 ms", "1 s")


def learn(solve_stages, dataset, *, state_dim=6, delays=1, degree=1, transient=0.0, ridge=0.0, **options):
    model = SSMR(state_dim, dataset.input_dim, dataset.output_dim, delays, dynamics_degree=degree, substeps=2,
                 timestep=dataset.timestep, control_degree=options.pop("control_degree", 1))
    procedure = SSMRLeastSquares(model, derivative=central_difference(6), **options)
    solve_stages(procedure, dataset.select("train"), transient=transient, ridge=ridge)
    reach = max(np.linalg.norm(t.read().observation, axis=1).max() for t in dataset.select("train"))
    model.state_scale.fill_(reach)
    return model


@pytest.mark.slow
@pytest.mark.parametrize("calibration", ["joint", "frozen"])
def test_the_simulated_diamond_is_predicted_across_the_seam(measurements, solve_stages, calibration):
    dataset = readers.authors_simulated_diamond(measurements("diamond_simulated"))
    runs = dataset.select("test", "controlled")
    assert [run.length for run in runs] == [8692 - 3686]
    linear = score_open_loop(learn(solve_stages, dataset, transient=0.2, calibration=calibration), runs)
    for horizon, limit in zip(HORIZONS, (0.07e-3, 0.22e-3, 0.34e-3)):
        assert linear[horizon].mean <= limit, (horizon, linear[horizon].mean)
    curved = score_open_loop(learn(solve_stages, dataset, degree=2, transient=0.2), runs)
    for horizon in HORIZONS:
        assert curved[horizon].mean <= linear[horizon].mean
        assert curved[horizon].diverged == 0


@pytest.mark.slow
def test_the_hardware_trunk_is_predicted_better_than_by_persistence_and_constant_velocity(measurements, solve_stages):
    dataset = readers.real_trunk(measurements("trunk_hardware")).observing(["marker3_x", "marker3_y", "marker3_z"])
    assert sum(run.kind == "decay" for run in dataset.select("train")) == 37
    model = learn(solve_stages, dataset, control_degree=0, ridge={"dynamics": 1e-3})
    scores = compare_open_loop({"model": model}, dataset.select("test", "controlled"))
    for horizon in HORIZONS:
        for baseline in ("persistence", "constant velocity"):
            assert scores["model"][horizon].mean < scores[baseline][horizon].mean_of_survivors
        assert scores["model"][horizon].diverged == 0
