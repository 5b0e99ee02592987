"""What the reproduction of the paper has to do, from its settings: jobs, each with what it needs and leaves behind.

chosen figures → delays, closed loops, open loops → models → data
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

PERIOD = 0.02  # s, of every closed loop; a slower method is also run at a multiple


@dataclass(frozen=True)
class Step:
    """One entry point with its options.

    entry: script of experiments/. overrides: of its configuration. files: further ones, key → path below the
    reproduction's directory, with ./ in front below the job's own.
    """

    entry: str
    overrides: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Job:
    """Steps that are done together, and what tells that they are.

    name: directory below the reproduction's, unique. product: file that the last step leaves, below the same. needs:
    names of jobs that come first. about: what a table says of it. partial: done with those of its needs that there
    are, where others failed.
    """

    name: str
    product: str
    steps: tuple[Step, ...]
    needs: tuple[str, ...] = ()
    about: Mapping = field(default_factory=dict)
    partial: bool = False


@dataclass(frozen=True, eq=False)
class Plan:
    """What a preset asks for.

    figures: names of those that are shown. jobs: what they need, each after what it needs itself, slow models first.
    every: the same for all figures of the settings.
    """

    settings: Mapping
    figures: tuple[str, ...]
    jobs: tuple[Job, ...]
    every: tuple[Job, ...]

    def slower(self, solve_p99: Mapping[str, float]) -> list[Job]:
        """`slower_runs` of those closed loops whose solve times are known, s by name."""
        return slower_runs(self.settings, [job for job in self.every if "period" in job.about], solve_p99)


def plan(settings: Mapping, figures: str | Sequence[str] = "all", recordings: str | None = None) -> Plan:
    """The jobs that the chosen figures need; runs at longer periods follow when the first ones are known.

    settings: plain values of a preset (conf/preset). recordings: folder from which robots that are recordings (data:
    their reader) are read; without it they are left out.
    Raises ValueError for a figure, robot or method that the settings do not have, and recordings that are no folder.
    """
    settings = _at_hand(settings, recordings)
    every, shown = _all_jobs(settings), chosen(settings, figures)
    return Plan(settings, tuple(shown), _needed(settings, every, shown), _needed(settings, every, settings["figures"]))


def _needed(settings: Mapping, every: Mapping[str, Job], figures: Iterable[str]) -> tuple[Job, ...]:
    """Those of the jobs that figures show, and what these need, in the order of all."""
    wanted = [name for figure in figures for name in _wanted(settings, figure)]
    needed: set[str] = set()
    while wanted:
        name = wanted.pop()
        if name not in needed:
            needed.add(name)
            wanted += every[name].needs
    return tuple(job for job in every.values() if job.name in needed)


def _all_jobs(settings: Mapping) -> dict[str, Job]:
    """By name, whatever the figures: data, models, open loops, closed loops, delays."""
    robots, figures = settings["robots"], settings["figures"]
    data = [data_job(settings, robot) for robot in reversed(robots) if not robots[robot].get("data")]
    models = [model_job(settings, robot, method) for robot in robots for method in robots[robot]["methods"]]
    models.sort(key=lambda job: -list(settings["models"]).index(job.about["method"]))
    open_loops = [open_loop_job(settings, robot) for robot in robots]
    runs = [job for name in figures for job in figure_runs(settings, name)]
    delays = [delay_job(settings, figure) for figure in figures.values() if "delays" in figure]
    return {job.name: job for job in (*data, *models, *open_loops, *runs, *delays)}


def _wanted(settings: Mapping, figure: str) -> list[str]:
    """Names of the jobs whose products a figure shows."""
    its = settings["figures"][figure]
    return [*(job.name for job in figure_runs(settings, figure)),
            *(f"open_loop/{robot}" for robot in its.get("open_loop", ())),
            *(name for robot in its.get("models", ()) for name in _model_names(settings, robot)),
            *([f"delays/{its['delays']}"] if "delays" in its else [])]


def chosen(settings: Mapping, figures: str | Sequence[str]) -> list[str]:
    """Names of the figures, those that the chosen ones use included, in the order of the settings.

    Raises ValueError for a name that the settings do not have.
    """
    available = list(settings["figures"])
    wanted = [figures] if isinstance(figures, str) else list(figures or ())
    wanted = available if "all" in wanted else wanted
    unknown = [name for name in wanted if name not in available]
    if unknown or not wanted:
        raise ValueError(f"figures is {figures!r}; expected all or some of {', '.join(available)}")
    used = {other for name in wanted for other in settings["figures"][name].get("uses", ())}
    return [name for name in available if name in used | set(wanted)]


def _at_hand(settings: Mapping, recordings: str | None) -> dict:
    """The settings with robots that are recordings read from this folder, and without them where there is none."""
    if recordings is not None and not Path(recordings).expanduser().is_dir():
        raise ValueError(f"recordings={recordings} is no folder; expected the one with decays.mat and "
                         "controlled_2022.mat of the real robot, or null to leave it out")
    read = {name for name, its in settings["robots"].items() if its.get("data")}
    place = {} if recordings is None else {"path": str(Path(recordings).expanduser().resolve())}
    robots = {name: dict(its) | (place if name in read else {}) for name, its in settings["robots"].items()
              if place or name not in read}
    figures = {name: dict(its) | {key: [robot for robot in its[key] if place or robot not in read]
                                  for key in ("models", "open_loop") if key in its}
               for name, its in settings["figures"].items()}
    return dict(settings) | {"robots": robots, "figures": figures}


def data_job(settings: Mapping, robot: str) -> Job:
    """The robot's trajectories; recordings have none."""
    its = _robot(settings, robot)
    overrides = (*_plant(its), *_rig(its), f"excitation={its['excitation']}", "excitation.progress=false",
                 "workers=1", *its.get("collect", ()))
    return Job(f"data/{robot}", f"data/{robot}/trajectories.h5", (Step("collect", overrides),), about={"robot": robot})


