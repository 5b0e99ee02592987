"""Selection of a slow-fast model from the data, as a Lightning fit with one epoch."""

from __future__ import annotations

import torch
from tqdm import tqdm

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.refusals import check_learnable, refuse_still_inputs
from ssmr_torch.data.windows import Segment
from ssmr_torch.fitting.closed_form_fit import ExactSolve
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.keywords import configurable
from ssmr_torch.models.slow_fast import SlowFast
from ssmr_torch.periods import whole_multiple
from ssmr_torch.quantities import TRUTH
from ssmr_torch.selection.choose import Choice, choose
from ssmr_torch.selection.settings import SelectionSettings


class SelectionFit(ModelFit):
    """Chooses the form of a `SlowFast` model from the training runs, fits it and reports why; see `choose`.

    settings: `SelectionSettings`, which explains each setting. changes: settings by name, which replace those.
    progress: whether a line shows the present stage of the selection.
    choice: the result, None before the fit. found, facts: its sentences and its plain values, for the report.
    Raises ValueError for outputs that the data do not have, or data without controlled runs, before any work.
    """

    epochs, kept = 1, ("found", "facts")

    @configurable(SelectionSettings, given=("settings",))
    @checked(progress=TRUTH)
    def __init__(self, model: SlowFast, settings: SelectionSettings | None = None, *, progress: bool = True, **changes):
        super().__init__(model)
        if not isinstance(model, SlowFast):
            raise ValueError(f"the selection can fit only a SlowFast model, but the model is a {type(model).__name__}; "
                             "use model=auto")
        settings = (SelectionSettings() if settings is None else settings).changed(**changes)
        self.__dict__["settings"], self.progress = settings, bool(progress)
        self.procedure = _WholeRuns()
        self.automatic_optimization = False
        self.choice: Choice | None = None
        self.found: list[str] = []
        self.facts: dict = {}

    def configure_optimizers(self) -> ExactSolve:
        return ExactSolve(self.model.parameters())

    def on_train_start(self) -> None:
        if self.trainer.world_size > 1:
            raise ValueError(f"{self.trainer.world_size} processes; a selection runs in one process: set "
                             "trainer.devices=1")
        dataset = self.trainer.datamodule.dataset
        check_learnable(dataset)
        driven = [run for run in self.trainer.datamodule.training if run.kind != "decay"]
        if driven:
            refuse_still_inputs(dataset, [run.extremes() for run in driven])  # decays may have another constant input

    @torch.no_grad()
    def training_step(self, segment: Segment, index: int) -> None:
        if not self.trainer.is_last_batch:
            return
        runs = [run.read() for run in self.trainer.datamodule.training]
        names = self.card["output_names"]
        scored = self.settings.scored
        strange = [name for name in scored or () if name not in names]
        if strange:
            raise ValueError(f"scored names {strange}, but the data have no such outputs; their outputs are {names}")
        decays, controlled = ([self._coarser(run) for run in runs if (run.kind == "decay") == decay]
                              for decay in (True, False))
        if not controlled:
            raise ValueError("there are no controlled training runs; record some, with inputs like those in later use")
        settings = self.settings
        if settings.symmetry == "find":
            settings = settings.changed(symmetry=self.trainer.datamodule.dataset.provenance.get("symmetry", "find"))
        with tqdm(disable=not self.progress, bar_format="{desc} [{elapsed}]", leave=False, delay=2.0) as line:
            self.choice = choose(decays, controlled, self.model.timestep, settings,
                                 input_names=self.card["input_names"],
                                 scored=None if scored is None else [names.index(name) for name in scored],
                                 say=lambda stage: line.set_description_str(f"selection: {stage}"[:110]))
        self.model.take(self.choice.model)
        self.found, self.facts = self.choice.sentences, self.choice.facts
        self.log_dict({"fit/tried": float(self.facts["tried"]), "fit/members": float(len(self.facts["members"]))})
        self.optimizers().step()

    def _coarser(self, run) -> tuple:
        """Outputs and inputs of a run, resampled to the model's timestep; inputs that change meanwhile are averaged."""
        dt = self.trainer.datamodule.dataset.timestep
        stride = whole_multiple("the model's timestep", self.model.timestep, "the sampling time of the recordings", dt,
                                "give a multiple of it, or leave timestep out")
        steps = run.length // stride
        return run.observation[::stride][:steps], run.input[:steps * stride].reshape(steps, stride, -1).mean(axis=1)

    def on_load_checkpoint(self, checkpoint: dict) -> None:
        super().on_load_checkpoint(checkpoint)
        again = SlowFast(**checkpoint["model"]["arguments"])
        with torch.no_grad():
            self.model.take(again.reduced.numpy())


class _WholeRuns:
    """The attributes that a data module reads, for a procedure that needs whole runs."""

    before = after = 0
