"""What the reproduction of the paper has to do, from its settings: jobs in stages, each with what it leaves behind.

settings ─chosen figures→ closed loops, open loops, delays → models → data;   stages run in the opposite order
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

PERIOD = 0.02  # s, of every closed loop; a slower method is also run at a multiple
STAGES = ("data", "models", "open loop and runs", "delays and slower runs")


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
    names of jobs that come first. about: what a table says of it.
    """

    name: str
    product: str
    steps: tuple[Step, ...]
    needs: tuple[str, ...] = ()
    about: Mapping = field(default_factory=dict)


def plan(settings: Mapping, figures: str | Sequence[str] = "all") -> dict[str, list[Job]]:
    """The jobs of each of `STAGES` that the chosen figures need, slow ones first; runs at longer periods are added by
    `slower_runs` when the first ones are known.

    settings: plain values of a preset (conf/preset). Recordings without a path, see `with_recordings`, are left out.
    Raises ValueError for a figure, robot or method that the settings do not have.
    """
    settings = _at_hand(settings)
    known = {job.name: job for name in settings["figures"] for job in figure_runs(settings, name)}
    its = {name: settings["figures"][name] for name in chosen(settings, figures)}
    delays = [delay_job(settings, figure) for figure in its.values() if "delays" in figure]
    runs = {job.name: job for name in its for job in figure_runs(settings, name)}
    runs |= {need: known[need] for job in delays for need in job.needs if need in known}
    scored = dict.fromkeys(robot for figure in its.values() for robot in figure.get("open_loop", ()))
    open_loops = [open_loop_job(settings, robot) for robot in scored]
    needed = {need for job in [*runs.values(), *open_loops] for need in job.needs}
    needed |= {name for figure in its.values() for robot in figure.get("models", ())
               for name in _model_names(settings, robot)}
    models = [job for robot in settings["robots"] for job in robot_models(settings, robot) if job.name in needed]
    models.sort(key=lambda job: -list(settings["models"]).index(job.about["method"]))
    needed |= {need for job in [*models, *delays] for need in job.needs}
    data = [data_job(settings, robot) for robot in reversed(settings["robots"]) if f"data/{robot}" in needed]
    return dict(zip(STAGES, (data, models, [*open_loops, *runs.values()], delays)))


def chosen(settings: Mapping, figures: str | Sequence[str]) -> list[str]:
    """Names of the figures, those that the chosen ones use included, in the order of the settings.

    Raises ValueError for a name that the settings do not have.
    """
    available = list(settings["figures"])
    wanted = [figures] if isinstance(figures, str) else list(figures)
    wanted = available if "all" in wanted else wanted
    unknown = [name for name in wanted if name not in available]
    if unknown or not wanted:
        raise ValueError(f"figures is {figures!r}; expected all or some of {', '.join(available)}")
    used = {other for name in wanted for other in settings["figures"][name].get("uses", ())}
    return [name for name in available if name in used | set(wanted)]


def with_recordings(settings: Mapping, path: str | None) -> dict:
    """The settings with robots that are recordings (data: their reader) read from this folder."""
    robots = {name: dict(its) | ({"path": path} if its.get("data") else {}) for name, its in settings["robots"].items()}
    return dict(settings) | {"robots": robots}


def _at_hand(settings: Mapping) -> dict:
    """The settings without recordings whose folder nobody has given."""
    absent = {name for name, its in settings["robots"].items() if its.get("data") and not its.get("path")}
    figures = {name: dict(its) | {key: [robot for robot in its[key] if robot not in absent]
                                  for key in ("models", "open_loop") if key in its}
               for name, its in settings["figures"].items()}
    robots = {name: its for name, its in settings["robots"].items() if name not in absent}
    return dict(settings) | {"robots": robots, "figures": figures}


def data_job(settings: Mapping, robot: str) -> Job:
    """The robot's trajectories; recordings have none."""
    its = _robot(settings, robot)
    overrides = (*_plant(its), *_bench(its), f"excitation={its['excitation']}", "excitation.progress=false",
                 "workers=1", *its.get("collect", ()))
    return Job(f"data/{robot}", f"data/{robot}/trajectories.h5", (Step("collect", overrides),), about={"robot": robot})


def robot_models(settings: Mapping, robot: str) -> list[Job]:
    """Training and export of every method that is compared on the robot."""
    return [model_job(settings, robot, method) for method in _robot(settings, robot)["methods"]]


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
               (*needs, *_model_names(settings, robot)), {"robot": robot})


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
    bench = _robot(settings, robot)
    overrides = (*_plant(bench), *_bench(bench), *bench["methods"][method], *_task(its, task)["control"],
                 *settings.get("control", ()), *bench.get("control", ()), f"controller.period={period:g}",
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


def keys(jobs: Sequence[Job], configuration: Callable[[str, Sequence[str]], str]) -> dict[str, str]:
    """A hash by job of the configurations and files of its steps, and of the hashes of what it needs: it changes where
    anything does that its result depends on.

    configuration: a text by entry and overrides of a step. Raises ValueError for a job that needs one which is not
    before it.
    """
    found: dict[str, str] = {}
    for job in jobs:
        missing = [need for need in job.needs if need not in found]
        if missing:
            raise ValueError(f"{job.name} needs {missing[0]}, which is not planned before it")
        steps = [[step.entry, configuration(step.entry, step.overrides), sorted(step.files.items())]
                 for step in job.steps]
        text = json.dumps([steps, [found[need] for need in job.needs]])
        found[job.name] = hashlib.sha256(text.encode()).hexdigest()[:16]
    return found


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


def _bench(its: Mapping) -> tuple[str, ...]:
    """What stands between the plant and who controls it."""
    return (f"rig={its['rig']}", *its.get("bench", ()))


def _model_name(robot: str, method: str) -> str:
    return f"models/{robot}/{method}"


def _model_names(settings: Mapping, robot: str) -> list[str]:
    return [_model_name(robot, method) for method in _robot(settings, robot)["methods"]]


def _method(job: Job) -> tuple:
    return tuple(job.about[key] for key in ("figure", "robot", "method"))
