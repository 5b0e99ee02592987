"""Any number of processes gives the same data, and no interruption loses or repeats a finished trajectory."""

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.collection import collect as collection
from ssmr_torch.collection.collect import ControlledRun, collect, discard_recorded
from ssmr_torch.collection.excitation import RandomOnOffRamp, RandomSteps, SetPoints, SmoothRandom
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.trajectory import TrajectoryDataset

HERE = Path(__file__).parent
RUN = ControlledRun("steps", RandomSteps(0.1, share=0.9), 0.3, repeats=2)
BREAKING = ControlledRun("breaking", SetPoints(((1.0, 0.0),)), 0.2)
SCRIPT = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start with Ctrl-C ignored
sys.path.insert(0, {here!r})
from fragile_plants import FragilePlant, small

if __name__ == "__main__":
    small(FragilePlant({log!r}, delay={delay}), workers={workers}, directory={directory!r})
"""


@pytest.fixture
def plants(monkeypatch):
    monkeypatch.syspath_prepend(str(HERE))
    return importlib.import_module("fragile_plants")


@pytest.fixture
def plant(plants, tmp_path):
    return plants.FragilePlant(tmp_path / "runs")


@pytest.fixture
def small(plants):
    return plants.small


def assert_equal(first, second):
    assert [t.name for t in first] == [t.name for t in second]
    for a, b in zip(first, second):
        a, b = a.read(), b.read()
        assert (a.kind, a.split) == (b.kind, b.split)
        for attribute in ("time", "observation", "input"):
            assert getattr(a, attribute).tobytes() == getattr(b, attribute).tobytes()
    assert first.provenance == second.provenance


def parts(directory):
    return sorted(path.stem for path in (directory / "recorded").glob("*.h5"))


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened in time"
        time.sleep(0.01)


def alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def press_until_it_ends(started, seconds=1.0):
    """Ctrl-C as a terminal sends it, and again as a person would: one that falls into a destructor is lost."""
    while started.poll() is None:
        os.killpg(started.pid, signal.SIGINT)
        end = time.monotonic() + seconds
        while started.poll() is None and time.monotonic() < end:
            time.sleep(0.01)


def test_two_processes_give_the_data_of_one_to_the_last_bit():
    settings = {"decays": 2, "validation_decays": 1, "test_decays": 0, "decay_duration": 0.3, "controlled": (RUN,),
                "noise_std": 1e-5, "progress": False}
    alone = collect(SlowManifold(), **settings, workers=1)
    both = collect(SlowManifold(), **settings, workers=2)
    assert_equal(alone, both)
    assert not any(t.observation.flags.writeable for t in both)


def test_the_work_is_done_by_others_with_one_thread_each(plants, small, tmp_path):
    plant = plants.ThreadCountingPlant(tmp_path / "runs")
    before = dict(os.environ)
    for run in small(plant, workers=2, noise_std=0.0):
        np.testing.assert_array_equal(run.observation[1:], 1.0)
    assert os.getpid() not in plant.runs() and len(set(plant.runs())) <= 2
    assert dict(os.environ) == before


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(("workers", "blow"), [
    (1, signal.SIGKILL), *(pytest.param(2, blow, marks=pytest.mark.slow) for blow in (signal.SIGKILL, signal.SIGINT))])
def test_an_interrupted_collection_leaves_no_process_and_goes_on_where_it_stopped(plant, small, tmp_path, workers,
                                                                                  blow):
    script, directory = tmp_path / "script.py", tmp_path / "directory"
    # long enough for a second Ctrl-C
    script.write_text(SCRIPT.format(here=str(HERE), log=str(plant.log), workers=workers, directory=str(directory),
                                    delay=0.12 if blow == signal.SIGINT else 0.03))
    with subprocess.Popen([sys.executable, script], start_new_session=True, stderr=subprocess.PIPE) as started:
        until(lambda: parts(directory) or started.poll() is not None)
        if blow == signal.SIGINT:
            press_until_it_ends(started)
        else:
            started.kill()
        started.communicate(timeout=10)
    assert started.returncode != 0
    until(lambda: not any(alive(process) for process in plant.runs()), seconds=5)
    finished, begun = parts(directory), len(plant.runs())
    assert 1 <= len(finished) < 6
    resumed = small(plant, workers=workers, directory=directory)
    assert len(plant.runs()) - begun == 6 - len(finished)
    assert_equal(resumed, small(plant))


def test_when_a_process_that_records_dies_the_others_end_and_what_is_finished_is_kept(plant, small, tmp_path):
    plant.mishap.write_text("kill")
    asked = {"controlled": (RUN, BREAKING), "workers": 2, "directory": tmp_path}
    with pytest.raises(ChildProcessError, match="a worker process died.*breaking-0.*of 7 trajectories are kept"):
        small(plant, **asked)
    until(lambda: not any(alive(process) for process in plant.runs()), seconds=5)
    finished, begun = parts(tmp_path), len(plant.runs())
    assert len(finished) >= 4 and "breaking-0" not in finished
    plant.mishap.unlink()
    assert_equal(small(plant, **asked), small(plant, controlled=(RUN, BREAKING)))
    assert len(plant.runs()) - begun == 7 - len(finished) + 7


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_names_its_trajectory_and_keeps_those_that_are_finished(plant, small, tmp_path, workers):
    plant.mishap.write_text("raise")
    asked = {"controlled": (RUN, BREAKING), "workers": workers, "directory": tmp_path}
    with pytest.raises(ValueError, match=r"breaking-0: the arm broke \(in the step from 0 s.*of 7 trajectories are"):
        small(plant, **asked)
    finished, begun = parts(tmp_path), len(plant.runs())
    assert len(finished) >= 4 and "breaking-0" not in finished
    plant.mishap.unlink()
    small(plant, **asked)
    assert len(plant.runs()) - begun == 7 - len(finished)


def test_files_that_were_not_written_to_their_end_are_recorded_again(plant, small, tmp_path):
    whole = small(plant, directory=tmp_path)
    folder = tmp_path / "recorded"
    data = (folder / "steps-0.h5").read_bytes()
    (folder / "steps-0.h5").write_bytes(data[: len(data) // 2])
    (folder / "steps-1.h5").write_bytes(b"")
    (folder / "decay-train-000.h5").rename(folder / "decay-train-000.h5.part")
    begun = len(plant.runs())
    assert_equal(small(plant, directory=tmp_path), whole)
    assert len(plant.runs()) - begun == 3


@pytest.mark.parametrize(("changes", "message"), [
    ({"seed": 4}, "decay-train-000 of another collection: seed was 3, now it is 4"),
    ({"gain": 2.0}, "decay-train-000 of another collection: plant.parameters.gain was 1.0, now it is 2.0"),
    ({"decay_duration": 0.5}, "plan.duration was 0.4, now it is 0.5"),
    ({"noise_std": 0.0}, "decay-train-000 of another collection: plan.noise_std"),
    ({"release": RandomOnOffRamp(share=0.5)}, "plan.excitation.share was 1.0, now it is 0.5"),
    ({"controlled": (ControlledRun("steps", RandomSteps(0.2, share=0.9), 0.3, repeats=2),)},
     "steps-0 of another collection: plan.excitation.hold was 0.1, now it is 0.2"),
    ({"decays": 2}, "decay-train-002, which is not part of this collection")])
def test_trajectories_recorded_otherwise_are_refused(plants, plant, small, tmp_path, changes, message):
    saved = small(plant, directory=tmp_path)
    begun, asked = len(plant.runs()), dict(changes)
    other = plants.FragilePlant(plant.log, gain=asked.pop("gain", 1.0))
    with pytest.raises(ValueError, match=f"{message}.*choose another directory"):
        small(other, **asked, directory=tmp_path)
    saved.save(tmp_path / "trajectories.h5")
    discard_recorded(tmp_path)
    with pytest.raises(ValueError, match=f"{message}.*choose another directory"):
        small(other, **asked, directory=tmp_path)
    assert len(plant.runs()) == begun
    assert_equal(TrajectoryDataset.load(tmp_path / "trajectories.h5"), saved)


def test_an_excitation_of_ones_own_is_told_apart_by_its_signal(plant, small, tmp_path):
    def pull(level):
        return lambda rng, samples, timestep, bounds: np.full((samples, 2), level)

    def run(level):
        return {"decays": 0, "validation_decays": 0, "controlled": (ControlledRun("pull", pull(level), 0.2),),
                "directory": tmp_path}

    small(plant, **run(0.5))
    small(plant, **run(0.5))
    assert len(plant.runs()) == 1
    with pytest.raises(ValueError, match="pull-0 of another collection: plan.excitation.signal"):
        small(plant, **run(0.6))


def test_a_collection_takes_what_a_smaller_one_has_recorded(plant, small, tmp_path):
    small(plant, directory=tmp_path)
    begun = len(plant.runs())
    assert_equal(small(plant, decays=5, directory=tmp_path), small(plant, decays=5))
    assert len(plant.runs()) - begun == 2 + 8


def test_a_complete_collection_is_returned_as_it_was_saved_and_nothing_is_recorded(plant, small, tmp_path):
    saved = small(plant, directory=tmp_path)
    saved.provenance["time"] = "then"
    saved.save(tmp_path / "trajectories.h5")
    begun = len(plant.runs())
    assert_equal(small(plant, directory=tmp_path), saved)
    discard_recorded(tmp_path)
    assert_equal(small(plant, directory=tmp_path), saved)
    assert len(plant.runs()) == begun
    with pytest.raises(ValueError, match="holds 6 trajectories but not decay-train-003; choose another directory"):
        small(plant, decays=4, directory=tmp_path)


def test_discarding_removes_the_single_trajectories_and_nothing_else(plant, small, tmp_path):
    small(plant, directory=tmp_path)
    (tmp_path / "recorded" / "notes.txt").write_text("mine")
    discard_recorded(tmp_path)
    assert [path.name for path in (tmp_path / "recorded").iterdir()] == ["notes.txt"]
    (tmp_path / "recorded" / "notes.txt").unlink()
    discard_recorded(tmp_path)
    discard_recorded(tmp_path)
    assert not (tmp_path / "recorded").exists()


def test_any_name_of_a_run_makes_a_file(plant, small, tmp_path):
    asked = {"decays": 0, "validation_decays": 0, "controlled": (ControlledRun("../up/ä b", SmoothRandom(), 0.2),),
             "directory": tmp_path}
    small(plant, **asked)
    begun = len(plant.runs())
    assert [t.name for t in small(plant, **asked)] == ["../up/ä b-0"]
    assert len(plant.runs()) == begun == 1


def test_what_cannot_be_handed_over_or_told_apart_is_refused_before_the_plant_moves(plants, plant, small, tmp_path):
    bound, unknown = plants.ProcessBoundPlant(plant.log), plants.UnknownPlant(plant.log)
    with pytest.raises(ValueError, match="ProcessBoundPlant cannot be handed to worker processes.*workers=1"):
        small(bound, workers=2)
    with pytest.raises(ValueError, match="UnknownPlant has no `parameters`"):
        small(unknown, directory=tmp_path)
    for workers in (0, -1, 1.5, "many"):
        with pytest.raises(ValueError, match="workers is .*; expected a whole number from 1 to 1024"):
            small(plant, workers=workers)
    plant.gain = np.eye(2)
    with pytest.raises(ValueError, match="the settings of FragilePlant.*are not plain values"):
        small(plant)
    assert not plant.runs()


class Bar(collection.tqdm):
    """A progress bar that remembers what it has shown."""

    made = []

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.began, self.shown = settings["initial"], []
        self.made.append(self)

    def update(self, n=1):
        super().update(n)
        self.shown.append(self.n)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_progress_bar_counts_samples_and_goes_on_from_those_recorded_before(plant, small, tmp_path, monkeypatch,
                                                                                 workers):
    monkeypatch.setattr(collection, "tqdm", Bar)
    monkeypatch.setattr(Bar, "made", [])
    plant.mishap.write_text("raise")
    asked = {"controlled": (BREAKING, RUN), "workers": workers, "directory": tmp_path, "progress": True}
    with pytest.raises(ValueError):
        small(plant, **asked)
    plant.mishap.unlink()
    recorded = sum(140 if name.startswith("decay") else 30 for name in parts(tmp_path))
    small(plant, **asked)
    first, second = Bar.made
    assert first.total == second.total == 4 * 140 + 20 + 2 * 30
    assert first.began == 0 and second.began == recorded
    assert second.shown[-1] == second.total
    assert all(bar.shown == sorted(bar.shown) for bar in Bar.made)
    if workers == 1:
        assert first.shown[:4] == [1, 50, 100, 140]