def model_job(settings: Mapping, robot: str, method: str) -> Job:
    """One method trained on the robot's data, and its artifact."""
    its, model = _robot(settings, robot), settings["models"].get(method)
    if model is None:
        raise ValueError(f"{robot} compares {method!r}; the models are {', '.join(settings['models'])}")
    overrides = (f"robot={its['robot']}", f"model={model}", *_plant(its), f"name={quoted(method)}",
                 *settings.get("training", ()), *settings.get("train", {}).get(method, ()),
                 *its.get("train", {}).get(method, ()))
    given, files, needs = _trajectories(its, robot)
    train = Step("train", (*overrides, *given), files)
    export = Step("export", ("formats=[]",), {"checkpoint": "./model.ckpt", "artifact": "./artifact"})
    return Job(_model_name(robot, method), f"{_model_name(robot, method)}/artifact/card.json", (train, export),
               needs, {"robot": robot, "method": method, "model": model})


def open_loop_job(settings: Mapping, robot: str) -> Job:
    """Scores of all of the robot's models from the same starts."""
    given, files, needs = _trajectories(_robot(settings, robot), robot)
    step = Step("evaluate", (*settings.get("open_loop", ()), *given), files)
    return Job(f"open_loop/{robot}", f"open_loop/{robot}.json", (step,),
               (*needs, *_model_names(settings, robot)), {"robot": robot}, partial=True)


def figure_runs(settings: Mapping, figure: str) -> list[Job]:
    """The closed loops of a figure at `PERIOD`: every task and seed with every method; none of a figure without."""
    its = settings["figures"][figure]
    if "robot" not in its:
        return []
    methods = _robot(settings, its["robot"])["methods"]
    return [run_job(settings, figure, method, name, seed, PERIOD)
            for name, task in ((name, _task(its, name)) for name in its["tasks"])
            for seed in range(task["seeds"]) for method in methods if method not in task["without"]]


def run_job(settings: Mapping, figure: str, method: str, task: str, seed: int, period: float) -> Job:
    """One closed loop; period in s."""
    its = settings["figures"][figure]
    robot = its["robot"]
    plant = _robot(settings, robot)
    overrides = (*_plant(plant), *_rig(plant), *plant["methods"][method], *_task(its, task)["control"],
                 *settings.get("control", ()), *plant.get("control", ()), f"controller.period={period:g}",
                 f"seed={seed}", *(f"{key}={seed}" for key in its.get("seeded", ())))
    step = Step("control", overrides, {"artifact": f"{_model_name(robot, method)}/artifact"})
    name = f"runs/{figure}/{robot}/{method}/{task}/{seed}-{1e3 * period:g}ms"
    return Job(name, f"{name}/metrics.json", (step,), (_model_name(robot, method),),
               {"figure": figure, "robot": robot, "method": method, "task": task, "seed": seed, "period": period})


