"""What a sweep ends with: a ranked table, one figure, and the settings of the best job."""

import csv
import json
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import OmegaConf

from ssmr_torch.configuration import folder

TUNED = ("model", "fit", "derivative")


class SweepTable(Callback):
    """After a multirun, gather every job's result.json below the sweep's directory, those of an earlier part as well.

    sweep.csv: all jobs, best first by the first metric; of trainings sweep.svg: score against parameters, fit time,
    step time and data; of a study study.csv and study.svg: scores against the quantity that it varies; of a search
    best.yaml: the best job's settings, to be copied to conf/tuned/EXPERIMENT/MODEL.yaml, or for a controller to
    conf/controller/NAME.yaml.
    """

    def on_multirun_end(self, config, **kwargs) -> None:
        directory = Path(config.hydra.sweep.dir)
        rows = gather(directory)
        if not rows:
            return
        columns = list(dict.fromkeys(column for row in sorted(rows, key=lambda row: "failed" in row) for column in row))
        first = next((column for column in columns[3:] if column != "failed"), "job")
        rows.sort(key=lambda row: (row.get(first) is None, row.get(first)))
        save(directory / "sweep.csv", rows, columns)
        standing = baselines(rows[0])
        choices = config.hydra.runtime.choices
        if choices.get("study"):
            draw_study(directory, config.study)
        elif any("parameters" in row for row in rows):
            draw_ranking(directory, rows, first)
        searched = {"sweep": save_best, "tuning": save_controller}
        for kind, save_settings in searched.items():
            if choices.get(kind) and isinstance(rows[0].get(first), float):  # else every job failed
                note = f"Found by {kind}={choices[kind]}: {first} {rows[0][first]:.4g} in job {rows[0]['job']}."
                save_settings(directory, rows[0], note, choices)
        show(directory, rows, columns, first, standing)


def results(directory: Path) -> list[dict]:
    """Every job's result.json, with the number of the job."""
    files = sorted(directory.glob("*/result.json"))
    return [{"job": file.parent.name} | json.loads(file.read_text()) for file in files]


def gather(directory: Path) -> list[dict]:
    """One row per job: its number, the model's name, its overrides, its metrics, and what it cost."""
    return [{"job": result["job"], "model": result.get("name") or "", "overrides": " ".join(result["overrides"]),
             **result["metrics"], **result.get("cost", {})} for result in results(directory)]


def baselines(row: dict) -> list[dict]:
    """What persistence and constant velocity make from the starts of a job, under the names of its scores."""
    found = []
    for name in ("persistence", "constant velocity"):
        ending = f"_{name.replace(' ', '_')}"
        scores = {column.removesuffix(ending): value for column, value in row.items() if column.endswith(ending)}
        if scores:
            found.append({"job": "–", "model": name} | scores)
    return found


def draw_ranking(directory: Path, rows: list[dict], first: str) -> None:
    # imported here: every run has this callback, and only the end of a sweep draws
    from ssmr_torch.evaluation import figures, study_figures

    figures.save(study_figures.ranking(rows, first), directory / "sweep.svg")


def draw_study(directory: Path, study) -> None:
    """study.csv and study.svg: the scores over the varied override, or over what was measured of every record."""
    from ssmr_torch.evaluation import figures, study_figures
    from ssmr_torch.evaluation.study import study_rows

    rows = study_rows(results(directory), study.axis)
    if rows:
        save(directory / "study.csv", rows, list(rows[0]))
        drawing = study_figures.trend(rows, study.axis, study.label, study.get("scale", 1.0))
        figures.save(drawing, directory / "study.svg")


def save(path: Path, rows: list[dict], columns: list[str]) -> None:
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def save_best(directory: Path, best: dict, note: str, choices) -> None:
    """best.yaml: what was tuned before (unless ~tuned left it out), and over it the best job's overrides of model, fit,
    derivative and the transient that is cut. Another fit or derivative is written out, as composed in the best job:
    Hydra lets no file below conf/tuned choose one.
    """
    before = folder() / "tuned" / str(choices.get("experiment")) / f"{choices.model}.yaml"
    settings = OmegaConf.load(before) if choices.get("tuned") and before.is_file() else OmegaConf.create()
    for override in overrides_of(directory, best):
        section, _, rest = override.key_or_group.partition(".")
        if (section in TUNED and rest) or override.key_or_group == "module.transient":
            OmegaConf.update(settings, override.key_or_group, override.value(), force_add=True)
        elif section in TUNED and section != "model":
            composed = OmegaConf.load(directory / best["job"] / ".hydra" / "config.yaml")
            OmegaConf.update(settings, section, composed[section], force_add=True)
    (directory / "best.yaml").write_text(f"# @package _global_\n# {note}\n{OmegaConf.to_yaml(settings)}")


def save_controller(directory: Path, best: dict, note: str, choices) -> None:
    """best.yaml: the controller that was searched, with the best job's overrides."""
    observer = choices.get("observer@controller.observer", "none")  # a static pregain has no place for one
    observers = [{"override /observer@observer": observer}] if observer != "none" else []
    settings = OmegaConf.create({"defaults": [choices.controller, *observers, "_self_"]})
    for override in overrides_of(directory, best):
        section, _, rest = override.key_or_group.partition(".")
        if section == "controller" and rest:
            OmegaConf.update(settings, rest, override.value(), force_add=True)
    (directory / "best.yaml").write_text(f"# {note}\n{OmegaConf.to_yaml(settings)}")


def overrides_of(directory: Path, row: dict) -> list:
    overrides = json.loads((directory / row["job"] / "result.json").read_text())["overrides"]
    return OverridesParser.create().parse_overrides(overrides)


def show(directory: Path, rows: list[dict], columns: list[str], first: str, standing: list[dict]) -> None:
    """The table, on the terminal, with the baselines below: of the overrides those in which the jobs differ."""
    common = set.intersection(*(set(row["overrides"].split()) for row in rows)) if len(rows) > 1 else set()
    print(f"\n{len(rows)} jobs, best first by {first}: {directory / 'sweep.csv'}")
    columns = [column for column in columns if not column.endswith(("_persistence", "_constant_velocity"))]
    print(f"  job  model  {'  '.join(columns[3:])}  overrides")
    for row in [*rows, *standing]:
        found = [row.get(column) for column in columns[3:]]
        values = "  ".join(f"{each:.4g}" if isinstance(each, float) else "–" if each is None else str(each)
                           for each in found)
        differing = " ".join(part for part in row.get("overrides", "").split() if part not in common)
        print(f"  {row['job']:>3}  {row['model']}  {values}  {differing}")
