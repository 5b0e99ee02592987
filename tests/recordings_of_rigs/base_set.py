"""A set of recordings with a known answer: two modes, three coordinates, two inputs, and faults that a test puts in."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from scipy.linalg import expm

import ssmr_torch
from ssmr_torch.data.card_reader import custom

RATES = np.array([[-1.5, 12.5, 0, 0], [-12.5, -1.5, 0, 0], [0, 0, -1.8, 15], [0, 0, -15, -1.8]])  # 1/s
PUSH = np.array([[30, 5], [10, -20], [-8, 40], [25, 12.0]])
TIP = np.array([[1, 0.2, 0.3, -0.1], [-0.2, 0.9, 0.1, 0.6], [0.25, -0.3, 0.2, 0.1]])
ELBOW = np.array([[0.5, 0.3, 0.1, 0.2], [-0.1, 0.4, 0.3, 0.3], [0.1, -0.2, 0.4, 0.1]])
REST, ELBOW_REST = np.array([5.0, -3.0, 120.0]), np.array([4.0, -2.0, 60.0])  # mm
DECAYS, CONTROLLED = [f"d{place}" for place in range(1, 7)], ["c1", "c2", "c3", "test"]


@dataclass
class Run:
    """Columns of one file: t (T,), y (T, p) in mm, u (T, m), or the text of the file as it is."""

    t: np.ndarray
    y: np.ndarray
    u: np.ndarray
    text: str | None = None


@dataclass
class Rig:
    """The recordings and their card, to be changed by a test, and then written, read and fitted."""

    folder: Path
    runs: dict[str, Run]
    outputs: list[str]
    card: dict
    format: str = "%.6g"
    said: list[str] = field(default_factory=list)

    def write(self) -> Path:
        header = ",".join(["t", *self.outputs, "u1", "u2"])
        for name, run in self.runs.items():
            path = self.folder / f"{name}.csv"
            if run.text is not None:
                path.write_text(run.text)
                continue
            np.savetxt(path, np.c_[run.t, run.y, run.u], delimiter=",", header=header, comments="", fmt=self.format)
        card = self.folder / "card.yaml"
        card.write_text(yaml.safe_dump({"files": [f"{name}.csv" for name in self.runs]} | self.card, sort_keys=False))
        return card

    def read(self):
        """The dataset; what was said of its faults is in `said`, one text a note."""
        data = custom(self.write())
        self.said = [f"{note['run']}: {note['said']}" for note in data.provenance["notes"]]
        return data

    def error(self) -> float:
        """Test RMSE, mm, of a linear model of four states fitted to what was read."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fitted = ssmr_torch.fit(self.read(), "sssr", state_dim=4)
        return 1e3 * fitted.scores["test/rmse"]

    def refused(self) -> str:
        """The message with which reading or fitting is refused; "" when it is not."""
        try:
            self.error()
        except ValueError as error:
            return str(error)
        return ""

    def refused_or_within(self, limit: float, *words: str) -> None:
        """Refused or said, with all these words in one message; the error is within the limit where it is fitted."""
        try:
            error, texts = self.error(), self.said
            assert error <= limit, f"{error:.3g} mm, more than {limit} mm; said was {texts}"
        except ValueError as refusal:
            texts = [str(refusal)]
        assert any(all(word in text for word in words) for text in texts), f"no text has {words}: {texts}"


def base_set(folder: Path, markers: int = 1) -> Rig:
    """Six decays of 3 s, three controlled runs and a test of 15 s at 100 Hz, with 0.02 mm of noise."""
    rates = np.zeros((6, 6))
    rates[:4, :4], rates[:4, 4:] = RATES, PUSH
    step = expm(0.01 * rates)
    random = np.random.default_rng(0)
    seen = np.vstack([TIP, ELBOW][:markers])
    rest = np.concatenate([REST, ELBOW_REST][:markers])

    def run(u, x) -> Run:
        states = []
        for value in u:
            states.append(x)
            x = step[:4, :4] @ x + step[:4, 4:] @ value
        y = np.array(states) @ seen.T + 0.02 * random.normal(size=(len(u), len(seen))) + rest
        return Run(0.01 * np.arange(len(u)), y, u)

    runs = {name: run(np.zeros((300, 2)), random.normal(size=4) * 12) for name in DECAYS}
    for name in CONTROLLED:
        runs[name] = run(np.repeat(2 * random.uniform(-1, 1, (126, 2)), 12, 0)[:1500], np.zeros(4))
    outputs = ["x", "y", "z"] if markers == 1 else ["ax", "ay", "az", "bx", "by", "bz"]
    return Rig(folder, runs, outputs, {
        "columns": {"time": "t", "observation": outputs, "input": ["u1", "u2"]},
        "units": {"length": "mm", "input": "1", "time": "s"}, "rest": rest.tolist(),
        "decays": list(DECAYS), "split": {"test": ["test"]}})


def small(folder: Path, text: str | None = None, **card) -> Rig:
    """A run m of 20 rows: x = 5 + 0.1 k mm, u1 = 0.01 k, t = k / 100 s; or the same in other words."""
    k = np.arange(20.0)
    run = Run(k / 100, np.c_[5 + 0.1 * k, -3 + 0 * k, 120 + 0 * k], np.c_[0.01 * k, 0 * k], text)
    return Rig(folder, {"m": run}, ["x", "y", "z"], {
        "columns": {"time": "t", "observation": ["x", "y", "z"], "input": ["u1", "u2"]},
        "units": {"length": "mm", "input": "1", "time": "s"}, "rest": [5, -3, 120]} | card)
