"""Command lines that are right, small recordings for them, and settings that contradict each other."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from ssmr_torch.result_files import save_text


@dataclass(frozen=True)
class CommandLine:
    """A command with overrides under which it works; `{data}`, `{artifact}` … stand for files of `prepared`."""

    command: str
    overrides: tuple[str, ...] = ()

    def filled(self, files: dict[str, str]) -> list[str]:
        """The overrides with the paths of the files."""
        return [each.format(**files) for each in self.overrides]


SMALL = ("excitation.decays=6", "excitation.validation_decays=1", "excitation.test_decays=1",
         "excitation.decay_duration=1.0", "excitation.progress=false", "workers=1", "plant=slow_manifold")
QUIET = ("trainer.enable_progress_bar=false", "figures=false", "data.path={data}")
MODELS = ("ssmr", "sssr", "dmd", "edmd", "edmd_bilinear", "edmd_relift", "static_pregain", "ssmr_control_augmented",
          "ssmr_oblique", "ssmr_stability_guard", "neural_ode", "auto")
OBSERVERS = ("none", "output_disturbance", "input_disturbance", "kalman")
TASKS = ("circle", "figure_eight", "rose", "letter", "eth_obstacles", "stanford_obstacles")
RIGS = ("ideal", "camera", "emulated_bench")
PLANTS = {"slow_manifold": "numba", "pressure_arm": "numba", "trunk_coarse": "numba", "diamond_coarse": "numba",
          "cosserat_rod": "elastica", "tendon_chain": "mujoco", "isupport": "soromox", "planar_hsa": "soromox"}
LOOP = ("artifact={artifact}", "progress=false", "picture=false", "view=none")
COARSE = ("task.laps=1.0", "task=circle")


def command_lines() -> list[CommandLine]:
    """Every command with each kind of model, fit, controller, observer, task, rig and plant that is installed."""
    plants = [name for name, module in PLANTS.items() if find_spec(module)]
    lines = [CommandLine("collect", (*SMALL[:-1], f"plant={plant}")) for plant in plants]
    lines += [CommandLine("collect", (*SMALL, f"rig={rig}")) for rig in RIGS]
    lines += [CommandLine("collect", (*SMALL[4:], f"excitation={each}")) for each in ("static", "five_minutes")]
    lines += [CommandLine("check", ("data.path={data}", "figures=false"))]
    lines += [CommandLine("train", (f"model={model}", *QUIET)) for model in MODELS]
    lines += [CommandLine("train", (*QUIET, f"derivative={each}")) for each in ("gaussian", "savitzky_golay")]
    lines += [CommandLine("train", (*QUIET, f"fit={each}")) for each in ("rollout", "from_linear", "stability_guard")]
    lines += [CommandLine("train", (*QUIET, "model=tpwl", "plant=trunk_coarse"))]
    lines += [CommandLine("compare", ("data.path={data}", "models=[ssmr,dmd]", "artifacts=false"))]
    lines += [CommandLine("export", ("checkpoint={checkpoint}", "formats=[]"))]
    lines += [CommandLine("evaluate", ("artifact={artifact}", "data.path={data}"))]
    lines += [CommandLine("design", ("data.path={data}", "plant=slow_manifold", "figures=false", *COARSE))]
    lines += [CommandLine("control", (*LOOP, f"task={task}")) for task in TASKS]
    lines += [CommandLine("control", (*LOOP, "task=circle", "task.laps=1", f"observer@controller.observer={each}"))
              for each in OBSERVERS]
    lines += [CommandLine("control", (*LOOP, "task=circle", "task.laps=1", f"rig={rig}")) for rig in RIGS[1:]]
    lines += [CommandLine("serve_controller", ("artifact={artifact}", "bind=tcp://127.0.0.1:*"))]
    lines += [CommandLine("serve_plant", ("connect=tcp://127.0.0.1:5998", "wait=0.3"))]
    lines += [CommandLine("commission", ("card={card}", "plant=slow_manifold", "confirm='yes'"))]
    lines += [CommandLine("report", ("directory={folder}",))]
    lines += [CommandLine("delay_study", ("data.path={data}", "outputs=[tip_x,tip_y,tip_z]"))]
    lines += [CommandLine("docs_numbers", ("root={folder}", "check=true", "name=none"))]
    return lines


# Settings of which each may be right and both together are not, with a word that the refusal has to hold.
CONTRADICTIONS = [(CommandLine(command, tuple(overrides)), word) for command, overrides, word in [
    ("train", [*QUIET, "derivative=savitzky_golay", "derivative.window=5", "derivative.degree=7"], "window"),
    ("train", [*QUIET, "derivative=savitzky_golay", "derivative.window=8"], "window"),
    ("train", [*QUIET, "derivative.order=3"], "order"),
    ("train", [*QUIET, "model.delays=0", "model.state_dim=20"], "state_dim"),
    ("train", [*QUIET, "model.dynamics_degree=9", "model.state_dim=60", "model.delays=20"], "monomials"),
    ("train", [*QUIET, "model=dmd", "model.delays=1", "model.input_delays=4"], "input_delays"),
    ("train", [*QUIET, "model=dmd", "model.timestep=0.015"], "timestep"),
    ("train", [*QUIET, "model.delays=900"], "delays"),
    ("train", [*QUIET, "outputs=[nowhere]"], "outputs"),
    ("train", [*QUIET, "outputs=[tip_x,tip_x]"], "outputs"),
    ("train", [*QUIET, "module.transient=50.0"], "transient"),
    ("train", [*QUIET, "module.validation_horizon=500.0"], "horizon"),
    ("train", [*QUIET, "fit=rollout", "module.rollout_horizon=500.0"], "horizon"),
    ("train", [*QUIET, "fit.closed_form.ridge={nowhere: 0.1}".replace("{", "{{").replace("}", "}}")], "ridge"),
    ("train", [*QUIET, "module.decays=0", "module.controlled_duration=0.0"], "decays"),
    ("train", [*QUIET, "fit=rollout", "fit.refinement.frozen=[nowhere]"], "frozen"),
    ("train", [*QUIET, "metric=validation/nothing"], "metric"),
    ("collect", [*SMALL, "excitation.release.ramp=3.0"], "ramp"),
    ("collect", [*SMALL, "rig.sensor_delay=0.015"], "sensor_delay"),
    ("collect", [*SMALL, "rig.outputs=[nowhere]"], "outputs"),
    ("collect", [*SMALL, "plant.input_bounds=[1.0,0.0]"], "bound"),
    ("collect", [*SMALL[:-1], "plant=trunk_coarse", "plant.scheme=generalized_alpha"], "scheme"),
    ("collect", [*SMALL[:-1], "plant=trunk_coarse", "plant.markers={{tip: [9.0, 9.0, 9.0]}}"], "marker"),
    ("evaluate", ["artifact={artifact}", "data.path={data}", "horizons=[900.0]"], "horizon"),
    ("evaluate", ["artifact={artifact}", "data.path={data}", "split=test", "kind=static"], "static"),
    ("evaluate", ["artifact={artifact}", "data.path={data}", "outputs=[nowhere]"], "nowhere"),
    ("compare", ["data.path={data}", "models=[nothing]"], "nothing"),
    ("design", ["data.path={data}", "figures=false"], "bounds"),
    ("design", ["data.path={data}", "plant=slow_manifold", "bounds=[[0,0,0,0],[1,1,1,1]]"], "bounds"),
    ("design", ["data.path={data}", "bounds=[[0,0],[1,1]]"], "bounds"),
    ("control", [*LOOP, "controller.period=0.015"], "period"),
    ("control", [*LOOP, "task.ramp=90.0"], "ramp"),
    ("control", [*LOOP, "controller.safe_input=[1.0,2.0]"], "safe_input"),
    ("control", [*LOOP, "controller.safe_input=[-5.0,0.0,0.0,0.0]"], "safe_input"),
    ("control", [*LOOP, "controller.output_bounds=[[1,1,1,1,1,1],[0,0,0,0,0,0]]"], "output_bounds"),
    ("control", [*LOOP, "controller.posture=[0.0]"], "posture"),
    ("control", [*LOOP, "controller.measurement_delay=0.015"], "measurement_delay"),
    ("control", [*LOOP, "task.tracked=[tip_x,tip_x]"], "tip_x"),
    ("control", [*LOOP, "task.tracked=[nowhere,tip_x]"], "nowhere"),
    ("control", [*LOOP, "qp=nothing"], "nothing"),
    ("control", [*LOOP, "plant=pressure_arm"], "output"),
    ("control", [*LOOP, "quantile=0.9"], "quantile"),
    ("export", [], "checkpoint"),
    ("export", ["checkpoint={checkpoint}", "mat={data}"], "mat"),
    ("reproduce", ["figures=[fig99]"], "fig99"),
    ("benchmark", ["benchmark=step", "horizons=5"], "horizons"),
    ("benchmark", ["benchmark=endurance", "steps=1.5"], "steps"),
    ("benchmark", ["benchmark=scaling", "series=[nothing]"], "series"),
]]

# Words of a command line that no configuration has.
MISTAKES = ("{key}x=1", "+{key}.more=1", "{key}=[1,2", "~nothing", "{key}=", "{group}=nowhere", "{group}.nothing=1",
            "++{group}._target_=nowhere.Thing", "++{group}._target_=5", "{key}=${{nowhere}}", "=5", "{key}",
            "{group}=5")


def prepared(folder: Path, run) -> dict[str, str]:
    """Small recordings, a checkpoint and an artifact of them in a folder, made by `run(command, overrides)`."""
    run("collect", [*SMALL, f"hydra.run.dir={folder}/collect"])
    data = f"{folder}/collect/trajectories.h5"
    run("train", ["model=ssmr", *(each.format(data=data) for each in QUIET), f"hydra.run.dir={folder}/train"])
    run("export", [f"checkpoint={folder}/train/model.ckpt", f"artifact={folder}/artifact", "formats=[]", "name=small",
                   f"hydra.run.dir={folder}/export"])
    save_text(folder / "robot.yaml", "name: nothing\n")
    return {"data": data, "checkpoint": f"{folder}/train/model.ckpt", "artifact": f"{folder}/artifact",
            "card": f"{folder}/robot.yaml", "folder": str(folder)}
