"""Lightning data module: serves the trajectories of one training as segments, rollouts and scored runs."""

from __future__ import annotations

import lightning
from torch.utils.data import DataLoader, RandomSampler, Subset

from ssmr_torch.data.data_settings import DataSettings
from ssmr_torch.data.starts import ScoredRuns, starts_over
from ssmr_torch.data.training_and_validation import hold_out, limited, noisy
from ssmr_torch.data.windows import RolloutDataset, SegmentDataset, SegmentShare, stack_rollouts
from ssmr_torch.keywords import configurable
from ssmr_torch.periods import whole_multiple
from ssmr_torch.trajectory import TrajectoryDataset


class TrajectoryDataModule(lightning.LightningDataModule):
    """Segments for closed-form fits, rollouts for gradient fits, and the same validation and test starts for both.

    Static runs (set points) show no dynamics. Only a procedure with `takes_static` receives those of the training.
    settings: `DataSettings`, which explains each setting; changes: settings by name, which replace those.
    Call `prepare(fit)` before training, so that the module knows the delays and the context that the fit needs.
    """

    @configurable(DataSettings, given=("settings",))
    def __init__(self, dataset: TrajectoryDataset, settings: DataSettings | None = None, **changes):
        super().__init__()
        settings = (DataSettings() if settings is None else settings).changed(**changes)
        self.dataset, self.settings = dataset, settings
        self.transient, self.overdrive, self.overspeed = settings.transient, settings.overdrive, settings.overspeed
        training, self.validation = hold_out(dataset, settings.validation_share)
        training = limited(training, settings.decays, settings.controlled_duration)
        self.training = tuple(noisy(run, settings.noise_std, (settings.seed, number))
                              for number, run in enumerate(training))
        test = dataset.select(split="test") if settings.score_test else ()
        self.test = tuple(run for run in test if run.kind != "static")
        self.static = dataset.select(split="train", kind="static")
        self.procedure, self.delays, self.sampling = None, 0, 1
        self.drawn_horizon, self.drawn_starts = settings.rollout_horizon, None

    def prepare(self, fit) -> TrajectoryDataModule:
        """Prepare the data for this fit: segments if it is a closed-form fit, otherwise rollouts.

        If the fit has the attributes `horizon` (s) and `starts`, rollouts have this horizon, and each epoch draws this
        number of new starts. Raises ValueError, before any fit, if runs are too short for the delays and the horizons.
        """
        self.procedure, self.delays = getattr(fit, "procedure", None), fit.model.delays
        self.sampling = whole_multiple("the model's timestep", fit.model.timestep, "the data's sampling time",
                                       self.dataset.timestep, "change model.timestep, or resample the data")
        if hasattr(self.procedure, "sampled_every"):
            self.procedure.sampled_every(self.dataset.timestep)
        self.drawn_horizon = getattr(fit, "horizon", self.settings.rollout_horizon)
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
                                  num_workers=self.settings.num_workers)
            return DataLoader(data, self.settings.batch_size, shuffle=True, collate_fn=stack_rollouts,
                              drop_last=len(data) > self.settings.batch_size, num_workers=self.settings.num_workers)
        static = self.static if getattr(self.procedure, "takes_static", False) else ()
        data = SegmentDataset(self.training + static, before=self.procedure.before, after=self.procedure.after,
                              rows=self.settings.rows, transient=self.transient)
        return DataLoader(self._share(data), batch_size=None, shuffle=False, num_workers=self.settings.num_workers)

    def val_dataloader(self) -> list | DataLoader:
        return self._scored(self.validation)

    def test_dataloader(self) -> list | DataLoader:
        return self._scored(self.test)

    def transfer_batch_to_device(self, batch, device, dataloader_index):
        return batch.to(device)

    def _scored(self, trajectories: tuple) -> list | DataLoader:
        if not trajectories:
            return []
        horizon, count, seed = self.settings.validation_horizon, self.settings.starts, self.settings.seed
        starts_over([run.length for run in trajectories], horizon, self.dataset.timestep,
                    margin=max(1, self.delays * self.sampling), count=count, seed=seed)
        runs = tuple(run.read() for run in trajectories)
        seen = tuple(noisy(run, self.settings.noise_std, (seed, 1, number)) for number, run in enumerate(runs))
        return DataLoader([ScoredRuns(runs, seen, horizon, count, seed)], batch_size=None)

    def _rollouts(self) -> RolloutDataset:
        steps = max(round(self.drawn_horizon / (self.dataset.timestep * self.sampling)), 1)
        return RolloutDataset(self.training, delays=self.delays, horizon=steps, stride=self.settings.stride,
                              transient=self.transient, sampling=self.sampling)

    def _share(self, data):
        """The part of this process: each segment goes to exactly one process; rollouts are divided equally."""
        trainer = self.trainer
        if trainer is None or trainer.world_size == 1:
            return data
        if len(data) < trainer.world_size:
            raise ValueError(f"{len(data)} batches of data for {trainer.world_size} processes; use fewer processes, or "
                             "a smaller `rows`")
        if isinstance(data, SegmentDataset):
            return SegmentShare(data, trainer.global_rank, trainer.world_size)
        # processes step together: one with more batches than another would wait forever
        even = len(data) - len(data) % trainer.world_size
        return Subset(data, range(trainer.global_rank, even, trainer.world_size))
