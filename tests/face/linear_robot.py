"""An exactly linear robot, on which the face is tried."""

import numpy as np
from scipy.linalg import expm

DT, HOLD = 0.01, 12  # s, samples that an input is held


def linear_run(inputs, x):
    """A run of dx/dt = A x + B u, y = C x in mm, exact at the samples.

    Four states and three outputs: two samples and the input between them determine the state, so that DMD is exact.
    """
    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = [[-1.5, 12.5], [-12.5, -1.5]], [[-1.8, 15.0], [-15.0, -1.8]]
    B = np.array([[30.0, 5.0], [10.0, -20.0], [-8.0, 40.0], [25.0, 12.0]])
    C = np.array([[1.0, 0.2, 0.3, -0.1], [-0.2, 0.9, 0.1, 0.6], [0.25, -0.3, 0.2, 0.1]])
    step = expm(DT * np.block([[A, B], [np.zeros((2, 6))]]))

    outputs = []
    for u in inputs:
        outputs.append(C @ x)
        x = step[:4, :4] @ x + step[:4, 4:] @ u
    return DT, np.array(outputs), inputs


def linear_robot(seed=0):
    """Six decays and four runs under held inputs."""
    rng = np.random.default_rng(seed)
    decays = [linear_run(np.zeros((300, 2)), 12.0 * rng.normal(size=4)) for _ in range(6)]
    controlled = [linear_run(np.repeat(2.0 * rng.uniform(-1, 1, (70, 2)), HOLD, axis=0), np.zeros(4)) for _ in range(4)]
    return {"decays": decays, "controlled": controlled[:3], "test": controlled[3:]}


NAMES = {"output_names": ("x", "y", "z"), "input_names": ("left", "right")}
MILLIMETRES = {"units": {"length": "mm", "input": "1", "time": "s"}}


def started(data, model, start, horizon):
    """Window, inputs and past inputs at a sample of the test run, and what was measured after it."""
    run, reach = data.select("test")[0], round(model.window_timestep / DT)
    rows = start - reach * np.arange(model.delays, -1, -1)
    past = np.stack([run.input[row:row + reach].mean(axis=0) for row in rows[:-1]])
    return run.observation[rows], run.input[start:start + horizon], past, run.observation[start + 1:start + 1 + horizon]


def write_card(folder):
    """Files of `linear_robot` in mm, to the last digit, and their card."""
    runs = linear_robot()
    names = {part: [f"{part[0]}{number}" for number in range(len(of_part))] for part, of_part in runs.items()}
    for part, of_part in runs.items():
        for name, (dt, y, u) in zip(names[part], of_part):
            np.savetxt(folder / f"{name}.csv", np.c_[dt * np.arange(len(y)), y, u], delimiter=",", comments="",
                       header="t,x,y,z,left,right", fmt="%.17g")
    (folder / "robot.yaml").write_text(f"""
files: {[f'{name}.csv' for part in names.values() for name in part]}
columns: {{time: t, observation: ["x", "y", "z"], input: [left, right]}}
units: {{length: mm, input: "1", time: s}}
rest: [0, 0, 0]
decays: {names['decays']}
split: {{test: {names['test']}}}
""")
    return {part: dict(zip(names[part], of_part)) for part, of_part in runs.items()}
