"""Estimates delay, lag, play, gains and offsets again from some seconds of operation. The model does not change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.controller_design.identification import LAGS, in_words
from ssmr_torch.controller_design.recordings import Piece
from ssmr_torch.models.batch_rollout import batch_of

STEPS, STRIDE = 20, 3            # samples of the predictions, and samples between two starts
PLAYS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05)
FRICTIONS = (0.0, 0.05, 0.08, 0.1, 0.12, 0.15, 0.2, 0.25)
MORE_DELAY = 6                   # samples, more than in the design
ROUNDS = 6
GAIN = 0.97                      # a change is accepted if the error is below this times the error without it
UNEXPLAINED = 0.5                # gains, which overfit, are tried only if other changes leave more of the error
PULL = 1e-5                      # regularization of gains towards one and of offsets towards zero
PROBE = 0.01
GAINS, OFFSETS = (0.3, 2.0), (-0.25, 0.25)
LEAST = 5.0                      # s of operation that are needed
RETURNED = 1.5                   # largest accepted error, as a multiple of the design's own error
MOVED = 0.02                     # of the input range: largest change per sample that the records must reach


@dataclass(frozen=True)
class Readjustment:
    """actuator: the one that explains the records best.   before, after: rms errors of predictions over 1 … 20 samples
    of the tracked outputs, as a share of the design's reach, with the controller's own actuator and with this one.
    accepted: whether the new one is used.   words: the reason.
    """

    actuator: Actuator
    before: float
    after: float
    accepted: bool
    words: str


class _Search:
    """Prediction errors along the records for an actuator. A diverged rollout counts as an error of the whole reach."""

    def __init__(self, model, pieces: Sequence[Piece], tracked: Sequence[int], reach: float):
        self.model, self.batch, self.tracked, self.reach = model, batch_of(model), list(tracked), reach
        self.pieces = pieces
        self.known: dict[Actuator, np.ndarray] = {}

    def errors(self, actuator: Actuator) -> np.ndarray:
        """(starts · STEPS · q,), as a share of the reach."""
        if actuator not in self.known:
            found, d = [], self.model.delays
            for piece in self.pieces:
                acting = actuator.acting(piece.input)
                start = np.arange(d, len(acting) - STEPS, STRIDE)
                back, ahead = start[:, None] + np.arange(-d, 1), start[:, None] + np.arange(STEPS)
                follows = piece.observation[start[:, None] + np.arange(1, STEPS + 1)][:, :, self.tracked]
                whole = np.isfinite(piece.observation[back]).all((1, 2)) & np.isfinite(follows).all((1, 2))
                z = self.model.encode(piece.observation[back[whole]], acting[back[whole][:, :-1]])
                outputs = self.batch.outputs(z, acting[ahead[whole]])[:, :, self.tracked]
                found.append(np.clip(np.nan_to_num((outputs - follows[whole]) / self.reach, nan=1.0), -1.0, 1.0))
            self.known[actuator] = np.concatenate(found).ravel()
        return self.known[actuator]

    def error(self, actuator: Actuator) -> float:
        return float(np.sqrt(np.square(self.errors(actuator)).mean()))

    def moves(self, actuator: Actuator, most_delay: int) -> list[Actuator]:
        """All actuators that differ in delay and lag, in play, or in friction."""
        h = actuator.timestep
        found = [replace(actuator, delay=delay, lag=lag * h) for delay in range(most_delay + 1) for lag in LAGS]
        found += [replace(actuator, play=play) for play in PLAYS]
        return found + [replace(actuator, friction=friction) for friction in FRICTIONS if actuator.friction or friction]

    def bent(self, actuator: Actuator, gains: bool, steps: int = 3) -> Actuator:
        """The actuator with the offsets, and on request the gains, of least error, by Gauss-Newton steps."""
        m = len(actuator.input_range)
        offset = np.zeros(m) if actuator.offset is None else np.array(actuator.offset)
        values = np.concatenate([actuator.factor, offset])
        moving = range(2 * m) if gains else range(m, 2 * m)
        usual = np.repeat([1.0, 0.0], m)
        for _ in range(steps):
            here = self.errors(_with(actuator, values))
            J = np.stack([(self.errors(_with(actuator, values + PROBE * np.eye(2 * m)[k])) - here) / PROBE
                          for k in moving], axis=1)
            normal = J.T @ J
            weight = PULL * np.trace(normal) / len(normal)
            pull = weight * (values - usual)[list(moving)]
            step = np.linalg.solve(normal + weight * np.eye(len(normal)), J.T @ here + pull)
            values[list(moving)] -= step
            values[:m], values[m:] = np.clip(values[:m], *GAINS), np.clip(values[m:], *OFFSETS)
        return _with(actuator, values)


def _with(actuator: Actuator, values: np.ndarray) -> Actuator:
    m = len(actuator.input_range)
    return replace(actuator, gain=tuple(values[:m].tolist()), offset=tuple(values[m:].tolist()))


def operation_error(model, actuator: Actuator, recordings) -> float:
    """The design's error on its own held-out runs, measured as in `Readjustment`, as a share of the reach."""
    return _Search(model, recordings.held, recordings.tracked, recordings.reach).error(actuator)


