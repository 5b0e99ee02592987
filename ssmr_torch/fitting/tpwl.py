"""Fit of trajectory piecewise linear (TPWL) models: replay of a finite-element robot, modes, linearized steps.

inputs of the training data ─plant→ snapshots ─SVD→ basis ─worst one-step error first→ points ─linearize, project→ maps
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from tqdm import tqdm

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.windows import Segment
from ssmr_torch.fitting.closed_form_fit import ExactSolve
from ssmr_torch.fitting.dimension import captured_variance
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.fitting.plant_replay import Replay, linearized_step, replayed
from ssmr_torch.keywords import configurable
from ssmr_torch.models.torch_model import fill
from ssmr_torch.models.tpwl import TPWL
from ssmr_torch.plants.finite_element.robot import FiniteElementRobot
from ssmr_torch.quantities import NOISE, TEXT, TRUTH
from ssmr_torch.ranges import Either, Number, Whole

FOREIGN = 0.02  # relative to the outputs' size: a replay with a larger error belongs to a different robot


def proper_orthogonal_modes(values: np.ndarray, directions: np.ndarray,
                            modes: int | str) -> tuple[np.ndarray, np.ndarray]:
    """Basis (N, r) of the first directions of (·, N), and the share of the variance that the first k directions
    capture.

    values: singular values of the displacements from rest. modes: r, or "variance:0.9999", the smallest number of modes
    that captures this share. Raises ValueError if the displacements do not span r directions.
    """
    captured = captured_variance(values)
    rank = int((values > 1e-12 * values[0]).sum())
    size = modes if isinstance(modes, int) else int(np.argmax(captured >= _share(modes))) + 1
    if size > rank:
        raise ValueError(f"modes is {size}, but the snapshots span only {rank} directions; use fewer modes or more "
                         "snapshots")
    return directions[:size].T, captured


class PlantLinearization:
    """Replays controlled training runs on the plant, starting at rest, and linearizes its steps along them.

    modes: number, or "variance:0.9999", see `proper_orthogonal_modes`. points: largest number of points. The next point
    is the snapshot whose velocity after one step the present model predicts worst, until that error is below
    `tolerance` times the rms velocity. snapshots: largest number of snapshots, evenly spaced, because full states are
    large. blend: width of the model, relative to the median distance of a point from its nearest neighbour; 0: nearest
    point. process_noise: factor on the covariance of the one-step errors, which is the process noise of the filter.
    measurement_noise: standard deviation of each output, m; the part of the outputs that the modes cannot represent is
    added. Raises ValueError for options out of range.
    """

    before = after = 0

    @checked(modes=Either(Whole(1, 10_000), TEXT, said="a whole number from 1 to 10000, or variance:SHARE"),
             points=Whole(1, 100_000), tolerance=Number(0.0, 1.0), snapshots=Whole(1, 1_000_000),
             blend=Number(0.0, 1e3), process_noise=Number(0.0, 1e12), measurement_noise=NOISE, progress=TRUTH)
    def __init__(self, plant: FiniteElementRobot | None, *, modes: int | str = 21, points: int = 400,
                 tolerance: float = 1e-3, snapshots: int = 1200, blend: float = 0.0, process_noise: float = 1.0,
                 measurement_noise: float = 1e-5, progress: bool = True):
        if not isinstance(modes, int):
            _share(modes)
        elif modes < 1:
            raise ValueError(f"modes is {modes}; expected 1 or more")
        if points < 1 or snapshots < points:
            raise ValueError(f"{points} points out of {snapshots} snapshots; expected at least 1 point, and as many "
                             "snapshots")
        if min(tolerance, blend, process_noise) < 0 or not measurement_noise > 0:
            raise ValueError(f"tolerance {tolerance}, blend {blend}, process_noise {process_noise} and "
                             f"measurement_noise {measurement_noise} m; expected no negative numbers, and a positive "
                             "measurement_noise")
        self.plant, self.modes, self.points, self.tolerance = plant, modes, int(points), float(tolerance)
        self.snapshots, self.blend, self.progress = int(snapshots), float(blend), bool(progress)
        self.process_noise, self.measurement_noise = float(process_noise), float(measurement_noise)
        self.begin()

    def begin(self, outputs: Sequence[str] = ()) -> None:
        """Start again without runs. The following runs have these outputs of the plant."""
        self._columns = [self.plant.output_names.index(name) for name in outputs]
        self._runs: list[list[np.ndarray]] = []
        self._observed: list[np.ndarray] = []

    def note(self, segment: Segment) -> None:
        """Add the core samples of a controlled segment to the replay; the first segment of a run starts at rest."""
        if segment.kind != "controlled":
            return
        core = slice(*segment.core)
        if segment.index == 0:
            self._runs.append([])
        self._runs[-1].append(segment.input[core].numpy())
        self._observed.append(segment.observation[core].numpy())

    def tables(self) -> dict[str, np.ndarray | float]:
        """All tables of a `TPWL` by name, and its width. `replay_error`: ‖y of the plant − y of the data‖ / ‖y of the
        data‖.
        """
        runs, measured = [np.concatenate(run) for run in self._runs], np.concatenate(self._observed)
        replay = replayed(self.plant, runs, self.snapshots, self.progress)
        self.replay_error = float(np.linalg.norm(replay.outputs[:, self._columns] - measured)
                                  / max(np.linalg.norm(measured), 1e-150))
        seen = replay.snapshots
        self.basis, self.captured = proper_orthogonal_modes(*replay.directions, self.modes)
        z, following = (np.hstack([a @ self.basis, b @ self.basis]) for a, b in (
            (seen.displacement, seen.velocity), (seen.next_displacement, seen.next_velocity)))
        points, (A, B, c), errors = self._along(replay, z, following)
        C = np.hstack([self.plant.output_matrix @ self.basis, np.zeros_like(self.plant.output_matrix @ self.basis)])
        d = self.plant.resting[list(self.plant.markers.values())].ravel() - self.plant.rest
        C, d, y = C[self._columns], d[self._columns], seen.output[:, self._columns]
        unseen = y - z @ C.T - d
        measurement = unseen.T @ unseen / len(y) + self.measurement_noise ** 2 * np.eye(y.shape[1])
        return {"points": points, "A": A, "B": B, "c": c, "C": C, "d": d, "mean": z.mean(0),
                "covariance": np.cov(z.T, bias=True), "process": self.process_noise * errors.T @ errors / len(errors),
                "measurement": measurement, "state_scale": np.abs(z).max(0), "width": self.blend * _spacing(points)}

    def _along(self, replay: Replay, z: np.ndarray, following: np.ndarray):
        """Points (N, r), their maps, and the one-step errors (S − N, 2r) of the snapshots in between."""
        r, inputs = self.basis.shape[1], replay.snapshots.input
        smallest = self.tolerance * np.sqrt((following[:, r:] ** 2).sum(1).mean())
        distances, errors = np.full(len(z), np.inf), np.empty_like(z)
        chosen, maps, worst = [], [], int((z[:, :r] ** 2).sum(1).argmin())
        for _ in tqdm(range(min(self.points, len(z))), desc="linearize", unit=" points", disable=not self.progress):
            A, B, c = linearized_step(self.plant, replay.projection(worst, r))
            distance = ((z[:, :r] - z[worst, :r]) ** 2).sum(1)
            nearer = distance < distances
            distances[nearer] = distance[nearer]
            errors[nearer] = z[nearer] @ A.T + inputs[nearer] @ B.T + c - following[nearer]
            chosen.append(worst)
            maps.append((A, B, c))
            left = np.linalg.norm(errors[:, r:], axis=1)
            left[chosen] = 0.0
            worst = int(left.argmax())
            if left[worst] <= smallest:
                break
        between = np.delete(errors, chosen, axis=0) if len(chosen) < len(z) else errors
        return z[chosen, :r], [np.stack(tables) for tables in zip(*maps)], between


class TPWLFit(ModelFit):
    """Linearizes a finite-element robot along the training data in one epoch; options as in `PlantLinearization`.

    The plant must have the inputs and the timestep of the data, and all their outputs. Raises ValueError at the start
    of training if it does not, if there is no plant, or if there are no controlled runs.
    remarks: sentences for the report. `solutions` stays empty, because there are no regressions.
    """

    epochs, kept = 1, ("remarks",)

    @configurable(PlantLinearization)
    def __init__(self, model: TPWL, *, plant: FiniteElementRobot | None = None, **options):
        super().__init__(model)
        self.procedure = PlantLinearization(plant, **options)
        self.automatic_optimization = False
        self.remarks: list[str] = []

    def configure_optimizers(self) -> ExactSolve:
        return ExactSolve(self.model.parameters())

    def on_train_start(self) -> None:
        if self.trainer.world_size > 1:
            raise ValueError(f"{self.trainer.world_size} processes; TPWL replays runs one after the other: use one "
                             "(trainer.devices=1)")
        check_plant(self.procedure.plant, self.card, self.model)
        if not any(run.kind == "controlled" for run in self.trainer.datamodule.training):
            raise ValueError("there are no controlled training runs, but TPWL linearizes the plant along them; record "
                             "some")
        self.procedure.begin(self.card["output_names"])

    @torch.no_grad()
    def training_step(self, segment: Segment, index: int) -> None:
        self.procedure.note(segment)
        if not self.trainer.is_last_batch:
            return
        self._take(self.procedure.tables())
        error = self.procedure.replay_error
        self.log_dict({"fit/points": float(self.model.count), "fit/modes": float(self.model.modes),
                       "fit/replay_error": error})
        if error > FOREIGN:
            self.remarks = [f"With the inputs of the data, the outputs of the plant differ by {100 * error:.3g} %. The "
                            "model describes the plant; choose parameters of the plant that are closer to the robot."]
        self.optimizers().step()

    def _take(self, tables: dict) -> None:
        self.model.resize(tables["points"].shape[1], len(tables["points"]), tables.pop("width"))
        fill([(getattr(self.model, name), values) for name, values in tables.items()])

    def on_load_checkpoint(self, checkpoint: dict) -> None:
        super().on_load_checkpoint(checkpoint)
        sizes = checkpoint["model"]["arguments"]
        self.model.resize(sizes["modes"], sizes["points"], sizes["width"])


def check_plant(plant, card: dict, model: TPWL) -> None:
    """Raises ValueError unless the plant is a finite-element robot with the inputs, bounds and timestep of the data in
    the card, and with all their outputs. Inputs may have other names, but must be in the same order.
    """
    if plant is None:
        raise ValueError("TPWL needs a plant, whose equations it linearizes; name the plant of the data, for example "
                         "plant=trunk")
    if not isinstance(plant, FiniteElementRobot):
        raise ValueError(f"the plant is a {type(plant).__name__}; TPWL needs a finite-element robot, such as "
                         "plant=trunk or plant=diamond")
    unknown = [name for name in card["output_names"] if name not in plant.output_names]
    if unknown:
        raise ValueError(f"the data have the outputs {unknown}, but the plant has only {list(plant.output_names)}; "
                         "leave these outputs out by outputs=…, or add these markers to the plant")
    if (len(card["input_names"]), card["input_unit"]) != (len(plant.input_names), plant.input_unit):
        raise ValueError(f"the data have the inputs {card['input_names']} in {card['input_unit']}, but the plant has "
                         f"{list(plant.input_names)} in {plant.input_unit}; name the plant of the data")
    if abs(model.base_timestep / plant.timestep - 1) > 1e-3:
        raise ValueError(f"the model's base timestep is {model.base_timestep:g} s, but the plant's timestep is "
                         f"{plant.timestep:g} s; set plant.timestep or model.base_timestep")
    highest, bound = np.max(card["input_range"][1]), plant.input_bounds[1].max()
    if (np.array(card["input_range"][1]) > plant.input_bounds[1] * (1 + 1e-9)).any():
        raise ValueError(f"the inputs of the data reach {highest:g} {plant.input_unit}, but the bound of the plant is "
                         f"{bound:g} {plant.input_unit}; set plant.input_bounds")


def _share(rule: str) -> float:
    name, _, share = str(rule).partition(":")
    try:
        value = float(share)
    except ValueError:
        value = 0.0
    if name != "variance" or not 0 < value < 1:
        raise ValueError(f'modes is {rule!r}; expected a number, or a rule such as "variance:0.9999"')
    return value


def _spacing(points: np.ndarray) -> float:
    """Median distance of a point from its nearest neighbour, 0 for a single one."""
    if len(points) < 2:
        return 0.0
    squared = ((points[:, None] - points) ** 2).sum(-1)
    np.fill_diagonal(squared, np.inf)
    return float(np.sqrt(np.median(squared.min(1))))
