"""Everything of the paper, from data to report; the same command goes on where it was.

ssmr reproduce preset=quick

Jobs run as a multirun of this file, so that a launcher of Hydra spreads them: launcher=joblib, basic, submitit or ray.
"""

import csv
import fcntl
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import asdict
from importlib import import_module
from importlib.util import find_spec
from inspect import unwrap
from pathlib import Path

import h5py
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf, open_dict, read_write
from tqdm import tqdm

from ssmr_torch.configuration import composed, folder, own_folders
from ssmr_torch.deployment import artifact
from ssmr_torch.entry_point import entry_point, save_json
from ssmr_torch.paper.job_configuration import configuration
from ssmr_torch.paper.jobs import STAGES, Job, chosen, keys, plan, quoted, slower_runs, with_recordings
from ssmr_torch.paper.result_rows import MODEL_COLUMNS, RUN_COLUMNS, model_row, note_of, run_row
from ssmr_torch.paper.workspace_errors import map_open_loop
from ssmr_torch.provenance import provenance

SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
PARTIAL = "with what there was"  # in place of the hash of a job that some of its needs were missing for


@entry_point("reproduce")
def main(config, directory):
    if config.job is not None:
        return perform(Path(config.plan), config.job)
    for ended in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ended, lambda *_: sys.exit("reproduce: ended by a signal; the same command goes on"))
    settings = with_recordings(OmegaConf.to_container(config.preset, resolve=True), recordings(config.recordings))
    wanted = config.figures if isinstance(config.figures, str) else list(config.figures or [])
    figures, stages = chosen(settings, wanted), plan(settings, wanted)
    for module, install in ({config.launcher.module: config.launcher.install} | settings.get("needs", {})).items():
        if find_spec(module) is None:
            raise ValueError(f"{module} is not installed: {install}; launcher=basic needs no launcher's plugin")
    with locked(directory):
        failures = run_all(config, directory, settings, stages)
        tables(directory, settings)
        report(directory, figures)
    if failures:
        raise SystemExit("\n".join(["reproduce: something failed, and the same command tries it again", *failures]))
    return 0.0


def recordings(path: str | None) -> str | None:
    """Absolute path of the folder of recordings, which jobs read from wherever they run."""
    if path is None:
        return None
    found = Path(path).expanduser().resolve()
    if not found.is_dir():
        raise ValueError(f"recordings={path} is no folder; expected the one with the bench's decays.mat and "
                         "controlled_2022.mat, or null to leave the real bench out")
    return str(found)


