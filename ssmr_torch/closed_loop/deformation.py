"""Shapes of a finite-element robot during a run in closed loop, computed by replaying its record."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.robot_figures import HANGING, STANDING, add_circles, robot_animation, robot_stills

STILLS = 5
FRAMES_PER_SECOND = 25.0


def replayed_shapes(plant, record: ClosedLoopRecord, samples: np.ndarray) -> np.ndarray:
    """Node positions (K, N, 3), m, at these samples (ascending). The plant starts at rest, with the record's inputs and
    seed.

    plant: a `FiniteElementRobot`, or a rig with one. Raises ValueError if the replay does not end where the record
    ends, because then the plant is a different one.
    """
    robot = getattr(plant, "plant", plant)
    plant.reset(record.provenance["seed"])
    shapes = [robot.positions] if samples[0] == 0 else []
    for k, tensions in enumerate(record.input[:samples[-1]], 1):
        plant.step(tensions)
        if k in samples:
            shapes.append(robot.positions)
    missed = np.abs(plant.displacement - record.observation[samples[-1]]).max()
    if missed > 1e-9:
        raise ValueError(f"the replay ends {1e3 * missed:.3g} mm away from the record; expected at most 1e-6 mm. "
                         "Replay it with the plant with which the record was made")
    return np.stack(shapes)


def draw_robot(plant, record: ClosedLoopRecord, directory: Path, animate: bool = False, obstacles=()) -> list[Path]:
    """Save robot.svg (the robot at five instants) and, if `animate`, robot.gif. A plant without a shape gives no file.

    The tip is the plant's first marker; without it in the record, nothing is drawn. The reference is drawn if the task
    tracks only coordinates of the tip. Circular obstacles are drawn if these are two coordinates.
    """
    robot = getattr(plant, "plant", plant)
    if not hasattr(robot, "positions") or tuple(record.output_names[:3]) != tuple(robot.output_names[:3]):
        return []
    last = len(record.time) - 1
    tip = record.observation[:, :3] + robot.rest[:3]
    plane = list(record.tracked) if set(record.tracked) <= {0, 1, 2} else None
    reference = None
    if plane is not None:
        reference = np.tile(robot.rest[:3], (len(record.time), 1))
        reference[:, plane] += record.reference
    drawn = {"tip_times": record.time, "camera": HANGING if robot.hangs else STANDING,
             "plane": plane if plane is not None and len(plane) == 2 else None,
             "name": record.provenance.get("model", "model")}
    samples = np.round(np.linspace(0.0, 1.0, STILLS + 1)[1:] * last).astype(int)
    stills = robot_stills(replayed_shapes(plant, record, samples), robot.surface, record.time[samples], tip, reference,
                          rest=robot.resting, **drawn)
    circles = [obstacle for obstacle in obstacles if hasattr(obstacle, "radius")]
    if circles and drawn["plane"] is not None:
        centers = np.stack([circle.centers(record.time[samples]) for circle in circles], axis=1)
        add_circles(stills, centers + robot.rest[plane], np.array([circle.radius for circle in circles]))
    saved = [figures.save(stills, directory / "robot.svg")]
    if animate:
        samples = np.arange(0, last + 1, max(1, round(1 / FRAMES_PER_SECOND / plant.timestep)))
        saved.append(robot_animation(directory / "robot.gif", replayed_shapes(plant, record, samples), robot.surface,
                                     record.time[samples], tip, reference, rest=robot.resting,
                                     rate=FRAMES_PER_SECOND, **drawn))
    return saved
