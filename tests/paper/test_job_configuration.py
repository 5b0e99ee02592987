"""A result is kept while the composed configuration that it comes from stays the same, parents of its files too."""

import json
import re
import shutil

import pytest
from omegaconf import OmegaConf

from ssmr_torch import configuration as composition
from ssmr_torch.configuration import composed
from ssmr_torch.paper import job_configuration as configured
from ssmr_torch.paper.job_configuration import configuration
from ssmr_torch.paper.jobs import Job, keys, plan


@pytest.fixture(scope="module")
def before():
    """Keys of all jobs of the miniature."""
    return keys(jobs(), configuration)


@pytest.fixture
def conf(tmp_path, monkeypatch, before):
    """A copy of the configurations that everything is composed from."""
    copy = shutil.copytree(composition.folder(), tmp_path / "conf")
    monkeypatch.setattr(composition, "folder", lambda: copy)
    yield copy
    configured._text.cache_clear()


def jobs() -> list[Job]:
    settings = OmegaConf.to_container(composed("reproduce", ["preset=miniature"]).preset, resolve=True)
    return [job for stage in plan(settings).values() for job in stage]


def changed(before, file, line: str) -> set[str]:
    """Names of the jobs whose results are no longer kept when a configuration file also says this of its target."""
    key = re.escape(line.partition(":")[0])
    without = re.sub(rf"^ *{key}:.*\n", "", file.read_text(), flags=re.MULTILINE)
    file.write_text(re.sub(r"^( *)_partial_: true", rf"\g<0>\n\g<1>{line}", without, count=1, flags=re.MULTILINE))
    configured._text.cache_clear()
    after = keys(jobs(), configuration)
    return {name for name in before if before[name] != after[name]}


def test_a_value_in_the_parent_of_a_controller_changes_the_runs_that_inherit_it_and_what_comes_after(conf, before):
    """All controllers of the miniature but the static pregain's are scp.yaml or have it as their parent."""
    assert "- scp" in (conf / "controller" / "scp_trunk.yaml").read_text()
    runs = {job.name for job in jobs() if "period" in job.about and job.about["method"] != "static pregain"}
    assert len(runs) == 10
    assert changed(before, conf / "controller" / "scp.yaml", "terminal_weight: 0.123") == runs | {"delays/trunk"}


def test_a_value_in_what_trains_all_models_changes_these_and_all_that_is_made_of_them(conf, before):
    """train.yaml names trainer=cpu, the first entry of groups/trainer.yaml; no job does."""
    assert not [step for job in jobs() for step in job.steps if "trainer=cpu" in step.overrides]
    trained = {job.name for job in jobs() if not job.name.startswith("data/")}
    assert changed(before, conf / "groups" / "trainer.yaml", "gradient_clip_val: 0.5") == trained


def test_a_comment_changes_nothing(conf, before):
    assert not changed(before, conf / "controller" / "scp.yaml", "# as ever")


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
