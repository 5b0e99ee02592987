"""Learn the dominant dynamics of continuum robots on spectral submanifolds, and control the robots with them.

Plant ─collect→ Trajectories ─fit→ Model ─export→ Artifact ─→ Controller ⟲ Plant ─→ ClosedLoopRecord ─→ report

    import ssmr_torch as ssmr

    data = ssmr.read("robot.yaml")                 # recordings by a card; ssmr.load("trajectories.h5"); or from arrays:
    data = ssmr.trajectories(decays=[(t, y, u), …], controlled=[(t, y, u), …], test=[(t, y, u)])
    print(ssmr.check(data))                        # what the recordings lack, before any fit
    model = ssmr.fit(data)                         # a TrainedModel, chosen from the data; ssmr.fit(data, "ssmr"), …
    print(ssmr.score(model, data))                 # horizons × (model, persistence, constant velocity)
    print(ssmr.compare(data))                      # the chosen model and all baselines at their best
    outputs = model.predict(window, inputs)
    model.save("artifact"); model = ssmr.load("artifact")
    controller, report = ssmr.design("auto", data, task, plant.input_bounds)          # from the recordings alone
    controller = ssmr.ModelPredictiveController(model, task, plant.input_bounds, output_names=plant.output_names)
    record = ssmr.simulate(plant, controller, task)

Units are SI throughout (m, s, kg, N). Observations are displacements from the rest position. Every object prints itself
as its data sheet. A name is imported when it is first used: importing the package alone loads nothing heavy.
"""

from typing import TYPE_CHECKING

from ssmr_torch.lazy import lazily

__version__ = "0.12.0"

if TYPE_CHECKING:
    from ssmr_torch import plants, tasks
    from ssmr_torch.closed_loop.record import ClosedLoopRecord
    from ssmr_torch.control.mpc import ModelPredictiveController
    from ssmr_torch.control.mpc_settings import PredictiveControlSettings
    from ssmr_torch.controller_design.design import design
    from ssmr_torch.controller_design.rehearsal import rehearse
    from ssmr_torch.data.arrays import trajectories
    from ssmr_torch.evaluation.score_table import score
    from ssmr_torch.face import check, load, read, simulate
    from ssmr_torch.fitting.compare_models import compare
    from ssmr_torch.fitting.fit import fit
    from ssmr_torch.trained_model import TrainedModel
    from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

__all__ = ["ClosedLoopRecord", "ModelPredictiveController", "PredictiveControlSettings", "TrainedModel", "Trajectory",
           "TrajectoryDataset", "check", "compare", "design", "fit", "load", "plants", "read", "rehearse", "score",
           "simulate", "tasks", "trajectories"]

__getattr__, __dir__ = lazily(__name__, {
    **{name: f"ssmr_torch.face:{name}" for name in ("check", "load", "read", "simulate")},
    "trajectories": "ssmr_torch.data.arrays:trajectories", "fit": "ssmr_torch.fitting.fit:fit",
    "design": "ssmr_torch.controller_design.design:design",
    "rehearse": "ssmr_torch.controller_design.rehearsal:rehearse",
    "compare": "ssmr_torch.fitting.compare_models:compare",
    "score": "ssmr_torch.evaluation.score_table:score", "TrainedModel": "ssmr_torch.trained_model:TrainedModel",
    "Trajectory": "ssmr_torch.trajectory:Trajectory", "TrajectoryDataset": "ssmr_torch.trajectory:TrajectoryDataset",
    "ClosedLoopRecord": "ssmr_torch.closed_loop.record:ClosedLoopRecord",
    "ModelPredictiveController": "ssmr_torch.control.mpc:ModelPredictiveController",
    "PredictiveControlSettings": "ssmr_torch.control.mpc_settings:PredictiveControlSettings",
    "plants": "ssmr_torch.plants:", "tasks": "ssmr_torch.tasks:"})
