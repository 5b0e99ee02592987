"""A robot of three damped oscillators with known actuators and known noises, and its recordings."""

import numpy as np
from scipy.linalg import expm

import ssmr_torch as ssmr

H = 0.02                                                     # s, between samples
FREQUENCIES, DAMPING = np.array([7.0, 8.5, 11.0]), 0.35      # rad/s
SIGNED, PULL, MIXED = (np.array(bounds, dtype=float) for bounds in (
    [[-1.0, -1.0], [1.0, 1.0]], [[0.0] * 4, [1.5] * 4], [[0.0, -1.0, 0.0], [1.5, 1.0, 1.2]]))
# m per unit of input at rest, of x, y, z
STATIC = {2: [[0.030, 0.004], [-0.003, 0.028], [0.008, 0.006]],
          3: [[0.022, 0.002, -0.021], [0.002, 0.028, 0.001], [0.005, 0.007, 0.004]],
          4: [[0.020, 0.001, -0.020, 0.0], [0.0, 0.021, 0.0, -0.020], [0.005, 0.004, 0.005, 0.006]]}


class Actuators:
    """Hysteresis, then a delay, samples, then a lag, s; play: half of its width, of the range; friction: μθ."""

    def __init__(self, bounds, start, delay=0, lag=0.0, play=0.0, friction=0.0):
        self.half, self.slip = play * np.ptp(bounds, axis=0), friction
        self.share = np.exp(-H / lag) if lag else 0.0
        self.held = self.acts = np.array(start, dtype=float)
        self.late = [self.held] * delay

    def __call__(self, command):
        slack = np.exp(self.slip * np.sign(command))
        self.held = np.clip(self.held, command / slack - self.half, command * slack + self.half)
        self.late = [*self.late, self.held]
        self.acts = self.share * self.acts + (1.0 - self.share) * self.late.pop(0)
        return self.acts


class Oscillators:
    """d²y/dt² = ω² (G v − y − c |y|² y) − 2 ζ ω dy/dt, v held over a sample: a plant for closed loops, in metres.

    Its sensors see y, and dy/dt / ω as well: the state, so that nothing of a past input is hidden in it.
    cubic: c, 1/m²; without it the samples are exact.   of_inputs, of_sensor: deviations of the noises, of half the
    range and in m.   gain: (m,) of what acts.   hangs: (6,) m, by which all measurements are displaced.
    scale: of the inputs and their bounds, as in another unit.   pace: of ω.   damping: ζ.
    Other settings are those of the `Actuators`.
    """

    timestep, name, input_unit = H, "oscillators", "N"
    output_names = ("x", "y", "z", "rate_x", "rate_y", "rate_z")

    def __init__(self, bounds=SIGNED, *, cubic=0.0, of_inputs=0.0, of_sensor=0.0, gain=1.0, hangs=0.0, scale=1.0,
                 pace=1.0, damping=DAMPING, **actuators):
        self.input_bounds, self.cubic, self.actuators, self.scale = scale * bounds, cubic, actuators, scale
        self.input_names = tuple(f"u{k + 1}" for k in range(bounds.shape[1]))
        self.of_inputs, self.of_sensor = of_inputs * 0.5 * np.ptp(bounds, axis=0), of_sensor
        self.gain, self.hangs = np.broadcast_to(gain, bounds.shape[1]), np.broadcast_to(hangs, 6)
        self.static = np.array(STATIC[bounds.shape[1]])
        w = pace * FREQUENCIES
        self.per = np.concatenate([np.ones(3), w])
        A = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.diag(w**2), -2.0 * damping * np.diag(w)]])
        step = expm(H * np.block([[A, np.vstack([np.zeros((3, 3)), np.diag(w**2)])], [np.zeros((3, 9))]]))
        self.A, self.force = step[:6, :6], step[:6, 6:]
        self.reset()

    def reset(self, seed=0, start=np.zeros(6)):  # noqa: B008
        self._rng, self.x = np.random.default_rng(seed), np.array(start)
        neutral = np.clip(0.0, *self.input_bounds) / self.scale
        self._act = Actuators(self.input_bounds / self.scale, neutral, **self.actuators)
        return self._seen()

    def step(self, command):
        v = self.gain * self._act(np.asarray(command) / self.scale)
        v = v + self.of_inputs * self._rng.standard_normal(len(v))
        y = self.x[:3]
        self.x = self.A @ self.x + self.force @ (self.static @ v - self.cubic * (y @ y) * y)
        return self._seen()

    @property
    def displacement(self):
        return self.x / self.per + self.hangs

    def _seen(self):
        return self.displacement + self.of_sensor * self._rng.standard_normal(6)


def dithered(robot, seconds, rng):
    """Inputs (T, m) over their bounds: some held for a third of a second, some slow waves, and dither."""
    lower, upper = robot.input_bounds
    T, m = round(seconds / H), len(lower)
    held = np.repeat(rng.uniform(-0.6, 0.6, (T // 16 + 1, m)), 16, axis=0)[:T]
    waves = 0.3 * np.sin(2 * np.pi * (H * np.arange(T)[:, None] * rng.uniform(0.1, 0.6, m) + rng.uniform(0, 1, m)))
    share = np.clip(held + waves + 0.08 * rng.standard_normal((T, m)), -1.0, 1.0)
    return 0.5 * (lower + upper) + 0.5 * (upper - lower) * share


def driven(robot, inputs, start=np.zeros(6), seed=0):  # noqa: B008
    """Outputs (T, 6) under inputs (T, m); the last input acts after the last sample."""
    outputs = [robot.reset(seed, start)]
    outputs += [robot.step(u) for u in inputs[:-1]]
    return np.array(outputs)


def recordings(robot, *, runs=5, seconds=24.0, decays=4, seed=0, test=1):
    """A dataset of decays, and of runs under `dithered` inputs, the last `test` of them for testing."""
    rng = np.random.default_rng(seed)
    neutral = np.clip(0.0, *robot.input_bounds)
    of_decays = []
    for k in range(decays):
        inputs = np.tile(neutral, (120, 1))
        start = np.concatenate([0.02 * rng.standard_normal(3), np.zeros(3)])
        of_decays.append((H, driven(robot, inputs, start, 100 + k), inputs))
    controlled = []
    for k in range(runs + test):
        inputs = dithered(robot, seconds, rng)
        inputs[0] = neutral
        controlled.append((H, driven(robot, inputs, seed=k), inputs))
    return ssmr.trajectories(decays=of_decays, controlled=controlled[:runs], test=controlled[runs:],
                             output_names=robot.output_names, input_names=robot.input_names,
                             units={"length": "m", "input": "N", "time": "s"})
