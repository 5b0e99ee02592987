"""Every tutorial in miniature: what its page claims is true, measured against answers that are known."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.data.card_reader import custom
from ssmr_torch.plants.slow_manifold import SlowManifold

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
LARGEST_FIGURE = 150_000  # bytes

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:lightning", "ignore:.*LeafSpec")


def tutorial(name):
    spec = importlib.util.spec_from_file_location(name, TUTORIALS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def blocks(name):
    """The numbers that the page shows."""
    return set(re.findall(r"<!-- numbers: (\w+) -->", (TUTORIALS / f"{name}.md").read_text()))


def drawn(directory):
    sizes = {path.name: path.stat().st_size for path in directory.glob("tutorial_*.svg")}
    assert sizes and max(sizes.values()) < LARGEST_FIGURE, sizes
    return set(sizes)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    directory = tmp_path_factory.mktemp("pendulum")
    numbers = tutorial("slow_manifold_of_a_pendulum").main(directory, quick=True)
    assert drawn(directory) == {"tutorial_pendulum.svg"}
    return numbers


def test_the_script_of_the_pendulum_writes_every_table_of_its_page(pendulum):
    assert set(tutorial("slow_manifold_of_a_pendulum").tables(pendulum)) == blocks("slow_manifold_of_a_pendulum")


def test_the_learned_eigenvalue_is_the_slow_one_of_the_equations(pendulum):
    assert pendulum["learned slow"] == pytest.approx(pendulum["slow"], rel=1e-5)
    assert pendulum["learned slow, large releases"] == pytest.approx(pendulum["slow"], rel=0.01)


def test_the_learned_cubic_coefficient_is_that_of_the_invariance_equation(pendulum):
    assert pendulum["learned cubic"] == pytest.approx(pendulum["taylor"][1], rel=0.01)


def test_the_transient_left_in_the_data_biases_the_eigenvalue(pendulum):
    kept, cut = (abs(pendulum["learned slow by transient"][start] / pendulum["slow"] - 1) for start in (0.0, 1.0))
    assert kept > 0.02 and cut < 1e-3 * kept


def test_decays_fall_on_the_manifold_at_the_fast_rate(pendulum):
    assert pendulum["collapse rate"] == pytest.approx(pendulum["fast"], rel=0.02)


def test_the_fit_holds_where_the_series_does_not(pendulum):
    learned, seventh = pendulum["errors"]["learned"], pendulum["errors"]["taylor 7"]
    assert learned[1.5] < 5e-3 and seventh[1.5] > 1


def test_the_static_gain_is_that_of_gravity(pendulum):
    assert pendulum["static gain"] == pytest.approx(pendulum["true static gain"], rel=0.03)


def test_the_taylor_polynomial_satisfies_the_invariance_equation_to_its_order():
    pendulum = tutorial("slow_manifold_of_a_pendulum")
    a = np.polynomial.Polynomial(pendulum.taylor(9))
    angle = np.array([0.1, 0.2])
    left = a.deriv()(angle) * a(angle) + pendulum.DAMPING * a(angle) + pendulum.STIFFNESS * np.sin(angle)
    order = np.log2(left[1] / left[0])
    assert order > 10.5


def test_the_card_of_the_tutorial_reads_back_the_recordings_of_the_robot(tmp_path):
    mine = tutorial("your_own_data")
    mine.record(tmp_path, decays=2, duration=1.5)
    data = custom(tmp_path / "card.yaml")
    assert len((tmp_path / "card.yaml").read_text().splitlines()) <= 10
    assert [run.name for run in data.select(kind="decay")] == ["release_1", "release_2"]
    assert [run.name for run in data.select("test")] == ["check"]
    plant, check = SlowManifold(), data.select("test")[0].read()
    replayed = [plant.reset()] + [plant.step(u) for u in check.input[:-1]]
    moved = check.observation + data.rest - plant.rest[:3]
    assert np.abs(moved - np.array(replayed)[:, :3]).max() < 1e-7


@pytest.mark.slow
def test_the_commands_of_the_tutorial_make_a_controller_from_csv_files(tmp_path):
    found = tutorial("your_own_data").main(tmp_path, tmp_path / "work", quick=True)
    assert drawn(tmp_path) == {"tutorial_own_data_letter.svg", "tutorial_own_data_errors.svg"}
    fitted, true = (np.sort_complex(found[name]) for name in ("eigenvalues", "true eigenvalues"))
    assert np.abs(fitted - true).max() < 0.3
    errors = found["errors, mm"]
    assert errors["SSMR"]["200 ms"] < errors["SSSR"]["200 ms"] < errors["constant velocity"]["200 ms"]
    assert found["letter, mm"]["ssmr"] < 1 and found["fallbacks"]["ssmr"] == 0
    assert (tmp_path / "work" / "report.html").is_file()
    assert set(tutorial("your_own_data").tables(found)) == blocks("your_own_data")


@pytest.fixture(scope="module")
def choices(tmp_path_factory):
    return tutorial("dimension_delays_degree").main(tmp_path_factory.mktemp("choices"), quick=True)


@pytest.mark.slow
def test_six_coordinates_have_the_slow_eigenvalues_of_the_robot(choices):
    fitted, true = (np.sort_complex(choices[name]) for name in ("eigenvalues", "true eigenvalues"))
    assert np.abs(fitted - true).max() < 0.3 and choices["captured"] > 0.999


@pytest.mark.slow
def test_the_script_of_the_choices_writes_every_table_of_its_page(choices):
    assert set(tutorial("dimension_delays_degree").tables(choices)) == blocks("dimension_delays_degree")


@pytest.mark.slow
def test_four_coordinates_are_too_few(choices):
    four, six = (choices["scores"]["state_dim"][n]["usual inputs"][0] for n in (4, 6))
    assert four > 5 * six


@pytest.mark.slow
def test_many_delays_help_decays_and_harm_controlled_runs(choices):
    one, twelve = (choices["scores"]["delays"][delays] for delays in (1, 12))
    assert twelve["decays"][0] < 0.5 * one["decays"][0]
    assert twelve["usual inputs"][0] > 2 * one["usual inputs"][0]


@pytest.mark.slow
def test_degree_five_diverges_under_strong_inputs_and_degree_three_does_not(choices):
    assert choices["scores"]["degree"][5]["strong inputs"][1] > 0.5
    assert choices["scores"]["state_dim"][6]["strong inputs"][1] == 0


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    directory = tmp_path_factory.mktemp("tuning")
    numbers = tutorial("tuning_the_mpc").main(directory, quick=True)
    assert drawn(directory) == {"tutorial_mpc_settings.svg", "tutorial_mpc_weights.svg"}
    return numbers


@pytest.mark.slow
def test_the_best_input_weight_lies_between_chatter_and_sluggishness(tuned):
    noisy = tuned["weight"]["noise"]
    errors, unrest = ({weight: pair[index] for weight, pair in noisy.items()} for index in (0, 1))
    assert errors[300.0] < 0.5 * min(errors[3.0], errors[3e4])
    assert unrest[3.0] > 3 * unrest[300.0] > 3 * unrest[3e4]


@pytest.mark.slow
def test_the_script_of_the_mpc_writes_every_table_of_its_page(tuned):
    assert set(tutorial("tuning_the_mpc").tables(tuned)) == blocks("tuning_the_mpc")


@pytest.mark.slow
def test_one_step_is_too_short_a_horizon_and_two_are_enough(tuned):
    error = {steps: pair[0] for steps, pair in tuned["horizon"].items()}
    assert error[1] > 2 * error[2] and error[5] > 0.7 * error[2]


@pytest.mark.slow
def test_an_estimated_force_takes_away_what_a_weight_on_a_cable_adds(tuned):
    without, with_it = tuned["observer"]["chart"], tuned["observer"]["input disturbance"]
    assert without["pulled, 1 rad/s"] > 1.4 * without["free, 1 rad/s"]
    assert with_it["pulled, 1 rad/s"] < 1.2 * with_it["free, 1 rad/s"]


@pytest.mark.slow
def test_a_filter_without_a_disturbance_is_misled_by_the_weight(tuned):
    assert tuned["observer"]["kalman"]["pulled, 1 rad/s"] > 3 * tuned["observer"]["chart"]["pulled, 1 rad/s"]


@pytest.mark.slow
def test_a_controller_that_is_told_of_late_measurements_bridges_them(tuned):
    unaware, aware = tuned["late"]
    assert unaware > 5 * aware
