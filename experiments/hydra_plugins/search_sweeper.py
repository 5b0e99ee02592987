"""A search by Optuna as Hydra's sweeper: `hydra/sweeper=search`. It is `ssmr_torch.search.trials.Search`."""

from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper


class SearchSweeper(Sweeper):
    """One job per trial, with the trial's number; params, direction, n_trials and sampler as in conf/hydra/sweeper."""

    def __init__(self, params, direction, n_trials, sampler):
        self.params, self.direction, self.n_trials, self.sampler = params, direction, n_trials, sampler

    def setup(self, *, hydra_context, task_function, config) -> None:
        self.config = config
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config)

    def sweep(self, arguments: list[str]) -> None:
        # imported here: Hydra looks at every plugin at every start, with or without Optuna
        from ssmr_torch.search.trials import Search

        given = [*(f"{key}={value}" for key, value in self.params.items()), *arguments]
        search = Search(self.config.hydra.sweep.dir, given, direction=self.direction, sampler=self.sampler)
        search.run(self.job, trials=self.n_trials, minutes=self.config.get("search_minutes"))

    def job(self, number: int, overrides: list[str]) -> float:
        return self.launcher.launch([overrides], initial_job_idx=number)[0].return_value