def _task(figure: Mapping, name: str) -> Mapping:
    """control: options of a task's closed loops; seeds: its own or the figure's, whichever are fewer; without: methods
    that the task or the figure leaves out.
    """
    its = figure["tasks"][name]
    its = its if isinstance(its, Mapping) else {"control": its}
    return {"control": its["control"], "seeds": min(figure["seeds"], its.get("seeds", figure["seeds"])),
            "without": (*figure.get("without", ()), *its.get("without", ()))}


def slower_runs(settings: Mapping, runs: Iterable[Job], solve_p99: Mapping[str, float]) -> list[Job]:
    """All closed loops of a figure's method that does not hold its period, once more at the shortest multiple that it
    holds: period = PERIOD ⌈p99 / PERIOD⌉, p99 of the run where it is least, since other load only adds.

    solve_p99: s, 99 % of the solve times by name of the run; runs that it does not name are left out.
    """
    least: dict[tuple, float] = {}
    runs = [job for job in runs if job.name in solve_p99]
    for job in runs:
        least[_method(job)] = min(least.get(_method(job), math.inf), solve_p99[job.name])
    again = []
    for job in runs:
        period = PERIOD * math.ceil(least[_method(job)] / PERIOD - 1e-9)
        if period > job.about["period"]:
            again.append(run_job(settings, *(job.about[key] for key in ("figure", "method", "task", "seed")), period))
    return again


def delay_job(settings: Mapping, figure: Mapping) -> Job:
    """What delays do to the manifold of a robot, seen by one closed loop, or by a test run where none is named."""
    robot, record = figure["delays"], figure.get("record")
    files, needs = {"data.path": f"data/{robot}/trajectories.h5"}, [f"data/{robot}"]
    if record:
        run = run_job(settings, record["figure"], record["method"], record["task"], 0, PERIOD)
        files["record"] = f"{run.name}/record.h5"
        needs.append(run.name)
    return Job(f"delays/{robot}", f"delays/{robot}/delays.json", (Step("delay_study", (), files),), tuple(needs),
               {"robot": robot})


def quoted(text: str) -> str:
    """A text as a value of a Hydra override, whatever it holds."""
    return "'" + text.replace("\\'", "\\\\'").replace("'", "\\'") + "'"


def _robot(settings: Mapping, robot: str) -> Mapping:
    if robot not in settings["robots"]:
        raise ValueError(f"no robot {robot!r}; the settings have {', '.join(settings['robots'])}")
    return settings["robots"][robot]


def _trajectories(its: Mapping, robot: str) -> tuple[tuple[str, ...], dict[str, str], tuple[str, ...]]:
    """Where a robot's trajectories come from: overrides, files and needs of a job that reads them."""
    if its.get("data"):
        return (f"data={its['data']}", f"data.path={quoted(its['path'])}"), {}, ()
    return (), {"data.path": f"data/{robot}/trajectories.h5"}, (f"data/{robot}",)


def _plant(its: Mapping) -> tuple[str, ...]:
    """The plant as its model knows it; none of recordings."""
    if its.get("data"):
        return ()
    return (f"plant={its['plant']}", *([f"plant.mesh={quoted(its['mesh'])}"] if its.get("mesh") else []))


def _rig(its: Mapping) -> tuple[str, ...]:
    """What stands between the plant and who controls it."""
    return (f"rig={its['rig']}", *its.get("unmodelled", ()))


def _model_name(robot: str, method: str) -> str:
    return f"models/{robot}/{method}"


def _model_names(settings: Mapping, robot: str) -> list[str]:
    return [_model_name(robot, method) for method in _robot(settings, robot)["methods"]]


def _method(job: Job) -> tuple:
    return tuple(job.about[key] for key in ("figure", "robot", "method"))
