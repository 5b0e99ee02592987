"""The data of one experiment, served to Lightning."""

from __future__ import annotations

from dataclasses import replace

import lightning
import numpy as np
from torch.utils.data import DataLoader, RandomSampler, Subset

from ssmr_torch.data.starts import ScoredRuns, starts_over
from ssmr_torch.data.windows import RolloutDataset, SegmentDataset, SegmentShare, stack_rollouts
from ssmr_torch.periods import whole_multiple
from ssmr_torch.trajectory import TrajectoryDataset


class TrajectoryDataModule(lightning.LightningDataModule):
    """Segments for closed-form fits, rollouts for gradient fits, the same validation and test starts for both.

    Static set points are no dynamics; only a procedure that asks for them (`takes_static`) is served those of training.
    validation_share: tail of every controlled training run that is held out when no run is marked "validation".
    transient: s cut from the start of each training decay. rows: core samples per segment.
    rollout_horizon, validation_horizon: s. starts: seeded validation and test starts. batch_size: rollouts per step.
    decays, controlled_duration: how many of the training decays, and how many s of the controlled training, from its
    start, are used; None for all. noise_std: m, of seeded white noise on the training runs and on the windows that
    validation and test predictions start from; what they are compared with stays as it is. score_test: whether the
    test runs are looked at. overdrive, overspeed: see `ModelFit`.
    Call `prepare(fit)` before training: it learns the delays and context that the fit needs.
    """

    def __init__(self, dataset: TrajectoryDataset, *, validation_share: float = 0.1, transient: float = 0.0,
                 rows: int = 1024, rollout_horizon: float = 0.4, validation_horizon: float = 1.0, starts: int = 500,
                 batch_size: int = 64, stride: int = 5, seed: int = 0, num_workers: int = 0,
                 decays: int | None = None, controlled_duration: float | None = None, noise_std: float = 0.0,
                 score_test: bool = True, overdrive: float = 1.0, overspeed: int = 1):
        super().__init__()
        if not 0 <= validation_share < 1:
            raise ValueError(f"validation_share is {validation_share}; expected 0 ≤ share < 1")
        if not (rollout_horizon > 0 and validation_horizon > 0 and transient >= 0):
            raise ValueError(f"rollout_horizon {rollout_horizon} s, validation_horizon {validation_horizon} s and "
                             f"transient {transient} s; the horizons must be positive, the transient not negative")
        self.dataset = dataset
        self.transient, self.rows, self.starts = float(transient), int(rows), int(starts)
        self.rollout_horizon, self.validation_horizon = float(rollout_horizon), float(validation_horizon)
        self.batch_size, self.stride, self.seed, self.num_workers = batch_size, stride, seed, num_workers
        if not noise_std >= 0:
            raise ValueError(f"noise_std is {noise_std} m; expected zero or more")
        if not overdrive >= 1:
            raise ValueError(f"overdrive is {overdrive}; expected 1 or more")
        if not (overspeed >= 1 and overspeed == int(overspeed)):
            raise ValueError(f"overspeed is {overspeed}; expected a whole number, 1 or more")
        self.noise_std, self.overdrive, self.overspeed = float(noise_std), float(overdrive), int(overspeed)
        training, self.validation = _hold_out(dataset, validation_share)
        training = _limited(training, decays, controlled_duration)
        self.training = tuple(_noisy(run, noise_std, (seed, number)) for number, run in enumerate(training))
        test = dataset.select(split="test") if score_test else ()
        self.test = tuple(run for run in test if run.kind != "static")
        self.static = dataset.select(split="train", kind="static")
        self.procedure, self.delays, self.sampling = None, 0, 1
        self.drawn_horizon, self.drawn_starts = self.rollout_horizon, None

    def prepare(self, fit) -> TrajectoryDataModule:
        """Serve what this fit needs: segments when it is closed-form, rollouts otherwise; of its own `horizon` in s
        and as many, drawn anew each epoch, as its `starts`, where it has these.

        Raises ValueError here, before any fit, when runs are too short for its delays and the horizons.
        """
        self.procedure, self.delays = getattr(fit, "procedure", None), fit.model.delays
        self.sampling = whole_multiple("the model's timestep", fit.model.timestep, "the data's sampling time",
                                       self.dataset.timestep, "change model.timestep, or resample the data")
        if hasattr(self.procedure, "sampled_every"):
            self.procedure.sampled_every(self.dataset.timestep)
        self.drawn_horizon = getattr(fit, "horizon", self.rollout_horizon)
        self.drawn_starts = getattr(fit, "starts", None)
        for build in (self.train_dataloader, self.val_dataloader, self.test_dataloader):
            build()
        return self

    def train_dataloader(self) -> DataLoader:
        if self.procedure is None:
            data = self._share(self._rollouts())
            if self.drawn_starts and self.drawn_starts < len(data):
                sampler = RandomSampler(data, num_samples=self.drawn_starts)
                return DataLoader(data, self.drawn_starts, sampler=sampler, collate_fn=stack_rollouts,
                                  num_workers=self.num_workers)
            return DataLoader(data, self.batch_size, shuffle=True, collate_fn=stack_rollouts,
                              drop_last=len(data) > self.batch_size, num_workers=self.num_workers)
        static = self.static if getattr(self.procedure, "takes_static", False) else ()
        data = SegmentDataset(self.training + static, before=self.procedure.before, after=self.procedure.after,
                              rows=self.rows, transient=self.transient)
        return DataLoader(self._share(data), batch_size=None, shuffle=False, num_workers=self.num_workers)

    def val_dataloader(self) -> list | DataLoader:
        return self._scored(self.validation)

    def test_dataloader(self) -> list | DataLoader:
        return self._scored(self.test)

    def transfer_batch_to_device(self, batch, device, dataloader_index):
        return batch.to(device)

    def _scored(self, trajectories: tuple) -> list | DataLoader:
        if not trajectories:
            return []
        starts_over([run.length for run in trajectories], self.validation_horizon, self.dataset.timestep, self.sampling,
                    margin=max(1, self.delays * self.sampling), count=self.starts, seed=self.seed)
        runs = tuple(run.read() for run in trajectories)
        seen = tuple(_noisy(run, self.noise_std, (self.seed, 1, number)) for number, run in enumerate(runs))
        return DataLoader([ScoredRuns(runs, seen, self.validation_horizon, self.starts, self.seed)], batch_size=None)

    def _rollouts(self) -> RolloutDataset:
        steps = max(round(self.drawn_horizon / (self.dataset.timestep * self.sampling)), 1)
        return RolloutDataset(self.training, delays=self.delays, horizon=steps, stride=self.stride,
                              transient=self.transient, sampling=self.sampling)

    def _share(self, data):
        """This process's part: each segment in exactly one process; of rollouts, equally many in each."""
        trainer = self.trainer
        if trainer is None or trainer.world_size == 1:
            return data
        if len(data) < trainer.world_size:
            raise ValueError(f"{len(data)} items for {trainer.world_size} processes; use fewer processes or "
                             "smaller `rows`")
        if isinstance(data, SegmentDataset):
            return SegmentShare(data, trainer.global_rank, trainer.world_size)
        # processes step together: one with a batch more than another would wait for it for ever
        even = len(data) - len(data) % trainer.world_size
        return Subset(data, range(trainer.global_rank, even, trainer.world_size))


