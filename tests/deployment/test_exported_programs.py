"""Forms beside an artifact's tables: whole or not at all, and the artifact loads as before."""

import subprocess
import sys
from pathlib import Path

import pytest

from ssmr_torch.deployment import artifact
from ssmr_torch.deployment import exported_programs as deploy
from ssmr_torch.deployment.c import compiled_library as c_library

EXPORT = Path(__file__).resolve().parents[2] / "experiments" / "export.py"


def files_of(directory):
    return {path.name: path.read_bytes() for path in (directory / "deployed").iterdir()}


def export(*arguments, at):
    return subprocess.run([sys.executable, str(EXPORT), *arguments, f"hydra.run.dir={at}/run"], capture_output=True,
                          text=True, cwd=at)


@pytest.fixture
def with_compiler():
    if c_library.compiler() is None:
        pytest.skip("no C compiler was found (cc, gcc, clang, or the program in the variable CC)")


def test_forms_lie_beside_the_tables_and_the_artifact_loads_as_before(saved, with_compiler):
    [form] = deploy.deploy(saved, ["c"])
    assert set(files_of(saved)) == {"ssmr_ours.c", "ssmr_ours.h"} == set(form.files)
    assert form.error <= 1e-13 and "ssmr_ours.c, ssmr_ours.h: equal to the model within" in str(form)
    artifact.load(saved)
    assert {path.name for path in saved.parent.iterdir()} == {"artifact"}


def test_a_new_format_is_added_beside_the_existing_ones(saved):
    deploy.deploy(saved, ["c"])
    deploy.deploy(saved, ["torch"])
    assert set(files_of(saved)) == {"ssmr_ours.c", "ssmr_ours.h", "encode.pt2", "decode.pt2", "step.pt2",
                                    "step_jacobians.pt2"}


def test_a_form_that_differs_from_the_model_leaves_the_older_file_as_it_was(saved, with_compiler, monkeypatch):
    deploy.deploy(saved, ["c"])
    before, write = files_of(saved), deploy.write_c

    def spoiled(model, card):
        name, source, header = write(model, card)
        return name, source.replace("next[i] = x[i];", "next[i] = x[i] * (1.0 + 1e-9);"), header

    monkeypatch.setattr(deploy, "write_c", spoiled)
    with pytest.raises(ValueError, match="c: step differs from the model's by 1e-09 relative; at most 1e-12"):
        deploy.deploy(saved, ["c"])
    assert files_of(saved) == before
    assert {path.name for path in saved.parent.iterdir()} == {"artifact"}


def test_other_files_beside_an_artifact_are_kept_whatever_their_names(saved):
    for name in ("artifact.part", "artifact.old", "artifact.deployed.part"):
        (saved.parent / name).mkdir()
        (saved.parent / name / "mine").write_text("kept")
    deploy.deploy(saved, ["c"])
    loaded = artifact.load(saved)
    artifact.save(saved, loaded.model, **{key: loaded.card[key] for key in ("output_names", "input_names", "rest",
                                                                            "input_range")})
    assert sorted(path.parent.name for path in saved.parent.glob("*/mine")) == [
        "artifact.deployed.part", "artifact.old", "artifact.part"]


def test_a_format_that_fails_keeps_the_others_from_being_replaced(saved, monkeypatch):
    deploy.deploy(saved, ["c"])
    before = files_of(saved)
    monkeypatch.setitem(deploy.WRITERS, "torch", lambda *_: pytest.fail("spoiled"))
    with pytest.raises(pytest.fail.Exception, match="spoiled"):
        deploy.deploy(saved, ["c", "torch"])
    assert files_of(saved) == before


def test_source_that_does_not_compile_is_refused_with_what_the_compiler_says(saved, with_compiler, monkeypatch):
    write = deploy.write_c
    monkeypatch.setattr(deploy, "write_c", lambda *given: write(*given)._replace(source="int x = ;\n"))
    with pytest.raises(ValueError, match="cannot compile ssmr_ours.c:\n.*error"):
        deploy.deploy(saved, ["c"])
    assert not (saved / "deployed").exists()


def test_without_a_compiler_the_file_is_written_and_said_to_be_unchecked(saved, monkeypatch):
    monkeypatch.setattr(deploy, "compiler", lambda: None)
    [form] = deploy.deploy(saved, ["c"])
    assert form.error is None and "NOT CHECKED: no C compiler was found" in str(form)
    assert "ssmr_ours.c" in files_of(saved)


def test_the_compiler_in_the_variable_cc_is_used_first(monkeypatch, tmp_path):
    own = tmp_path / "mycc"
    own.write_text("#!/bin/sh\n")
    own.chmod(0o755)
    monkeypatch.setenv("CC", str(own))
    assert c_library.compiler() == str(own)


def test_an_unknown_format_and_a_missing_package_are_refused_before_any_work(saved, monkeypatch):
    with pytest.raises(ValueError, match="unknown format 'c99'; expected some of c, torch, onnx, casadi"):
        deploy.deploy(saved, ["c", "c99"])
    monkeypatch.setitem(deploy.MODULES, "onnx", ("torch", "no_such_package"))
    with pytest.raises(ValueError, match=r"onnx needs no_such_package: pip install 'ssmr_torch\[onnx\]'"):
        deploy.deploy(saved, ["c", "onnx"])
    assert not (saved / "deployed").exists()


def test_a_replaced_artifact_takes_its_forms_with_it_unless_the_new_ones_fail(saved):
    deploy.deploy(saved, ["c"])
    loaded, before = artifact.load(saved), files_of(saved)
    card = {"output_names": loaded.card["output_names"], "input_names": loaded.card["input_names"],
            "rest": loaded.card["rest"], "input_range": loaded.card["input_range"]}

    def fail(aside):
        raise ValueError("spoiled")

    with pytest.raises(ValueError, match="spoiled"):
        artifact.save(saved, loaded.model, **card, complete=fail)
    assert files_of(saved) == before
    artifact.save(saved, loaded.model, **card)
    assert not (saved / "deployed").exists()


def test_a_folder_with_forms_but_no_card_is_not_taken_for_an_artifact(saved, tmp_path):
    (tmp_path / "mine" / "deployed").mkdir(parents=True)
    loaded = artifact.load(saved)
    with pytest.raises(ValueError, match="holds \\['deployed'\\], which do not belong to an artifact"):
        artifact.save(tmp_path / "mine", loaded.model, **{key: loaded.card[key] for key in (
            "output_names", "input_names", "rest", "input_range")})


@pytest.mark.slow
def test_the_command_line_writes_the_forms_of_an_existing_artifact(saved, tmp_path):
    done = export(f"artifact={saved}", "formats=c", at=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"artifact: {saved}" in done.stdout and "deployed/ c: ssmr_ours.c, ssmr_ours.h" in done.stdout
    assert (saved / "deployed" / "ssmr_ours.c").is_file()


@pytest.mark.slow
def test_the_command_without_arguments_says_what_to_give(tmp_path):
    done = export(at=tmp_path)
    assert done.returncode != 0 and "Traceback" not in done.stderr
    assert "give either checkpoint=FILE.ckpt or mat=FILE.mat, or artifact=DIR of an existing artifact" in done.stderr
