"""Commissioning: from a robot card to fast circles, step by step. Each step is shown, confirmed and recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.collection.resumption import COMPLETE
from ssmr_torch.commissioning.channels import admissible_share, channel_faults, channels_said, expectations
from ssmr_torch.commissioning.circles import circle_about, reach, tracked_outputs
from ssmr_torch.commissioning.collection_with_limits import gather, recorded_share
from ssmr_torch.commissioning.confirmation import Confirm, confirmation, ended_in_order
from ssmr_torch.commissioning.directory import REPORT, CommissioningDirectory
from ssmr_torch.commissioning.noise import measure_noise, noise_faults, noise_said
from ssmr_torch.commissioning.report import FIGURES, TITLES, written
from ssmr_torch.commissioning.robot_card import RobotCard, fitted, read_robot_card
from ssmr_torch.commissioning.safety_guard import GuardedPlant, SafetyStop
from ssmr_torch.commissioning.steps import measure_steps
from ssmr_torch.plants.base import Plant
from ssmr_torch.quantities import POSITIVE_SHARE, SEED, TEXT, TRUTH
from ssmr_torch.ranges import Number, Whole
from ssmr_torch.settings import Settings, positive, whole
from ssmr_torch.tasks.references import Task

STEPS = tuple(TITLES)
ARTIFACT = "artifact"
FEWEST = 20  # times the noise: the smallest radius of a circle


@checked(model=TEXT, rest_duration=Number(0.1, 1e4, "s"), slow_lap=Number(0.1, 1e4, "s"),
         fast_lap=Number(0.1, 1e4, "s"), laps=Whole(1, 1000), share_of_reach=POSITIVE_SHARE, seed=SEED, figures=TRUTH)
@dataclass(frozen=True)
class CommissioningSettings(Settings):
    """Settings of `commission`.

    model: kind of model for the controller, such as auto or ssmr; see `ssmr_torch.design`.
    rest_duration: s of noise at rest.   slow_lap, fast_lap: s per lap of the two circles.   laps: of each circle.
    share_of_reach: radius of the circles, as a share of the reach.   seed: of the excitation and of the robot.
    figures: whether to draw; needs the extra `plots`.
    """

    model: str = "auto"
    rest_duration: float = 5.0
    slow_lap: float = 10.0
    fast_lap: float = 2.5
    laps: int = 3
    share_of_reach: float = 0.4
    seed: int = 0
    figures: bool = True

    def __post_init__(self):
        for name in ("rest_duration", "slow_lap", "fast_lap"):
            self._set(name, positive(name, getattr(self, name), "s"))
        self._set("laps", whole("laps", self.laps, least=1))
        if not 0 < positive("share_of_reach", self.share_of_reach) <= 1:
            raise ValueError(f"share_of_reach is {self.share_of_reach}; expected more than 0 and at most 1")


SETTINGS = CommissioningSettings()


def commission(plant: Plant, card: RobotCard | str | Path, directory: str | Path, *, excitation: Callable | None = None,
               confirm: str | Confirm = "ask", design: Callable | None = None, load: Callable | None = None,
               settings: CommissioningSettings = SETTINGS, **changes) -> list[str]:
    """Commission a robot. Calling it again with the same directory continues after the last confirmed step.

    plant: any `Plant`, such as `plants.RemotePlant`.   card: a `RobotCard`, or its file.
    excitation: (plant, directory=, workers=) → dataset; None: excitation=five_minutes of the configuration.
    confirm: "ask", "yes", or (step, text, faults) → bool; False ends the call, and the step is not confirmed.
    design: (kind, data, task, bounds) → an object with `report` and `save(folder)`; None: `ssmr_torch.design`.
    load: folder → an object with `controller(task)`; None: `ssmr_torch.load`. This controller, from the artifact on
    disk, draws both circles.   changes: of the settings, by name.

    Returns the names of the confirmed steps; the robot is commissioned when these are STEPS. Raises ValueError for a
    card that does not fit the robot or the directory, and SafetyStop when a limit is exceeded. Only in the collection
    no SafetyStop is raised at once: there smaller inputs are offered. The input always goes back to neutral at the end.
    """
    card = fitted(card if isinstance(card, RobotCard) else read_robot_card(card), plant)
    work = Commissioning(plant, card, CommissioningDirectory(directory), confirmation(confirm),
                         excitation or _five_minutes(), design or _design, load or _load, settings.changed(**changes))
    with ended_in_order():
        return work.go_on()


class Commissioning:
    """One call of `commission`. Every method named after a step returns the text to be shown and the faults."""

    def __init__(self, plant: Plant, card: RobotCard, directory: CommissioningDirectory, confirm: Confirm,
                 excitation: Callable, design: Callable, load: Callable, settings: CommissioningSettings):
        self.plant, self.card, self.directory, self.confirm = plant, card, directory, confirm
        self.excitation, self.design, self.load, self.settings = excitation, design, load, settings

    def go_on(self) -> list[str]:
        """Take the steps that are not confirmed yet, until one is declined. Returns the names of the confirmed steps.
        """
        self.directory.keep_card(self.card)
        done = [entry["step"] for entry in self.directory.confirmed()]
        rest = [step for step in STEPS if step not in done]
        if done and rest and not self.confirm(done[-1], f"{len(done)} steps are confirmed, the last is {done[-1]!r}.\n"
                                              f"{self._next(rest[0])}", ()):
            return done
        for step in rest:
            found = getattr(self, f"_{step.replace(' ', '_')}")()
            if found is None:
                break
            said, faults = found
            marks = "".join(f"\n\nPlease check: {fault}." for fault in faults)
            following = STEPS[len(done) + 1:]
            after = f"\n\n{self._next(following[0])}" if following else ""
            if not self.confirm(step, f"{len(done) + 1}. {TITLES[step]}\n\n{said}{marks}{after}", tuple(faults)):
                self._declined(step)
                break
            self.directory.confirm(step, said, faults)
            done.append(step)
            self._report()
        return done

    def _declined(self, step: str) -> None:
        if step == "collection" and self.directory.has(COMPLETE):
            self.directory.set_aside(COMPLETE)

    def _report(self) -> None:
        present = [name for names in FIGURES.values() for name in names if self.directory.has(name)]
        self.directory.write(REPORT, written(self.plant.name, self.directory.confirmed(), present))

    def _next(self, step: str) -> str:
        limits = f"It stops beyond {1e3 * self.card.displacement_limit:.3g} mm or {self.card.rate_limit:.3g} m/s."
        moves = {"noise": f"the neutral input {self.card.neutral} is held for {self.settings.rest_duration:g} s.",
                 "steps": "each input makes small steps, one after the other.",
                 "collection": "the robot makes large motions for some minutes.",
                 "slow circle": "the controller draws a circle slowly.",
                 "fast circle": "the controller draws the circle fast."}
        what = f"{moves[step]} {limits}" if step in moves else "the robot does not move."
        return f"Next step, {TITLES[step].lower()}: {what}"

    def _card(self) -> tuple[str, list]:
        return f"```yaml\n{self.card.text()}```", []

    def _noise(self) -> tuple[str, list]:
        with self._moving("noise") as guard:
            noise = measure_noise(guard, self.settings.rest_duration, self.settings.seed)
            self.directory.keep_runs("noise", [guard.run("noise")], guard)
        self.directory.write_json("noise.json", noise)
        return noise_said(noise, guard), noise_faults(noise, guard)

    def _steps(self) -> tuple[str, list]:
        runs = []
        with self._moving("steps") as guard:
            answers = measure_steps(guard, self._std(), self.settings.seed,
                                    lambda answer: runs.append(guard.run(f"steps of {answer.input}")))
        self.directory.keep_runs("steps", runs, guard)
        outputs, expected = guard.output_names, expectations(self.card.expected, guard.input_names, guard.output_names)
        room = np.abs(self.card.range - self.card.rest).max(axis=0)
        share = admissible_share(answers, room, self.card.displacement_limit)
        self.directory.write_json("steps.json", {"share": share, "answers": [each.as_dict() for each in answers]})
        if self.settings.figures:
            self.directory.draw("steps", answers, outputs)
        said = channels_said(answers, expected, outputs, guard.input_unit)
        return f"{said}\n\nThe recordings use {100 * share:.3g} % of the input range at first.", \
            channel_faults(answers, expected, outputs)

    def _collection(self) -> tuple[str, list] | None:
        first = self.directory.read_json("steps.json")["share"]
        with self._moving("collection") as guard:
            data = gather(guard, self.excitation, self.directory, first,
                          lambda what: self.confirm("collection", what, ()))
        if data is None:
            return None
        stops, seconds = data.provenance["stops"], sum(run.length for run in data) * data.timestep
        held = [f"it was stopped at {100 * stop['share']:.3g} %: {stop['reason']}" for stop in stops]
        low, high = data.extremes()[0]
        spans = zip(data.output_names, 1e3 * low, 1e3 * high)
        furthest = ", ".join(f"{name} {a:.3g} … {b:.3g}" for name, a, b in spans)
        share = f"{100 * data.provenance['share']:.3g} % of the input range"
        return "\n\n".join([f"{len(data)} runs, {seconds / 60:.2g} min, with {share}; mm: {furthest}.", *held]), []

    def _check(self) -> tuple[str, list]:
        from ssmr_torch.face import check

        report = check(self.directory.trajectories())
        self.directory.write("check.txt", f"{report}\n")
        if self.settings.figures:
            report.figures(self.directory.path)
        missing = [each for each in report.findings if each.severity == "missing"]
        return f"```\n{report}\n```", [f"{each.subject}: {each.said} {each.remedy}".rstrip(". ") for each in missing]

    def _design(self) -> tuple[str, list]:
        task, about, _ = self._circle("slow circle", self.settings.slow_lap)
        bounds = self._guard().narrowed(recorded_share(self.directory)).input_bounds
        designed = self.design(self.settings.model, self.directory.trajectories(), task, bounds)
        path, report = designed.save(self.directory.path / ARTIFACT), designed.report
        self.directory.write("design.txt", f"{report}\n")
        found = "\n".join(f"- {sentence}" for sentence in getattr(report, "sentences", ()))
        return f"{about}\n\n```\n{report}\n```\n\n{found}\n\nModel and controller are in `{path.name}/`.", []

    def _slow_circle(self) -> tuple[str, list]:
        return self._drawn("slow circle", self.settings.slow_lap)

    def _fast_circle(self) -> tuple[str, list]:
        return self._drawn("fast circle", self.settings.fast_lap)

    def _drawn(self, step: str, lap: float) -> tuple[str, list]:
        from ssmr_torch.closed_loop.simulation import simulate
        from ssmr_torch.evaluation.metrics import closed_loop_metrics

        task, about, radius = self._circle(step, lap)
        controller = self.load(self.directory.path / ARTIFACT).controller(task)
        with self._moving(step) as guard:
            record = simulate(guard, controller, task, seed=self.settings.seed, progress=True)
        self.directory.keep_record(step, record)
        if self.settings.figures:
            self.directory.draw("circles", self.directory.records())
        found = closed_loop_metrics(record)
        faults = [f"the error of {1e3 * found['rmse']:.3g} mm is more than half of the radius"] \
            if found["rmse"] > 0.5 * radius else []
        decisions, share = int(np.isfinite(record.solve_time).sum()), 100 * found["rmse"] / radius
        said = (f"RMSE **{1e3 * found['rmse']:.3g} mm**, {share:.3g} % of the radius; at most "
                f"{1e3 * found['max_error']:.3g} mm; {found['fallbacks']:.0f} fallbacks of {decisions} decisions, "
                f"{1e3 * found['solve_time_p99']:.2g} ms each (99 %).")
        return f"{about}\n\n{said}", faults

    def _circle(self, name: str, lap: float) -> tuple[Task, str, float]:
        """The task, a sentence about it, and the radius in m."""
        data, rest = self.directory.trajectories(), np.array(self.directory.read_json("noise.json")["rest_m"])
        outputs = tuple(self.card.tracked) or tracked_outputs(data, rest)
        columns = data.columns(outputs)
        most = reach(data, outputs, rest[columns])
        radius, noise = self.settings.share_of_reach * most, self._std()[columns].max()
        if radius < FEWEST * noise:
            raise ValueError(f"the circle in {list(outputs)} would have a radius of {1e3 * radius:.3g} mm; expected "
                             f"{FEWEST} times the noise of {1e3 * noise:.2g} mm or more. Name two outputs that move to "
                             "all sides as tracked in the card")
        about = (f"Radius {1e3 * radius:.3g} mm in {outputs[0]} and {outputs[1]}, "
                 f"{100 * self.settings.share_of_reach:.3g} % of the reach of {1e3 * most:.3g} mm; {lap:g} s a lap.")
        return circle_about(rest[columns], radius, lap, self.settings.laps, outputs, name), about, radius

    def _std(self) -> np.ndarray:
        return np.array(self.directory.read_json("noise.json")["std_m"])

    def _guard(self) -> GuardedPlant:
        noisy = self.directory.has("noise.json") and bool((self._std() > 0).all())
        return GuardedPlant(self.plant, self.card, noisy=noisy)

    @contextmanager
    def _moving(self, step: str) -> Iterator[GuardedPlant]:
        """A guarded robot that always goes back to the neutral input at the end. A stopped run is kept and marked."""
        guard = self._guard()
        try:
            yield guard
        except SafetyStop as stop:
            self.directory.stopped(step, guard.run(step), guard, str(stop))
            raise
        finally:
            guard.relax()


def _five_minutes() -> Callable:
    """The setting excitation=five_minutes of the configuration."""
    from ssmr_torch import configuration

    return configuration.built(configuration.composed("collect", ["excitation=five_minutes"]).excitation)


def _load(folder: Path):
    from ssmr_torch.face import load

    return load(folder)


def _design(kind: str, data, task: Task, bounds: np.ndarray):
    from ssmr_torch.controller_design.design import design

    return design(kind, data, task, bounds)
