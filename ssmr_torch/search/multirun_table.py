"""What a multirun ends with: a ranked table, one figure, and the found settings of a search."""

from __future__ import annotations

from pathlib import Path

from hydra.experimental.callback import Callback

from ssmr_torch.result_files import read_json, save_csv

NAMED = 2  # failed jobs in a message


class MultirunTable(Callback):
    """After a multirun, gather every job's result.json below its directory, those of an earlier part as well.

    sweep.csv: all jobs, best first by the first metric; of trainings sweep.svg: score against parameters, fit time,
    step time and data; of a study study.csv and study.svg: scores against the quantity that it varies; of a search
    found.yaml: the row of its best job, in a table of found settings, which save_to=FILE merges into another one.
    Where jobs of this multirun have failed, the command then ends with their reasons and status 1.
    """

    def __init__(self):
        self.before: dict[Path, int] = {}

    def on_multirun_start(self, config, **kwargs) -> None:
        self.before = written(Path(config.hydra.sweep.dir))

    def on_multirun_end(self, config, **kwargs) -> None:
        directory = Path(config.hydra.sweep.dir)
        try:
            self._end(directory, config)
        finally:  # also where a picture cannot be drawn, of which Hydra makes a warning
            refuse_failed(config.hydra.job.name, directory, self.before)

    def _end(self, directory: Path, config) -> None:
        rows = gather(directory)
        if not rows:
            return
        columns = list(dict.fromkeys(column for row in sorted(rows, key=lambda row: "failed" in row) for column in row))
        first = next((column for column in columns[3:] if column != "failed"), "job")
        rows.sort(key=lambda row: (row.get(first) is None, row.get(first)))
        save_csv(directory / "sweep.csv", [dict.fromkeys(columns) | row for row in rows])
        choices = config.hydra.runtime.choices
        if choices.get("study"):
            draw_study(directory, config.study)
        elif any("parameters" in row for row in rows):
            draw_ranking(directory, rows, first)
        show(directory, rows, columns, first, baselines(rows[0]))
        if choices.get("search") and isinstance(rows[0].get(first), float):  # else every job failed
            # imported here: every run has this callback, and only the end of a search writes found settings
            from ssmr_torch.search.best_row import save_best

            print(save_best(directory, config, rows, first))


def results(directory: Path) -> list[dict]:
    """Every job's result.json, with the number of the job."""
    files = sorted(directory.glob("*/result.json"))
    return [{"job": file.parent.name} | read_json(file) for file in files]


def written(directory: Path) -> dict[Path, int]:
    """When each job's result.json was written, ns."""
    return {file: file.stat().st_mtime_ns for file in directory.glob("*/result.json")}


def refuse_failed(name: str, directory: Path, before: dict[Path, int]) -> None:
    """Raises SystemExit where a job has failed whose result is not one of before."""
    new = {file.parent.name for file, when in written(directory).items() if before.get(file) != when}
    jobs = [job for job in results(directory) if job["job"] in new]
    failed = [f"job {job['job']}: {job['metrics']['failed'].removeprefix(f'{name}: ')}"
              for job in jobs if "failed" in job["metrics"]]
    if failed:
        which = f", the first {NAMED} of them so" if len(failed) > NAMED else ""
        raise SystemExit("\n".join([f"{name}: {len(failed)} of {len(jobs)} jobs failed{which}; all are in "
                                    f"{directory / 'sweep.csv'}", *failed[:NAMED]]))


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
    # imported here: every run has this callback, and only the end of a multirun draws
    from ssmr_torch.evaluation import figures, study_figures

    figures.save(study_figures.ranking(rows, first), directory / "sweep.svg")


def draw_study(directory: Path, study) -> None:
    """study.csv and study.svg: the scores over the varied override, or over what was measured of every record."""
    from ssmr_torch.evaluation import figures, study_figures
    from ssmr_torch.evaluation.study import study_rows

    rows = study_rows(results(directory), study.axis)
    if rows:
        save_csv(directory / "study.csv", rows)
        drawing = study_figures.trend(rows, study.axis, study.label, study.get("scale", 1.0))
        figures.save(drawing, directory / "study.svg")


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
