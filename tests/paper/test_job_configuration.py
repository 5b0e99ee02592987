"""A result is kept while the composed configuration that it comes from stays the same, parents of its files too."""

import json
import re
import shutil
import uuid

import pytest

from ssmr_torch import configuration as composition
from ssmr_torch.configuration import composed, plain
from ssmr_torch.paper import job_configuration as configured
from ssmr_torch.paper.job_configuration import configuration
from ssmr_torch.paper.jobs import Job, plan
from ssmr_torch.paper.workflow import run


@pytest.fixture
def done(tmp_path):
    """Where all jobs of the miniature have left their products."""
    again(tmp_path)
    return tmp_path


def again(directory) -> set[str]:
    """Names of the jobs that are done by a run below a directory."""
    found = []

    def perform(job: Job) -> dict:
        (directory / job.product).parent.mkdir(parents=True, exist_ok=True)
        (directory / job.product).touch()
        found.append(job.name)
        return {"run": str(uuid.uuid4())}

    (directory / "jobs").mkdir(exist_ok=True)
    assert not run(jobs(), directory, perform)
    return set(found)


@pytest.fixture
def conf(tmp_path, monkeypatch, done):
    """A copy of the configurations that everything is composed from."""
    copy = shutil.copytree(composition.folder(), tmp_path / "conf")
    monkeypatch.setattr(composition, "folder", lambda: copy)
    yield copy
    configured._text.cache_clear()


def jobs() -> tuple[Job, ...]:
    return plan(plain(composed("reproduce", ["preset=miniature"]).preset)).jobs


def changed(done, file, line: str) -> set[str]:
    """Names of the jobs that are done again when a configuration file also says this of its target."""
    key = re.escape(line.partition(":")[0])
    without = re.sub(rf"^ *{key}:.*\n", "", file.read_text(), flags=re.MULTILINE)
    file.write_text(re.sub(r"^( *)_partial_: true", rf"\g<0>\n\g<1>{line}", without, count=1, flags=re.MULTILINE))
    configured._text.cache_clear()
    return again(done)


def test_a_value_in_the_parent_of_a_controller_changes_the_runs_that_inherit_it_and_what_comes_after(conf, done):
    """All controllers of the miniature but the static pregain's are scp.yaml or have it as their parent."""
    assert "- scp" in (conf / "controller" / "scp_trunk.yaml").read_text()
    runs = {job.name for job in jobs() if "period" in job.about and job.about["method"] != "static pregain"}
    assert len(runs) == 10
    assert changed(done, conf / "controller" / "scp.yaml", "terminal_weight: 0.123") == runs | {"delays/trunk"}


def test_a_value_in_what_trains_all_models_changes_these_and_all_that_is_made_of_them(conf, done):
    """train.yaml names trainer=cpu, the first entry of groups/trainer.yaml; no job does."""
    assert not [step for job in jobs() for step in job.steps if "trainer=cpu" in step.overrides]
    trained = {job.name for job in jobs() if not job.name.startswith("data/")}
    assert changed(done, conf / "groups" / "trainer.yaml", "gradient_clip_val: 0.5") == trained


def test_a_comment_changes_nothing(conf, done):
    assert not changed(done, conf / "controller" / "scp.yaml", "# as ever")


def test_how_the_work_is_shown_and_shared_out_changes_nothing():
    quiet, shown = (configuration("collect", [f"excitation.progress={shown}", f"workers={workers}", "plant=trunk"])
                    for shown, workers in (("false", 1), ("true", 3)))
    assert quiet == shown != configuration("collect", ["plant=trunk_coarse"])


def test_every_seed_is_a_configuration_of_its_own_composed_once_for_all(monkeypatch):
    configured._text.cache_clear()
    texts = [configuration("control", ["task=stanford_obstacles", f"seed={seed}", f"task.obstacles.seed={seed}"])
             for seed in range(4)]
    assert len(set(texts)) == 4 and configured._text.cache_info().misses == 1
    assert json.loads(texts[3])[1] == ["seed=3", "task.obstacles.seed=3"]


def test_a_default_of_the_code_is_part_of_it():
    assert "substeps" in json.loads(configuration("train", ["model=ssmr"]))[0]


def test_a_directory_of_the_run_is_not():
    assert str(composition.folder().parent) not in configuration("export", ["formats=[]"])
