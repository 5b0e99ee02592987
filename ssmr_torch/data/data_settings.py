"""Settings of the data module: how trajectories are split, cut and served to a fit."""

from __future__ import annotations

from dataclasses import dataclass

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import COUNT, DURATION, LENGTH, SEED, TRUTH
from ssmr_torch.ranges import Number, OrNone, Whole
from ssmr_torch.settings import Settings, at_least, non_negative, positive, whole


@checked(validation_share=Number(0.0, 0.99), decays=OrNone(COUNT),
         controlled_duration=OrNone(Number(0.0, 1e7, "s", infinite=True)), noise_std=LENGTH, score_test=TRUTH,
         overdrive=Number(1.0, 100.0), overspeed=Whole(1, 1000), transient=Number(0.0, 1e5, "s"),
         rows=Whole(1, 10_000_000), rollout_horizon=DURATION, validation_horizon=DURATION, starts=Whole(1, 1_000_000),
         batch_size=Whole(1, 1_000_000), stride=Whole(1, 1_000_000), seed=SEED, num_workers=Whole(0, 256))
@dataclass(frozen=True)
class DataSettings(Settings):
    """Settings of a `TrajectoryDataModule`; `changed(name=value)` gives others.

    validation_share: share, below 1, at the end of every controlled training run that is held out if no run is marked
    "validation".
    decays, controlled_duration: number of training decays (the first ones) and length in s of the controlled training
    runs (from their start) that are used; None: all.
    noise_std: m, standard deviation of random white noise on the training runs and on the windows at the starts of
    validation and test predictions. The outputs to which predictions are compared stay unchanged.
    score_test: whether the test runs are scored.
    overdrive, overspeed: 1 or more, overspeed a whole number. Above 1, validation is repeated with inputs `overdrive`
    times larger and `overspeed` times faster. A model that then diverges has an infinite score, see `ModelFit`.
    transient: s cut from the start of each training decay.   rows: core samples per segment.
    rollout_horizon: s, of the rollout loss.   validation_horizon: s, of the validation and test scores.
    starts: number of random validation and test starts.   batch_size: rollouts per step.   stride: samples between the
    starts of two training rollouts.   seed: of all random numbers.   num_workers: of Torch's data loaders.

    Raises ValueError for a number out of range, TypeError for an unknown name.
    """

    validation_share: float = 0.15
    decays: int | None = None
    controlled_duration: float | None = None
    noise_std: float = 0.0
    score_test: bool = True
    overdrive: float = 1.0
    overspeed: int = 1
    transient: float = 0.1
    rows: int = 1024
    rollout_horizon: float = 0.4
    validation_horizon: float = 1.0
    starts: int = 500
    batch_size: int = 64
    stride: int = 5
    seed: int = 0
    num_workers: int = 0

    def __post_init__(self):
        if not 0 <= non_negative("validation_share", self.validation_share) < 1:
            raise ValueError(f"validation_share is {self.validation_share}; expected 0 ≤ share < 1")
        for name, unit in (("transient", "s"), ("noise_std", "m")):
            self._set(name, non_negative(name, getattr(self, name), unit))
        for name in ("rollout_horizon", "validation_horizon"):
            self._set(name, positive(name, getattr(self, name), "s"))
        for name in ("overspeed", "rows", "starts", "batch_size", "stride"):
            self._set(name, whole(name, getattr(self, name), least=1))
        for name in ("seed", "num_workers"):
            self._set(name, whole(name, getattr(self, name), least=0))
        self._set("overdrive", at_least("overdrive", self.overdrive, 1))
        if self.decays is not None:
            self._set("decays", whole("decays", self.decays, least=0))
        if self.controlled_duration is not None:
            self._set("controlled_duration", at_least("controlled_duration", self.controlled_duration, 0, "s"))
