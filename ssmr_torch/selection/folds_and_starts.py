"""Training runs prepared for a selection: scaled, cut into pieces, distributed over folds, with starts for scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssmr_torch.models.output_coordinates import OutputCoordinates
from ssmr_torch.symmetry_turns import Turn

FOLDS = 4
PIECE = 3.0            # length in s of a piece that one fold holds out
HORIZONS = (0.05, 0.2, 1.0)
PAST = 20              # number of samples before a start that a candidate may use
STARTS, FAST_STARTS = 120, 80
SCOUTED = 4000         # rows of controlled runs (and 60 % of the starts) for the first scores of all specifications
FITTED = 150           # number of starts of the rollouts in a refinement
MOST = 6000            # rows of controlled runs for the comparison of the best specifications
LEAST = 2000           # rows of decays that are kept even if there are few controlled rows
STRONGER = 1.25        # factor of the inputs for which the fits of the folds are compared


@dataclass(frozen=True)
class Starts:
    """Starts of rollouts: window (N, PAST + 1, p), past inputs (N, PAST, m), inputs (N, H, m) and the measured outputs
    after the start (N, H, p).
    """

    window: np.ndarray
    past: np.ndarray
    inputs: np.ndarray
    follows: np.ndarray

    def __len__(self) -> int:
        return len(self.window)


class Samples:
    """Runs y (T, p) in m, u (T, m), sampled every `timestep` s; u[k] is held from y[k] to y[k + 1].

    coordinates: output coordinates by name, None for the identity. targets: columns of y that are scored.
    turns: symmetries. The fits use a copy of every run turned by each of them, in the fold of the original run. Scores
    never use copies.
    scale: m, root mean square of y; input_mean, input_scale: (m,), mean and spread of the inputs in controlled runs.
    most: number of rows of the controlled runs in a regression, evenly chosen.
    owner, fold: (S,), run and fold of each sample; the runs stand one after the other, copies last; the fold of decays
    is −1.
    """

    def __init__(self, decays: Sequence, controlled: Sequence, timestep: float, *,
                 coordinates: Mapping[str, OutputCoordinates | None], targets: Sequence[int], past: int = PAST,
                 most: int = MOST, turns: Sequence[Turn] = ()):
        self.timestep, self.past, self.targets, self.most = float(timestep), past, list(targets), most
        self.turns, self.coordinates = list(turns), dict(coordinates)
        self.decays, self.controlled = list(decays), list(controlled)
        originals = [*self.decays, *self.controlled]
        runs = [*originals, *(turn.of(run) for turn in turns for run in originals)]
        self.y, self.u = (np.concatenate([run[k] for run in runs]) for k in (0, 1))
        self.output_dim, self.input_dim = self.y.shape[1], self.u.shape[1]
        controlled_y, controlled_u = (np.concatenate([run[k] for run in self.controlled]) for k in (0, 1))
        self.scale = float(np.sqrt(np.mean(controlled_y ** 2)))
        self.input_mean, self.input_scale = controlled_u.mean(0), np.maximum(controlled_u.std(0), 1e-300)
        self.lengths = np.array([len(y) for y, _ in runs])
        self.first = np.concatenate([[0], np.cumsum(self.lengths)[:-1]])
        self.owner = np.repeat(np.arange(len(runs)), self.lengths)
        self.pieces, self.originals = list(self._pieces()), sum(len(y) for y, _ in originals)
        fold = np.full(self.originals, -1)
        for number, (begin, end) in enumerate(self.pieces):
            fold[begin:end] = number % FOLDS
        self.fold = np.tile(fold, 1 + len(self.turns))
        self.horizons = self._horizons()
        self._latent: dict[str, np.ndarray] = {}

    def _pieces(self):
        length = max(round(PIECE / self.timestep), 2 * self.past)  # longer than the samples that a row uses
        for run in range(len(self.decays), len(self.decays) + len(self.controlled)):
            ends = np.linspace(0, self.lengths[run], max(1, int(self.lengths[run]) // length) + 1).astype(int)
            yield from zip(self.first[run] + ends[:-1], self.first[run] + ends[1:])

    def _horizons(self) -> list[int]:
        """Number of steps of each horizon; shorter horizons if no piece is long enough for 1 s."""
        longest = max(end - begin for begin, end in self.pieces)
        room = max(2, (longest - self.past) // 2)
        steps = [round(seconds / self.timestep) for seconds in HORIZONS]
        if steps[-1] > room:
            steps = [round(step * room / steps[-1]) for step in steps]
        return sorted({max(1, step) for step in steps})

    @property
    def starts_share(self) -> float:
        """Share of the starts that are scored; smaller for the first scores, which also use fewer rows."""
        return 1.0 if self.most >= MOST else 0.6

    @property
    def is_decay(self) -> np.ndarray:
        """Whether each sample belongs to a decay, (S,)."""
        return self.owner % (len(self.decays) + len(self.controlled)) < len(self.decays)

    def whole(self) -> Samples:
        """The same runs, with all their rows in a regression."""
        return Samples(self.decays, self.controlled, self.timestep, coordinates=self.coordinates,
                       targets=self.targets, past=self.past, most=len(self.y), turns=self.turns)

    def latent(self, name: str) -> np.ndarray:
        """ξ = χ(y) of all samples, scaled, (S, p')."""
        if name not in self._latent:
            chi = self.coordinates[name]
            self._latent[name] = (self.y if chi is None else chi.forward(self.y)) / self.scale
        return self._latent[name]

    def rows(self, ahead: int, decays: bool, copies: bool = True) -> np.ndarray:
        """Evenly chosen samples that have `past` samples before and `ahead` samples after them in their run.

        Controlled runs give at most `most` of them, or twice as many with copies. Decays give no more than these and no
        more than `most`, because neighbouring samples of a smooth motion contain little new information.
        """
        place = np.arange(len(self.y)) - self.first[self.owner]
        inside = (place >= self.past) & (place + ahead < self.lengths[self.owner])
        if not copies:
            inside[self.originals:] = False
        controlled = np.flatnonzero(inside & ~self.is_decay)
        controlled = controlled[_even(len(controlled), self.most * (2 if self.turns else 1))]
        if not decays:
            return controlled
        of_decays = np.flatnonzero(inside & self.is_decay)
        count = min(max(len(controlled), LEAST), self.most)
        return np.concatenate([of_decays[_even(len(of_decays), count)], controlled])

    def touching(self, rows: np.ndarray, ahead: int) -> np.ndarray:
        """(FOLDS, R), whether a row uses samples that the fold holds out."""
        seen = [self.fold[rows + shift] for shift in (-self.past, 0, ahead)]
        return np.stack([np.any([each == fold for each in seen], axis=0) for fold in range(FOLDS)])

    def starts(self, samples: np.ndarray, horizon: int) -> Starts:
        """The starts at these samples, for rollouts over `horizon` steps."""
        samples = np.asarray(samples)[:, None]
        return Starts(self.y[samples + np.arange(-self.past, 1)], self.u[samples + np.arange(-self.past, 0)],
                      self.u[samples + np.arange(horizon)], self.y[samples + np.arange(1, horizon + 1)])

    def held_out(self, fold: int) -> Starts:
        """Starts whose future lies within the pieces that a fold holds out."""
        horizon = self.horizons[-1]
        found = [np.arange(max(begin, self.first[self.owner[begin]] + self.past), end - horizon)
                 for begin, end in self.pieces[fold::FOLDS]]
        samples = np.concatenate([np.empty(0, dtype=int), *found])
        return self.starts(samples[_even(len(samples), round(self.starts_share * STARTS))], horizon)

    def training(self, fold: int) -> Starts:
        """Starts of controlled runs that do not touch a fold's pieces, for the refinement; fold FOLDS: all starts."""
        horizon = self.horizons[-1]
        samples = self.rows(horizon, decays=False)
        if fold < FOLDS:
            ends = np.stack([self.fold[samples + shift] for shift in (-self.past, 0, horizon // 2, horizon)])
            samples = samples[(ends != fold).all(0)]
        return self.starts(samples[_even(len(samples), FITTED)], horizon)

    def hurried(self) -> Starts:
        """Starts of all controlled runs, with inputs that are twice as fast and 1.25 times larger."""
        horizon = self.horizons[-1]
        samples = self.rows(2 * horizon, decays=False, copies=False)
        if not len(samples):
            samples, horizon = self.rows(horizon, decays=False, copies=False), horizon // 2
        found = self.starts(samples[_even(len(samples), round(self.starts_share * FAST_STARTS))], 2 * horizon)
        inputs = np.ascontiguousarray(STRONGER * found.inputs[:, ::2])
        return Starts(found.window, found.past, inputs, found.follows[:, :horizon])


def _even(size: int, count: int) -> np.ndarray:
    return np.unique(np.linspace(0, size - 1, min(count, size)).astype(int)) if size else np.empty(0, dtype=int)
