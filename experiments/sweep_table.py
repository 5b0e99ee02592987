"""What a sweep ends with: a ranked table, one figure, and the settings of the best job."""

import csv
import json
import re
from pathlib import Path

from hydra.experimental.callback import Callback
from omegaconf import OmegaConf

from ssmr_torch.evaluation import figures, study_figures


class SweepTable(Callback):
    """After a multirun, gather every job's result.json below the sweep's directory, those of an earlier part as well:

    sweep.csv: all jobs, best first by the first metric;  sweep.svg: score against parameters, fit time, step time and
    data (a training), or against the quantity that a study varies;  best.yaml: the best job's settings, in the shape
    of a file of conf/tuned.
    """

    def on_multirun_start(self, config, **kwargs) -> None:
        Path(config.hydra.sweep.dir).mkdir(parents=True, exist_ok=True)  # a study's database goes there before any job

    def on_multirun_end(self, config, **kwargs) -> None:
        directory = Path(config.hydra.sweep.dir)
        rows = gather(directory)
        if not rows:
            return
        columns = list(dict.fromkeys(column for row in sorted(rows, key=lambda row: "failed" in row) for column in row))
        first = next((column for column in columns[3:] if column != "failed"), "job")
        rows.sort(key=lambda row: (row.get(first) is None, row.get(first)))
        with open(directory / "sweep.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(rows)
        if any("parameters" in row for row in rows):
            draw(directory, rows, first, OmegaConf.select(config, "study"))
            OmegaConf.save(settings(rows[0]["overrides"]), directory / "best.yaml")
        show(directory, rows, columns, first)


def gather(directory: Path) -> list[dict]:
    rows = []
    for file in sorted(directory.glob("*/result.json")):
        result = json.loads(file.read_text())
        chosen = re.search(r"(?:^| )model=(\S+)", " ".join(result["overrides"]))
        rows.append({"job": file.parent.name, "model": chosen[1] if chosen else "",
                     "overrides": " ".join(result["overrides"]), **result["metrics"]})
    return rows


def draw(directory: Path, rows: list[dict], first: str, study) -> None:
    axis = (study or {}).get("axis")
    named = [row | {"model": row["model"] or "model"} for row in rows]
    if axis:
        named = [row | {axis: float(value[1])} for row in named
                 if (value := re.search(rf"(?:^| ){re.escape(axis)}=(\S+)", row["overrides"]))]
        part = "test" if any(row.get("test/rmse") is not None for row in named) else "validation"
        scores = [(f"{part}/rmse_50ms", "50 ms"), (f"{part}/rmse_200ms", "200 ms"), (f"{part}/rmse", "1 s")]
        figure = study_figures.trend(named, axis, scores, study["label"])
    else:
        figure = study_figures.ranking(named, first, first)
    figures.save(figure, directory / "sweep.svg")


def settings(overrides: str):
    """The overrides of model, fit, derivative and module as a configuration of package _global_."""
    chosen = [part for part in overrides.split() if part.startswith(("model.", "fit.", "derivative.", "module."))]
    return OmegaConf.from_dotlist(chosen)


def show(directory: Path, rows: list[dict], columns: list[str], first: str) -> None:
    print(f"\n{len(rows)} jobs, best first by {first}: {directory / 'sweep.csv'}")
    print(f"  job  {'  '.join(columns[3:])}  overrides")
    for row in rows:
        values = "  ".join(f"{row.get(column):.4g}" if isinstance(row.get(column), float) else str(row.get(column))
                           for column in columns[3:])
        print(f"  {row['job']:>3}  {values}  {row['overrides']}")
