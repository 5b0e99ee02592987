"""Optuna under Hydra as a study that goes on where it was, in any number of processes."""

import fcntl
import logging
import os
from pathlib import Path

from hydra.plugins.sweeper import Sweeper
from hydra.utils import instantiate

for talkative in ("hydra_plugins.hydra_optuna_sweeper._impl", "alembic"):
    logging.getLogger(talkative).setLevel(logging.WARNING)
CPU = "cpu_seconds"  # of a trial, in the study's database


def cpu_seconds() -> float:
    """CPU time of this process and of those that it started and waited for, s."""
    return sum(os.times()[:4])


class StudySweeper(Sweeper):
    """The Optuna sweeper of Hydra's plugin, one trial at a time, on a study that is kept in a database.

    n_trials: finished trials of the study, those of earlier runs and of other processes included; a trial that was
    interrupted does not count. Each trial's job has the trial's number, and a sampler with a seed of its own, seed +
    number: interrupted and resumed, one process tries what it would have tried at once.
    search_minutes, of the job's own configuration: no further trial begins when the finished ones have taken so many
    CPU minutes together (of the processes that ran them, with those that they started and waited for), so that slow and
    fast models get the same effort, and on a busy machine the same as on an idle one; null: no limit.
    Ends with a message where n_jobs is not 1, or the study was begun with other arguments.
    """

    def __init__(self, **options):
        # imported here: Hydra looks at every plugin at every start, with or without Optuna
        from hydra_plugins.hydra_optuna_sweeper._impl import OptunaSweeperImpl

        class Trials(OptunaSweeperImpl):
            def setup(self, **context):
                super().setup(**context)
                launch = self.launcher.launch

                def counted(*arguments, **options):
                    begun = cpu_seconds()
                    returns = launch(*arguments, **options)
                    self.trial.set_user_attr(CPU, cpu_seconds() - begun)
                    return returns

                self.launcher.launch = counted

            def _configure_trials(self, trials, *space):
                self.trial, self.job_idx = trials[0], trials[0].number
                sampler = self.config.hydra.sweeper.sampler
                trials[0].study.sampler = instantiate(sampler, seed=(sampler.seed or 0) + trials[0].number)
                return super()._configure_trials(trials, *space)

        if options["n_jobs"] != 1:
            raise SystemExit(f"hydra.sweeper.n_jobs is {options['n_jobs']}; expected 1: to work in parallel, start the "
                             "same command with the same hydra.sweep.dir again")
        self.wanted = options["n_trials"]
        self.trials = Trials(**options | {"n_trials": 1})

    def setup(self, **context) -> None:
        self.trials.setup(**context)

    def sweep(self, arguments: list[str]) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        directory = Path(self.trials.sweep_dir)
        directory.mkdir(parents=True, exist_ok=True)
        with open(directory / "study.lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # two processes that make one database at once would fail
            study = optuna.create_study(study_name=self.trials.study_name, storage=self.trials.storage,
                                        load_if_exists=True)
            self._check_same(study, sorted([*self.trials._parse_sweeper_params_config(), *arguments]))
        limit = self.trials.config.get("search_minutes")
        while len(finished := study.get_trials(False, (optuna.trial.TrialState.COMPLETE,))) < self.wanted:
            # trials of an older study tell only how long they took
            minutes = sum(trial.user_attrs.get(CPU, trial.duration.total_seconds()) for trial in finished) / 60
            if limit is not None and minutes > limit:
                print(f"\nthe {limit:g} CPU minutes are over after {len(finished)} trials")
                break
            best = f", best so far {min(trial.value for trial in finished):.4g}" if finished else ""
            print(f"\ntrial {len(finished) + 1} of {self.wanted}{best}")
            self.trials.sweep(arguments)

    def _check_same(self, study, arguments: list[str]) -> None:
        begun = study.user_attrs.get("arguments", arguments)
        if begun != arguments:
            then, now = sorted(set(begun) - set(arguments)), sorted(set(arguments) - set(begun))
            raise SystemExit(f"the study in {self.trials.sweep_dir} was begun with {then}, now it is {now}; use "
                             "another hydra.sweep.dir")
        study.set_user_attr("arguments", arguments)
