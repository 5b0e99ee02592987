"""From CSV files and a card of ten lines to a controller, by the commands that a user types.

The robot is the package's analytic trunk; only its CSV files are read from then on.
python docs/tutorials/your_own_data.py runs everything in outputs/tutorial and draws the tutorial's figures.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import SmoothRandom
from ssmr_torch.documents.results import store_tables
from ssmr_torch.evaluation import figures
from ssmr_torch.plants.slow_manifold import SlowManifold

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "docs" / "figures"
DECAYS = 12

# --8<-- [start:card]
CARD = """\
files: [FILES]
columns:
  time: t
  observation: [tip_x, tip_y, tip_z]
  input: [cable_+x, cable_-x, cable_+y, cable_-y]
units: {length: mm, input: N, time: s}
rest: last sample of decays
decays: [RELEASES]
split: {validation: [run_3], test: [check]}
"""
# --8<-- [end:card]


# --8<-- [start:record]
def record(folder, decays=DECAYS, duration=15.0):
    """Releases, random inputs and a check run of the robot, one CSV file each, and the card that says what they are."""
    inputs = SmoothRandom(knot_interval=0.4, share=0.5)
    runs = [ControlledRun(name=f"run_{number}", split="train", duration=duration, excitation=inputs)
            for number in (1, 2, 3)]
    runs.append(ControlledRun(name="check", split="test", duration=10.0,
                              excitation=SmoothRandom(knot_interval=0.25, share=0.5)))
    data = collect(SlowManifold(), decays=decays, validation_decays=0, test_decays=0, controlled=runs, progress=False)
    names = [f"release_{number + 1}" for number in range(decays)] + ["run_1", "run_2", "run_3", "check"]
    for name, run in zip(names, data):
        write(folder / f"{name}.csv", run.read(), data.rest)
    card = CARD.replace("FILES", ", ".join(f"{name}.csv" for name in names))
    (folder / "card.yaml").write_text(card.replace("RELEASES", ", ".join(names[:decays])))


def write(path, run, rest):
    """Time in s, the tip's position in mm, the cables' forces in N."""
    tip = 1e3 * (run.observation + rest)[:, :3]
    header = "t,tip_x,tip_y,tip_z,cable_+x,cable_-x,cable_+y,cable_-y"
    np.savetxt(path, np.column_stack([run.time, tip, run.input]), "%.6f", ",", header=header, comments="")
# --8<-- [end:record]


# --8<-- [start:commands]
COMMANDS = """
ssmr train data=custom data.card=robot/card.yaml model=ssmr hydra.run.dir=train/ssmr
ssmr train data=custom data.card=robot/card.yaml model=sssr hydra.run.dir=train/sssr
ssmr export checkpoint=train/ssmr/model.ckpt artifact=SSMR
ssmr export checkpoint=train/sssr/model.ckpt artifact=SSSR
ssmr evaluate artifact=[SSMR,SSSR] data=custom data.card=robot/card.yaml hydra.run.dir=evaluate
ssmr control artifact=SSMR task=letter observer@controller.observer=output_disturbance hydra.run.dir=control/ssmr
ssmr control artifact=SSSR task=letter observer@controller.observer=output_disturbance hydra.run.dir=control/sssr
ssmr report directory=.
"""
# --8<-- [end:commands]


def run(command, folder):
    done = subprocess.run([Path(sys.executable).with_name("ssmr"), *command.split()[1:]], cwd=folder,
                          capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{command}\n{done.stdout}{done.stderr}")
    return done.stdout


def found(folder):
    """What the commands wrote: eigenvalues, errors at the horizons, and errors in closed loop."""
    report = json.loads((folder / "train" / "ssmr" / "report.json").read_text())
    scores = json.loads((folder / "evaluate" / "scores.json").read_text())["scores"]
    tracking = {name: json.loads((folder / "control" / name / "metrics.json").read_text())
                for name in ("ssmr", "sssr")}
    return {"eigenvalues": np.array([complex(*value) for value in report["closed_form"]["eigenvalues"]]),
            "true eigenvalues": SlowManifold().eigenvalues[:6],
            "warnings": report["closed_form"]["warnings"],
            "errors, mm": {name: {part["label"]: np.inf if part["mean"] is None else 1e3 * part["mean"]
                                  for part in score["horizons"]} for name, score in scores.items()},
            "letter, mm": {name: 1e3 * metrics["rmse"] for name, metrics in tracking.items()},
            "fallbacks": {name: metrics["fallbacks"] for name, metrics in tracking.items()}}


def draw(folder, directory):
    records = {name.upper(): ClosedLoopRecord.load(folder / "control" / name / "record.h5")
               for name in ("ssmr", "sssr")}
    one = records["SSMR"]
    paths = {name: each.observation[:, list(each.tracked)] for name, each in records.items()}
    figures.save(figures.tracking(one.time, one.reference, paths, ("tip x", "tip y")),
                 Path(directory) / "tutorial_own_data_letter.svg")
    shutil.copy(folder / "evaluate" / "error_over_horizon.svg", Path(directory) / "tutorial_own_data_errors.svg")


def main(directory=FIGURES, folder=ROOT / "outputs" / "tutorial", quick=False):
    """Everything in `folder`; quick: shorter recordings."""
    folder = Path(folder)
    (folder / "robot").mkdir(parents=True, exist_ok=True)
    record(folder / "robot", **({"duration": 12.0} if quick else {}))
    for command in COMMANDS.strip().splitlines():
        print(f"{command}\n{run(command, folder)}")
    draw(folder, directory)
    return found(folder)


def tables(found):
    """What the page shows, by name of the store."""
    errors = found["errors, mm"]
    labels = [label for label in next(iter(errors.values())) if label != "full"]
    return {"tutorial_own_data_eigenvalues": (["eigenvalues", "1/s"], [
                ["fitted", rates(found["eigenvalues"])], ["of the robot", rates(found["true eigenvalues"])]]),
            "tutorial_own_data_errors": (["error (mm)", *labels], [
                [name, *(float(error[label]) for label in labels)] for name, error in errors.items()]),
            "tutorial_own_data_letter": (["model", "RMSE (mm)", "fallbacks"], [
                [name.upper(), value, round(found["fallbacks"][name])] for name, value in found["letter, mm"].items()])}


def rates(eigenvalues):
    """One of each pair of eigenvalues in words, slowest first."""
    pairs = sorted((value for value in eigenvalues if value.imag > 0), key=lambda value: value.imag)
    return ", ".join(f"{value.real:.2f} ± {value.imag:.2f}i".replace("-", "−") for value in pairs)


if __name__ == "__main__":
    store_tables(ROOT, tables(main()), "python docs/tutorials/your_own_data.py")
