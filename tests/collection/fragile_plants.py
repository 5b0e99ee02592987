"""Plants that break, in a module of their own because the processes that record must be able to import it."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import RandomSteps


class FragilePlant:
    """x⁺ = 0.9 x + 0.1 gain u in two directions; the force U(0, 1) breaks it above 0.95 while `mishap` says so.

    log: gets a line for every run that begins, the process that runs it. delay: s per step.
    mishap: a file with "raise" or "kill" in it, or none.
    """

    name, input_unit, input_names, output_names = "fragile", "N", ("a", "b"), ("x", "y")
    timestep, rest = 0.01, np.zeros(2)
    input_bounds = np.array([[0.0, 0.0], [1.0, 1.0]])

    def __init__(self, log: Path, delay: float = 0.0, gain: float = 1.0):
        self.log, self.mishap, self.delay, self.gain = Path(log), Path(log).with_suffix(".mishap"), delay, gain
        self.state = np.zeros(2)

    @property
    def parameters(self):
        return {"gain": self.gain}

    @property
    def displacement(self):
        return self.state.copy()

    def reset(self, seed=None, state=None):
        with open(self.log, "a") as file:
            file.write(f"{os.getpid()}\n")
        self.state = np.zeros(2) if state is None else np.array(state)
        return self.displacement

    def step(self, input):
        time.sleep(self.delay)
        if input.max() > 0.95 and self.mishap.exists():
            if self.mishap.read_text() == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            raise ValueError("the arm broke")
        self.state = 0.9 * self.state + 0.1 * self.gain * np.asarray(input)
        return self.displacement

    def runs(self) -> list[int]:
        """The processes of all runs so far, one entry per run."""
        return [int(line) for line in self.log.read_text().split()] if self.log.exists() else []


class ThreadCountingPlant(FragilePlant):
    """Observes how many threads its arithmetic may use."""

    def step(self, input):
        from threadpoolctl import threadpool_info

        return np.full(2, max(library["num_threads"] for library in threadpool_info()))


class UnknownPlant(FragilePlant):
    """Does not say with which parameters it was built."""

    parameters = property()


class ProcessBoundPlant(FragilePlant):
    """Holds something that cannot leave its process."""

    def __init__(self, log: Path):
        super().__init__(log)
        self.clock = lambda: 0.0


def small(plant, **changes):
    """Six short runs, the four decays (140 samples with their ramps) longer than the two others (30)."""
    settings = {"decays": 3, "validation_decays": 1, "test_decays": 0, "decay_duration": 0.4, "noise_std": 1e-5,
                "controlled": (ControlledRun("steps", RandomSteps(0.1, share=0.9), 0.3, repeats=2),), "seed": 3,
                "progress": False}
    return collect(plant, **(settings | changes))