def _limited(training: tuple, decays: int | None, duration: float | None) -> tuple:
    """The first `decays` decays, and runs of other kinds until `duration` s are reached."""
    if (decays is not None and decays < 0) or (duration is not None and duration < 0):
        raise ValueError(f"decays {decays} and controlled_duration {duration} s; expected zero or more, or null")
    kept, counted, left = [], 0, float("inf") if duration is None else duration
    for run in training:
        if run.kind == "decay":
            counted += 1
            if decays is None or counted <= decays:
                kept.append(run)
            continue
        samples = min(run.length, round(min(left, 1e9) / run.timestep))
        left -= samples * run.timestep
        if samples >= 2:
            kept.append(run if samples == run.length else run.part(0, samples))
    return tuple(kept)


def _noisy(run, noise_std: float, seed: tuple[int, int]):
    if not noise_std:
        return run
    whole = run.read()
    noise = np.random.default_rng(seed).normal(0.0, noise_std, whole.observation.shape)
    return replace(whole, observation=whole.observation + noise)


def _hold_out(dataset: TrajectoryDataset, share: float) -> tuple[tuple, tuple]:
    training, validation = (tuple(run for run in dataset.select(split=split) if run.kind != "static")
                            for split in ("train", "validation"))
    if validation or share == 0:
        return training, validation
    kept, held = [], []
    for trajectory in training:
        if trajectory.kind != "controlled":
            kept.append(trajectory)
            continue
        boundary = round(trajectory.length * (1 - share))
        if min(boundary, trajectory.length - boundary) < 2:
            raise ValueError(f"trajectory {trajectory.name!r} has {trajectory.length} samples, too few to hold out a "
                             f"share of {share}; set validation_share=0 or mark a run as validation")
        kept.append(trajectory.part(0, boundary))
        held.append(trajectory.part(boundary, trajectory.length))
    return tuple(kept), tuple(held)