@contextmanager
def locked(directory: Path):
    """One command at a time below a directory; what is left of an interrupted one is removed."""
    (directory / "jobs").mkdir(parents=True, exist_ok=True)
    with open(directory / "jobs" / "lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f"another command works in {directory}; wait, or take another hydra.run.dir") from error
        for path in (directory / "jobs").glob("plan-*.json"):
            path.unlink()
        try:
            shutil.rmtree(directory / "unfinished", ignore_errors=True)
            yield
        finally:
            for name in ("unfinished", "jobs/launched"):
                shutil.rmtree(directory / name, ignore_errors=True)


def run_all(config, directory: Path, settings: dict, stages: dict[str, list[Job]]) -> list[str]:
    """Run what is missing of each stage; a sentence for each job that failed or was left out."""
    planned, failures = [], []
    with tqdm(total=sum(map(len, stages.values())), desc="reproduce", unit=" jobs", smoothing=0) as bar:
        for stage in STAGES:
            jobs = stages[stage]
            if stage == STAGES[-1]:
                slower = again(directory, settings, planned)
                jobs, bar.total = [*slower, *jobs], bar.total + len(slower)
            planned += jobs
            hashes = keys(planned, configuration)
            done = {job.name for job in planned if is_done(directory, job, hashes[job.name])}
            ready = [job for job in jobs if job.name not in done
                     and (done.issuperset(job.needs) or job.steps[0].entry == "evaluate")]
            left_out = [job.name for job in jobs if job not in ready and job.name not in done]
            bar.update(len(jobs) - len(ready))
            if ready:
                hashes |= {job.name: PARTIAL for job in ready if not done.issuperset(job.needs)}
                failed = launch(config, directory, stage, ready, hashes, bar)
                failures += [f"{name}: {message}" for name, message in failed.items()]
            if left_out:
                failures.append(f"{len(left_out)} jobs were left out, as what they need failed: {left_out[0]} …")
    return failures


def launch(config, directory: Path, stage: str, jobs: list[Job], hashes: dict[str, str], bar: tqdm) -> dict[str, str]:
    """Run jobs as a multirun in a process of its own, and watch them end; messages of those that failed, by name."""
    folder = directory / "jobs"
    listed = folder / f"plan-{os.getpid()}.json"  # jobs of a command that is no longer there find no plan
    save_json(listed, {"root": str(directory), "jobs": [asdict(job) | {"key": hashes[job.name]} for job in jobs]})
    for job in jobs:
        status(directory, job.name).unlink(missing_ok=True)
    settings = OmegaConf.to_container(config.launcher.settings, resolve=True)
    command = [sys.executable, __file__, "-m", f"plan={quoted(str(listed))}",
               f"job={','.join(map(str, range(len(jobs))))}", f"hydra.sweep.dir={quoted(str(folder / 'launched'))}",
               "hydra.output_subdir=null", f"hydra/launcher={config.launcher.plugin}",
               *(f"hydra.launcher.{name}={value}" for name, value in settings.items()),
               *(word for own in own_folders() for word in ("--config-dir", own))]
    bar.set_postfix_str(stage)
    before, log = bar.n, folder / f"{stage.replace(' ', '_')}.log"
    with open(log, "w") as text:
        process = subprocess.Popen(command, stdout=text, stderr=subprocess.STDOUT, env=os.environ | SINGLE)
        try:
            while process.poll() is None:
                time.sleep(0.3)
                bar.update(before + sum(status(directory, job.name).is_file() for job in jobs) - bar.n)
        finally:
            end(process)
            listed.unlink(missing_ok=True)
    bar.update(before + len(jobs) - bar.n)
    ended = {job.name: read(status(directory, job.name)) for job in jobs}
    failed = {name: found.get("failed", f"it ended without a word; see {log}") for name, found in ended.items()
              if "key" not in found}
    for name, message in failed.items():
        bar.write(f"{name} failed: {message}")
    return failed


def end(process: subprocess.Popen) -> None:
    """Interrupt a multirun that still runs, so that its launcher ends the workers; one that does not end is killed."""
    for ask in (lambda: process.send_signal(signal.SIGINT), process.kill):
        if process.poll() is None:
            ask()
            with suppress(subprocess.TimeoutExpired):
                process.wait(30)


def again(directory: Path, settings: dict, planned: list[Job]) -> list[Job]:
    """The closed loops that are to be run once more at a longer period."""
    hashes = keys(planned, configuration)
    runs = [job for job in planned if "period" in job.about and is_done(directory, job, hashes[job.name])]
    return slower_runs(settings, runs, {job.name: read(directory / job.product)["solve_time_p99"] for job in runs})


def is_done(directory: Path, job: Job, key: str) -> bool:
    return read(status(directory, job.name)).get("key") == key and (directory / job.product).is_file()


def status(directory: Path, name: str) -> Path:
    return directory / "jobs" / f"{name}.json"


def read(path: Path) -> dict:
    return json.loads(path.read_text()) if path.is_file() else {}


def perform(listed: Path, number: int) -> float | None:
    """One job of a multirun: do its steps aside, move the result into place, and leave a note of how it ended."""
    if not listed.is_file():
        return None
    import torch

    torch.set_num_threads(1)
    stored = read(listed)
    root, job = Path(stored["root"]), stored["jobs"][number]
    begun, busy, target = time.perf_counter(), time.process_time(), root / job["name"]
    places = {"collect": target, "evaluate": target.parent}  # these leave nothing half done by themselves
    aside = places.get(job["steps"][0]["entry"], root / "unfinished" / f"{os.getpid()}" / job["name"])
    try:
        for step in job["steps"]:
            follow(step, job, root, aside)
        if aside not in (target, target.parent):
            shutil.rmtree(target, ignore_errors=True)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(aside, target)
        note = {"key": job["key"], "seconds": time.perf_counter() - begun, "cpu_seconds": time.process_time() - busy,
                "steps": job["steps"]}
    except Exception as error:
        cause = error.__cause__ or error
        kind = "" if isinstance(cause, (ValueError, OSError)) else f"{type(cause).__name__}: "
        note = {"failed": f"{kind}{cause}"}
        logging.getLogger(__name__).error(job["name"], exc_info=error)
    status(root, job["name"]).parent.mkdir(parents=True, exist_ok=True)
    save_json(status(root, job["name"]), note)
    return None


def follow(step: dict, job: dict, root: Path, directory: Path) -> None:
    """Compose the configuration of the step's entry point, and call its function with a directory of its own."""
    paths = {key: directory / path[2:] if path.startswith("./") else root / path for key, path in step["files"].items()}
    overrides = [*step["overrides"], *(f"{key}={quoted(str(path))}" for key, path in paths.items())]
    directory.mkdir(parents=True, exist_ok=True)
    with configured(step["entry"], overrides, directory) as config:
        if step["entry"] == "evaluate":
            open_loop(config, directory, {Path(need).name: root / need / "artifact" for need in job["needs"]
                                          if need.startswith("models/")}, Path(job["name"]).name)
        else:
            unwrap(import_module(f"ssmr_torch.experiments.{step['entry']}").main)(config, directory)


@contextmanager
def configured(entry: str, overrides: list[str], directory: Path):
    """The configuration of an entry point as Hydra would start it with these overrides in this directory."""
    before, config = HydraConfig.instance().cfg, composed(entry, overrides, hydra=True)
    with read_write(config.hydra), open_dict(config.hydra):
        config.hydra.runtime.output_dir = str(directory)
    HydraConfig.instance().set_config(config)
    with read_write(config), open_dict(config):
        del config["hydra"]
    try:
        yield config
    finally:
        HydraConfig.instance().cfg = before


def open_loop(config, directory: Path, artifacts: dict[str, Path], robot: str) -> None:
    """ROBOT.h5 and ROBOT.json: errors and scores of those models that there are."""
    loaded = {name: artifact.load(path) for name, path in artifacts.items() if path.is_dir()}
    if not loaded:
        raise ValueError(f"none of {', '.join(artifacts)} was trained")
    dataset = instantiate(config.data).observing(artifact.common_outputs(list(loaded.values())))
    runs = dataset.select(config.split, config.kind)
    found = map_open_loop({name: each.model for name, each in loaded.items()}, runs,
                          outputs=dataset.columns(config.outputs), starts=config.starts, seed=config.seed,
                          horizons=list(config.horizons))
    aside = directory / f"{robot}.h5.part"
    with h5py.File(aside, "w") as file:
        file["position"] = found.position
        for name, errors in found.errors.items():
            file[f"error/{name}"] = errors
    os.replace(aside, directory / f"{robot}.h5")
    save_json(directory / f"{robot}.json", {
        "scores": {name: score.as_dict() for name, score in found.scores.items()},
        "test": ", ".join(run.name for run in runs),
        "provenance": provenance(OmegaConf.to_container(config, resolve=True))})


def tables(directory: Path, settings: dict) -> None:
    """runs.csv and models.csv of all that is done, of whatever figure."""
    planned = [job for jobs in plan(settings).values() for job in jobs]
    planned += again(directory, settings, planned)
    hashes = keys(planned, configuration)
    done = [job for job in planned if is_done(directory, job, hashes[job.name])]
    runs = [run_row(job.about, read(directory / job.product), f"{job.name}/record.h5") for job in done
            if "period" in job.about]
    models = []
    for job in [job for job in done if "model" in job.about]:
        tuned = Path(folder(), "tuned", job.about["experiment"], f"{job.about['model']}.yaml")
        note = note_of(tuned.read_text() if tuned.is_file() else "")
        if own := settings["robots"][job.about["robot"]].get("train", {}).get(job.about["method"]):
            note = " ".join([f"Set by the preset: {' '.join(own)}.", *([f"The rest: {note}"] if note else [])])
        models.append(model_row(job.about, read(directory / job.name / "report.json")["cost"],
                                read(directory / job.product)["model"], note))
    for name, rows, columns in (("runs", runs, RUN_COLUMNS), ("models", models, MODEL_COLUMNS)):
        aside = directory / f"{name}.csv.part"
        with open(aside, "w", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(rows)
        os.replace(aside, directory / f"{name}.csv")


def report(directory: Path, figures: list[str]) -> None:
    """report.html of the chosen figures."""
    # imported here: no job draws
    from ssmr_torch.paper.report_sections import report_sections
    from ssmr_torch.report.html_page import write_report

    origin = {name: str(value) for name, value in provenance().items()}
    title = "Discovering dominant dynamics for nonlinear continuum robot control: what comes out"
    print(f"report: {write_report(directory, title, report_sections(directory, figures), origin)}")


if __name__ == "__main__":
    main()
