"""A whole commissioning of the emulated bench in another process, with a driver that is killed in its midst."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.commissioning.commission import STEPS
from ssmr_torch.trajectory import TrajectoryDataset

pytest.importorskip("zmq", reason="the extra wire is not installed")
SSMR, DRIVER = Path(sys.executable).with_name("ssmr"), Path(__file__).with_name("driver.py")
PORT = 5617


@pytest.mark.slow
def test_the_emulated_bench_is_commissioned_over_the_wire_and_a_killed_driver_goes_on(tmp_path):
    directory = tmp_path / "commissioning"
    robot = subprocess.Popen([SSMR, "serve-plant", "plant=diamond_coarse", "rig=emulated_bench", "rig.dropped=missing",
                              "rig.outputs=[tip_x,tip_y,tip_z]", f"connect=tcp://127.0.0.1:{PORT}", "wait=120",
                              "hydra.run.dir=robot"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    command = [sys.executable, DRIVER, f"tcp://127.0.0.1:{PORT}", directory]
    try:
        first = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until = time.monotonic() + 100
        while len(list(directory.glob("collected/*/recorded/*.h5"))) < 3 and time.monotonic() < until:
            assert first.poll() is None
            time.sleep(0.05)
        first.kill()
        first.wait()
        confirmed = json.loads((directory / "progress.json").read_text())["confirmed"]
        assert [entry["step"] for entry in confirmed] == ["card", "noise", "steps"]
        second = subprocess.run(command, capture_output=True, text=True, timeout=150)
        assert second.returncode == 0, second.stderr
        assert f"{len(STEPS)} steps" in second.stdout and "rest" in second.stdout
        assert robot.wait(20) == 0
    finally:
        robot.kill()
        robot.wait()
    noise, steps = (json.loads((directory / name).read_text()) for name in ("noise.json", "steps.json"))
    assert all(4e-5 < std < 6e-5 for std in noise["std_m"]) and 0 < noise["missing"] < 0.05
    assert noise["jitter"] < 1e-6  # in lock-step the robot's clock is its samples'
    assert all(0.01 <= answer["delay_s"] <= 0.04 for answer in steps["answers"])  # 10 ms late, and a lag of 10 ms
    assert len(TrajectoryDataset.load(directory / "trajectories.h5")) == 9
    for name in ("slow_circle.h5", "fast_circle.h5"):
        assert ClosedLoopRecord.load(directory / name).time[-1] > 5.0
    assert "steps.svg" in (directory / "commissioning.md").read_text() and (directory / "circles.svg").is_file()
