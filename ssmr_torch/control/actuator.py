"""The actuator between a command and the input that acts on the robot: play, friction, delay, lag, gain."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np

from ssmr_torch.control.condensing import compiled
from ssmr_torch.settings import Settings, non_negative, positive, whole

# Part of an input's range that is added to the width of the crossing, so that it is never zero.
LEAST_WIDTH = 1e-3


@dataclass(frozen=True)
class Actuator(Settings):
    """From command u to acting input v, for each input and sample k, timestep h, starting at rest at the first command:

        T_k = clip(T_{k−1}, low(u_k), high(u_k)),       low, high = u e^{∓friction} ∓ play · range, in order,
        r_k = clip(T_k, r_{k−1} ∓ rate h · range),
        x_k = share x_{k−1} + (1 − share) r_{k−d},      share = e^{−h / lag},  d = delay,
        v_k = gain x_k + offset · range.

    T has a hysteresis: the play of gears and cables, and the friction of a cable, μθ of the capstan equation, around
    zero force [Kaneko et al., ICRA 1991].

    timestep: h, s.   input_range: (m,), highest minus lowest input.
    delay: samples, with the delay of the sensors.   lag: s, of first order.   play: half of its width, as a share of
    the input range.   friction: μθ, 1.   rate: input ranges per s; None: no limit.   ease: part of the play's width in
    which the command crosses it proportionally; a smaller value would turn noise into large steps.
    gain: (m,) 1; None: one.   offset: (m,), as a share of the input range; None: zero.
    Raises ValueError for impossible numbers.
    """

    timestep: float
    input_range: tuple[float, ...]
    delay: int = 0
    lag: float = 0.0
    play: float = 0.0
    friction: float = 0.0
    rate: float | None = None
    ease: float = 1.0
    gain: tuple[float, ...] | None = None
    offset: tuple[float, ...] | None = None

    def __post_init__(self):
        self._set("timestep", positive("timestep", self.timestep, "s"))
        if np.ndim(self.input_range) != 1:
            raise ValueError(f"input_range of an actuator is {self.input_range}; expected one number for each input")
        self._set("delay", whole("delay", self.delay, least=0))
        for name, unit in (("lag", "s"), ("play", ""), ("friction", "")):
            self._set(name, non_negative(name, getattr(self, name), unit))
        self._set("ease", positive("ease", self.ease))
        if self.rate is not None:
            self._set("rate", positive("rate", self.rate, "1/s"))
        for name in ("input_range", "gain", "offset"):
            given = getattr(self, name)
            if given is None:
                continue
            values = np.array(given, dtype=np.float64)
            if values.shape != (len(self.input_range),) or not np.isfinite(values).all() \
                    or (name != "offset" and not (values > 0).all()):
                raise ValueError(f"{name} of an actuator is {given}; expected {len(self.input_range)} finite numbers"
                                 f"{'' if name == 'offset' else ', all positive'}, one for each input")
            self._set(name, tuple(values.tolist()))

    @property
    def trivial(self) -> bool:
        """Whether the acting inputs equal the commands."""
        return not (self.delay or self.lag or self.rubs or self.rate or self.gain or self.offset)

    @property
    def rubs(self) -> bool:
        """Whether there is play or friction."""
        return self.play > 0 or self.friction > 0

    @cached_property
    def share(self) -> float:
        """The part of a lag that remains after one sample, e^{−h / lag}."""
        return float(np.exp(-self.timestep / self.lag)) if self.lag else 0.0

    @cached_property
    def factor(self) -> np.ndarray:
        """The gain as an array (m,)."""
        return np.ones(len(self.input_range)) if self.gain is None else np.array(self.gain)

    @cached_property
    def shift(self) -> np.ndarray:
        """The offset (m,) in the unit of the inputs."""
        return np.zeros(len(self.input_range)) if self.offset is None else self.offset * self._range

    @cached_property
    def _range(self) -> np.ndarray:
        return np.array(self.input_range)

    @cached_property
    def stride(self) -> np.ndarray:
        """(m,), the largest change per sample that the rate allows; infinite without a limit."""
        return np.full(len(self.input_range), np.inf) if self.rate is None else self.rate * self.timestep * self._range

    @cached_property
    def _half(self) -> np.ndarray:
        return self.play * self._range

    def plain(self) -> dict:
        """The settings as plain JSON values."""
        return asdict(self)

    def acting(self, commands: np.ndarray) -> np.ndarray:
        """Acting inputs v (T, m) for commands (T, m), starting at rest at the first one."""
        commands = np.ascontiguousarray(commands, dtype=np.float64)
        return _acting(commands, self.delay, self.share, self._half, self.friction, self.stride, self.factor,
                       self.shift)

    def transmitted(self, held: np.ndarray, command: np.ndarray) -> np.ndarray:
        """T after a command (m,), where T was `held` (m,) before."""
        if not self.rubs:
            return np.array(command, dtype=np.float64)
        low, high = self._edges(command)
        return np.minimum(np.maximum(held, low), high)

    def crossing(self, held: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """The command (m,) that transmits `wanted` (m,) where T was `held` (m,). It is smooth near `held`."""
        if not self.rubs:
            return np.array(wanted, dtype=np.float64)
        width = self.ease * (self._half + self.friction * np.abs(wanted)) + LEAST_WIDTH * self._range
        push = np.clip((wanted - held) / width, -1.0, 1.0)
        pulled = wanted + push * self._half
        return pulled * np.exp(self.friction * push * np.sign(pulled))

    def reachable(self, bounds: np.ndarray) -> np.ndarray:
        """Bounds (2, m) of what can be transmitted from both sides by commands within bounds (2, m)."""
        if not self.rubs:
            return np.array(bounds, dtype=np.float64)
        slip = np.exp(self.friction)
        lower, upper = np.array(bounds, dtype=np.float64)
        lower = np.where(lower > 0, lower * slip, lower / slip) + self._half
        upper = np.where(upper > 0, upper / slip, upper * slip) - self._half
        middle = 0.5 * (lower + upper)
        return np.stack([np.minimum(lower, middle), np.maximum(upper, middle)])

    def _edges(self, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        less, more = command * np.exp(-self.friction), command * np.exp(self.friction)
        return np.minimum(less, more) - self._half, np.maximum(less, more) + self._half


class ActuatorState:
    """The state of an `Actuator` from sample to sample.

    transmitted: (m,), T of the last command.   acting: (m,), the v that is held until the next sample.
    """

    def __init__(self, actuator: Actuator):
        self.actuator = actuator
        self.rest_at(np.zeros(len(actuator.input_range)))

    def rest_at(self, command: np.ndarray) -> None:
        """Set the state that a constant command (m,) leads to."""
        command = np.array(command, dtype=np.float64)
        self.transmitted, self._limited, self._lagged = command, command, command.copy()
        self._queue = [command] * self.actuator.delay
        self.acting = self.actuator.factor * command + self.actuator.shift

    def apply(self, command: np.ndarray) -> None:
        """Give the command (m,) of this sample. `acting` is then the input that acts until the next sample."""
        actuator = self.actuator
        self.transmitted = actuator.transmitted(self.transmitted, command)
        self._limited = np.minimum(np.maximum(self.transmitted, self._limited - actuator.stride),
                                   self._limited + actuator.stride)
        self._queue.append(self._limited)
        self._lagged = actuator.share * self._lagged + (1.0 - actuator.share) * self._queue.pop(0)
        self.acting = actuator.factor * self._lagged + actuator.shift

    def decided(self) -> tuple[np.ndarray, np.ndarray]:
        """The effect of the commands so far: acting inputs (d, m) of the next d samples, and x after them."""
        x, found = self._lagged, np.empty((len(self._queue), len(self._lagged)))
        for k, transmitted in enumerate(self._queue):
            x = self.actuator.share * x + (1.0 - self.actuator.share) * transmitted
            found[k] = self.actuator.factor * x + self.actuator.shift
        return found, x


@compiled
def _acting(u, delay, share, half, friction, stride, gain, shift):
    T, m = u.shape
    out = np.empty_like(u)
    less, more = np.exp(-friction), np.exp(friction)
    line = np.empty(T)
    for j in range(m):
        held = limited = x = u[0, j]
        for k in range(T):
            low, high = u[k, j] * less, u[k, j] * more
            if low > high:
                low, high = high, low
            held = min(max(held, low - half[j]), high + half[j])
            limited = min(max(held, limited - stride[j]), limited + stride[j])
            line[k] = limited
            x = share * x + (1.0 - share) * (line[k - delay] if k >= delay else u[0, j])
            out[k, j] = gain[j] * x + shift[j]
    return out


@compiled
def lagged(commands, start, share, gain, shift):
    """v (N, m) for transmitted inputs (N, m), where x before them is `start` (m,)."""
    out = np.empty_like(commands)
    for j in range(commands.shape[1]):
        x = start[j]
        for k in range(len(commands)):
            x = share * x + (1.0 - share) * commands[k, j]
            out[k, j] = gain[j] * x + shift[j]
    return out


def lag_matrix(actuator: Actuator, horizon: int) -> np.ndarray:
    """∂v/∂T (N m, N m) of N samples: (1 − share) share^{i−j} gain for i ≥ j."""
    step = np.subtract.outer(np.arange(horizon), np.arange(horizon))
    weights = np.where(step >= 0, (1.0 - actuator.share) * float(actuator.share)**np.maximum(step, 0), 0.0)
    return np.kron(weights, np.diag(actuator.factor))
