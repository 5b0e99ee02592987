"""Observer and actuators of a designed controller in C: they compute what the package's do."""

import ctypes
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import ssmr_torch as ssmr
from ssmr_torch.control.actuator import ActuatorState
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.c.compiled_library import FLAGS, compile_library, compiler
from ssmr_torch.deployment.c.controller import write_controller
from ssmr_torch.deployment.c.controller_library import CompiledController, differences
from ssmr_torch.deployment.exported_programs import deploy

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler is at hand")


@pytest.fixture(scope="module")
def built(by_hand, tmp_path_factory):
    """(changes of the actuator) → (CompiledController, CController, folder)."""
    def build(**changes):
        controller, at = by_hand(), tmp_path_factory.mktemp("c")
        actuator = replace(controller.settings.actuator, **changes)
        by_hand(actuator=actuator).save(at / "artifact")
        deploy(at / "artifact", ["c"])
        loaded, deployed = artifact.load(at / "artifact"), at / "artifact" / "deployed"
        written = write_controller(loaded.model, loaded.card, loaded.designed)
        said = compile_library(deployed / "oscillators.c", at / "all.so", FLAGS, deployed / "oscillators_controller.c")
        assert said == ""
        return CompiledController(ctypes.CDLL(str(at / "all.so")), written), written, deployed
    return build


@pytest.mark.parametrize("changes", [
    {}, {"delay": 0, "lag": 0.0, "friction": 0.0, "gain": None}, {"rate": 3.0, "play": 0.03},
    {"offset": (0.01, -0.02, 0.0, 0.03), "delay": 5}], ids=["delay, lag, friction", "trivial", "rate, play", "offset"])
def test_observer_and_actuators_are_the_packages_to_1e_12(built, changes):
    compiled, written, _ = built(**changes)
    assert max(differences(compiled, written, steps=400)) <= 1e-12


def test_the_compiled_observer_agrees_at_outliers_missing_samples_gaps_and_restarts(built):
    compiled, written, _ = built()
    observer, rng, statuses = written.observer, np.random.default_rng(3), []
    observer.reset()
    v = np.full(4, 0.1)
    for k in range(160):
        y = 1e-3 * np.sin(0.1 * k + np.arange(6)) + 1e-5 * rng.standard_normal(6)
        y += (0.5 if k % 40 == 20 else 0.0) + (1.0 if k > 100 else 0.0)  # outliers; then absolute positions for ever
        y[:] = np.nan if k % 30 == 10 else y
        if k == 50:
            observer.forget(), compiled.forget()
        observer.measure(y, v)
        z, d, said = compiled.observe(y, v)
        if said == 3:
            compiled.restart(observer._chart.state()[0])
            z = np.array(compiled.observer.z)
        assert compiled.observer.strange == observer._strange
        statuses.append(said)
        theirs, _, disturbance = observer.state()
        np.testing.assert_allclose(z, theirs, rtol=0, atol=1e-12 * max(1.0, np.abs(theirs).max()))
        np.testing.assert_allclose(d, disturbance, rtol=0, atol=1e-12)
    assert (statuses[10], statuses[20], statuses[50]) == (1, 2, 3) and statuses[100:].count(3) > 0


def test_the_observer_begins_at_rest_when_the_first_sample_is_missing(built):
    compiled, written, _ = built()
    written.observer.reset()
    y = np.array([np.nan, 0.001, 0.0, 0.0, 0.0, 0.002])
    written.observer.measure(y, np.zeros(4))
    z, d, said = compiled.observe(y, np.zeros(4))
    assert said == 1
    np.testing.assert_allclose(np.concatenate([z, d]), np.concatenate(written.observer.state()[::2]), atol=1e-15)


def test_actuators_rest_under_the_given_command(built):
    compiled, written, _ = built(rate=2.0)
    own, command = ActuatorState(written.actuator), np.array([0.3, 0.1, 0.0, 0.5])
    own.rest_at(command), compiled.rest_at(command)
    np.testing.assert_array_equal(compiled.acting, own.acting)
    for _ in range(9):
        own.apply(command), compiled.apply(command)
        np.testing.assert_allclose(compiled.acting, own.acting, rtol=1e-14)


def test_the_files_compile_without_a_warning_under_strict_c99(built):
    _, _, deployed = built()
    strict = [compiler(), "-std=c99", "-O3", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wconversion", "-Wshadow",
              "-Wstrict-prototypes", "-c", "-o", str(deployed / "strict.o"), str(deployed / "oscillators_controller.c")]
    done = subprocess.run(strict, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:2000]
    header = (deployed / "oscillators_controller.h").read_text()
    assert "The quadratic program is not in this file" in header and "OSCILLATORS_GATED = 2" in header
    assert "designed from 2.5 min of recordings" in header and "NAME" not in header


def test_a_controller_with_another_observer_has_the_model_in_c_alone(by_hand, tmp_path):
    by_hand(observer=KalmanObserver, actuator=None).save(tmp_path / "artifact")
    [form] = deploy(tmp_path / "artifact", ["c"])
    assert form.files == ("oscillators.c", "oscillators.h")
    forms = ssmr.load(by_hand().save(tmp_path / "again")).export(tmp_path / "again", "c")
    assert len(forms[0].files) == 4 and forms[0].error <= 1e-12
    assert ssmr.load(tmp_path / "again").controller().facts["minutes"] == 2.5
