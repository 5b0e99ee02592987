"""The training runs in the shape that a selection needs: scaled, in pieces dealt into folds, with starts to score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssmr_torch.models.output_coordinates import OutputCoordinates
from ssmr_torch.turns import Turn

FOLDS = 4
PIECE = 3.0            # s, of a piece that one fold holds out
HORIZONS = (0.05, 0.2, 1.0)
PAST = 20              # samples before a start that any candidate may look at
STARTS, FAST_STARTS = 120, 80
SCOUTED = 4000         # rows of controlled runs, and 60 % of the starts, while most specifications are tried
FITTED = 150           # starts of rollouts that a model is fitted to
MOST = 6000            # rows of controlled runs while specifications are compared
LEAST = 2000           # rows of decays that are kept however few the controlled ones are
STRONGER = 1.25        # inputs beyond the recorded ones, under which the fits are compared


@dataclass(frozen=True)
class Starts:
    """Where rollouts begin: window (N, PAST + 1, p), past (N, PAST, m) and inputs (N, H, m), what follows (N, H, p)."""

    window: np.ndarray
    past: np.ndarray
    inputs: np.ndarray
    follows: np.ndarray

    def __len__(self) -> int:
        return len(self.window)


class Samples:
    """Runs y (T, p) in m, u (T, m), sampled every `timestep` s; u[k] is held from y[k] to y[k + 1].

    coordinates: output coordinates by name, None for the identity. targets: columns of y that are scored.
    turns: symmetries; a copy of every run by each of them takes part in the fits, in the folds of its original, and
    never in what is scored.
    scale: m, root mean square of y; input_mean, input_scale: (m,) of the controlled runs.
    most: rows of the controlled runs that a regression takes, evenly chosen.
    owner, fold: (S,) run and fold of each sample of the runs one after the other, copies last, −1 of decays.
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
        length = max(round(PIECE / self.timestep), 2 * self.past)  # longer than what a row sees, however slow
        for run in range(len(self.decays), len(self.decays) + len(self.controlled)):
            ends = np.linspace(0, self.lengths[run], max(1, int(self.lengths[run]) // length) + 1).astype(int)
            yield from zip(self.first[run] + ends[:-1], self.first[run] + ends[1:])

    def _horizons(self) -> list[int]:
        """Steps of the horizons, shorter ones where no piece is long enough for a second."""
        longest = max(end - begin for begin, end in self.pieces)
        room = max(2, (longest - self.past) // 2)
        steps = [round(seconds / self.timestep) for seconds in HORIZONS]
        if steps[-1] > room:
            steps = [round(step * room / steps[-1]) for step in steps]
        return sorted({max(1, step) for step in steps})

    @property
    def starts_share(self) -> float:
        """Share of the starts that are scored; with few rows, while scouting, fewer of them, too."""
        return 1.0 if self.most >= MOST else 0.6

    @property
    def is_decay(self) -> np.ndarray:
        """(S,) samples of decays."""
        return self.owner % (len(self.decays) + len(self.controlled)) < len(self.decays)

    def whole(self) -> Samples:
        """The same runs, all rows of which a regression takes."""
        return Samples(self.decays, self.controlled, self.timestep, coordinates=self.coordinates,
                       targets=self.targets, past=self.past, most=len(self.y), turns=self.turns)

    def latent(self, name: str) -> np.ndarray:
        """ξ = χ(y) of all samples, scaled, (S, p')."""
        if name not in self._latent:
            chi = self.coordinates[name]
            self._latent[name] = (self.y if chi is None else chi.forward(self.y)) / self.scale
        return self._latent[name]

    def rows(self, ahead: int, decays: bool, copies: bool = True) -> np.ndarray:
        """Samples with `past` before and `ahead` after them in their run, evenly chosen: of the controlled runs at most
        `most`, twice as many where there are copies, and of the decays no more than of these and `most`, for smooth
        motion repeats itself from sample to sample.
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
        """(FOLDS, R) whether a row looks at samples that the fold holds out."""
        seen = [self.fold[rows + shift] for shift in (-self.past, 0, ahead)]
        return np.stack([np.any([each == fold for each in seen], axis=0) for fold in range(FOLDS)])

    def starts(self, samples: np.ndarray, horizon: int) -> Starts:
        """What a rollout from these samples over so many steps needs."""
        samples = np.asarray(samples)[:, None]
        return Starts(self.y[samples + np.arange(-self.past, 1)], self.u[samples + np.arange(-self.past, 0)],
                      self.u[samples + np.arange(horizon)], self.y[samples + np.arange(1, horizon + 1)])

    def held_out(self, fold: int) -> Starts:
        """Starts whose future lies within the pieces of a fold."""
        horizon = self.horizons[-1]
        found = [np.arange(max(begin, self.first[self.owner[begin]] + self.past), end - horizon)
                 for begin, end in self.pieces[fold::FOLDS]]
        samples = np.concatenate([np.empty(0, dtype=int), *found])
        return self.starts(samples[_even(len(samples), round(self.starts_share * STARTS))], horizon)

    def training(self, fold: int) -> Starts:
        """Starts of controlled runs that do not touch a fold's pieces, for rollouts that are fitted; FOLDS: of all."""
        horizon = self.horizons[-1]
        samples = self.rows(horizon, decays=False)
        if fold < FOLDS:
            ends = np.stack([self.fold[samples + shift] for shift in (-self.past, 0, horizon // 2, horizon)])
            samples = samples[(ends != fold).all(0)]
        return self.starts(samples[_even(len(samples), FITTED)], horizon)

    def hurried(self) -> Starts:
        """Starts of all controlled runs whose inputs follow each other twice as fast and are a quarter stronger."""
        horizon = self.horizons[-1]
        samples = self.rows(2 * horizon, decays=False, copies=False)
        if not len(samples):
            samples, horizon = self.rows(horizon, decays=False, copies=False), horizon // 2
        found = self.starts(samples[_even(len(samples), round(self.starts_share * FAST_STARTS))], 2 * horizon)
        inputs = np.ascontiguousarray(STRONGER * found.inputs[:, ::2])
        return Starts(found.window, found.past, inputs, found.follows[:, :horizon])


def _even(size: int, count: int) -> np.ndarray:
    return np.unique(np.linspace(0, size - 1, min(count, size)).astype(int)) if size else np.empty(0, dtype=int)