def readjustment(controller, records, *, expected: float | None = None, fixed_friction: bool = False,
                 say: Callable[[str], None] = lambda line: None) -> Readjustment:
    """The actuator that explains records of the working controller best. The model stays as it is.

    A greedy search: it takes the change of delay and lag, play, friction or offsets that explains most, until none
    explains 3 % more. Gains come last, because they overfit, and are pulled towards one. The result is accepted only
    if it predicts the records nearly as well as the design predicted its held-out runs.

    records: one `ClosedLoopRecord` or more, about 12 s together, with fast motion or dither; a slow circle does not
    show a delay.   expected: share of the reach, error of the design on held-out runs over the same samples; None: the
    one in its facts.   fixed_friction: True leaves cable friction out, as for inputs that push and pull.
    Raises ValueError where the records are too short, do not move, or are of another robot.
    """
    records = [records] if hasattr(records, "measurement") else list(records)
    pieces = [_piece(record, controller) for record in records]
    _check(pieces, controller)
    tracked = controller.task.columns(records[0].output_names)
    facts = getattr(controller, "facts", {})
    expected = facts.get("operation_error") if expected is None else expected
    reach = facts.get("reach") or float(max(np.nanmax(np.linalg.norm(piece.observation[:, list(tracked)], axis=1))
                                            for piece in pieces))
    search = _Search(controller.model, pieces, tracked, reach)
    best = begin = controller.actuator.actuator
    most = begin.delay + MORE_DELAY
    for _ in range(ROUNDS):
        moves = [each for each in search.moves(best, most) if not (fixed_friction and each.friction)]
        moves.append(search.bent(best, gains=False))
        move = min(moves, key=search.error)
        if search.error(move) > UNEXPLAINED * search.error(best):
            move = min([move, search.bent(best, gains=True)], key=search.error)
        if search.error(move) > GAIN * search.error(best):
            break
        best = move
        say(f"{in_words(best)}: error {100 * search.error(best):.3g} %")
    before, after = search.error(begin), search.error(best)
    return _judged(best, begin, before, after, expected)


def _judged(best: Actuator, begin: Actuator, before: float, after: float, expected: float | None) -> Readjustment:
    numbers = (f"the prediction error on the records was {100 * before:.3g} % of the reach before, and is "
               f"{100 * after:.3g} % now")
    if best == begin:
        return Readjustment(begin, before, after, False, f"no change explains the records better; {numbers}")
    if expected is not None and after > RETURNED * expected:
        return Readjustment(best, before, after, False, f"{numbers}; on held-out runs the design had "
                            f"{100 * expected:.3g} %. Something else has changed: record and design again")
    return Readjustment(best, before, after, True, f"{in_words(best)}; {numbers}")


def _piece(record, controller) -> Piece:
    if record.measurement.shape[1] != controller.model.output_dim or \
            record.input.shape[1] != controller.model.input_dim:
        raise ValueError(f"the record has {record.measurement.shape[1]} outputs and {record.input.shape[1]} inputs; "
                         f"expected {controller.model.output_dim} and {controller.model.input_dim}, as the controller")
    return Piece(np.asarray(record.measurement), np.asarray(record.input), False)


def _check(pieces: Sequence[Piece], controller) -> None:
    seconds = sum(len(piece.input) for piece in pieces) * controller.timestep
    if seconds < LEAST:
        raise ValueError(f"the records last {seconds:.3g} s; expected {LEAST:g} s of operation or more, best about "
                         "12 s with fast motion")
    span = np.ptp(np.concatenate([piece.input for piece in pieces]), axis=0) / np.ptp(controller.input_bounds, axis=0)
    if span.max() < MOVED:
        raise ValueError(f"the inputs of the records change by at most {100 * span.max():.3g} % of their range; "
                         f"expected {100 * MOVED:g} % or more: record a task that moves the robot")
