"""Both ends as processes of their own, for pauses, kills and signals; run as a program, this is one of them.

    python tests/wire/processes.py pauses COUNT PAIRS    # random pauses of 5 ms to 3 s, PAIRS runs side by side
    python tests/wire/processes.py flood COUNT           # so many hostile frames at a controller that steers a robot
"""

from __future__ import annotations

import json
import logging
import os
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

TIMEOUT = 0.2
STEP = struct.Struct("<3d")  # s, and the input


def controller_process(bind, timestep, duration, base):
    from wire.one_clock import Telling

    from ssmr_torch.wire.controller_end import ControllerEnd
    from ssmr_torch.wire.link import ControllerLink
    from ssmr_torch.wire.serving import serve

    class Paced(Telling):
        period = float(timestep)

    end = ControllerEnd(lambda robot: Paced(), duration=float(duration) or None)
    with ControllerLink(bind) as link:
        print(link.endpoint, flush=True)
        try:
            serve(link, end, runs=1)
        finally:
            print(json.dumps({"counts": end.counts, "finished": end.finished}), flush=True)


def robot_process(connect, timestep, path, base):
    from wire.one_clock import Told

    from ssmr_torch.wire.link import RobotLink
    from ssmr_torch.wire.robot_end import RobotEnd

    class Written(Told):
        """A robot that writes every step into a file, which outlives it."""

        timestep = float(sys.argv[3])

        def __init__(self, file):
            self.file, self.resets = file, 0

        def step(self, input):
            self.file.write(STEP.pack(time.monotonic() - float(base), *map(float, input)))
            return self._seen()

        def _seen(self):
            return np.array([0.0, time.monotonic() - float(base)])

    with open(path, "ab", buffering=0) as file, RobotLink(connect) as link:
        plant = Written(file)
        robot = RobotEnd(plant, link, real_time=True, timeout=TIMEOUT)
        try:
            robot.drive(1, wait=20.0)
        finally:
            print(json.dumps({"counts": robot.counts, "resets": plant.resets}), flush=True)


class Process:
    """One end; `said` is the last line that it printed."""

    def __init__(self, *arguments):
        environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parents[1])}
        self.popen = subprocess.Popen([sys.executable, __file__, *map(str, arguments)], stdout=subprocess.PIPE,
                                      text=True, env=environment)

    def line(self):
        return self.popen.stdout.readline().strip()

    def signal(self, number):
        self.popen.send_signal(number)

    def pause(self, seconds):
        self.signal(signal.SIGSTOP)
        time.sleep(seconds)
        self.signal(signal.SIGCONT)

    def result(self, timeout=20.0):
        """(exit status, what it told at its end)."""
        text, _ = self.popen.communicate(timeout=timeout)
        return self.popen.returncode, json.loads(text.splitlines()[-1]) if text else {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.popen.kill()
        self.popen.wait()
        self.popen.stdout.close()


class Pair:
    """A controller and a robot, `timestep` s, and the steps of the robot as rows of (s, u, from)."""

    def __init__(self, directory, timestep, duration=0.0, name="robot"):
        self.base, self.path, self.timestep = time.monotonic() - 1.0, Path(directory) / f"{name}.steps", timestep
        self.controller = Process("controller", "tcp://127.0.0.1:*", timestep, duration, self.base)
        self.address = self.controller.line()
        self.robot = Process("robot", self.address, timestep, self.path, self.base)
        until = time.monotonic() + 20.0
        while (self.steps[:, 1] == 0.6).sum() < 3 and time.monotonic() < until:
            time.sleep(0.02)

    @property
    def steps(self):
        data = self.path.read_bytes() if self.path.exists() else b""
        return np.array(list(STEP.iter_unpack(data[:len(data) // STEP.size * STEP.size]))).reshape(-1, 3)

    @property
    def now(self):
        return time.monotonic() - self.base

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.robot.__exit__()
        self.controller.__exit__()

    def paused(self, lengths, rng, apart):
        """Stop either end for so many s, one after the other; the ends of the pauses, s, and which end it was."""
        ends = []
        for length in lengths:
            time.sleep(rng.uniform(0.5, 1.0) * apart)
            which = int(rng.integers(2))
            (self.robot, self.controller)[which].pause(length)
            ends.append((self.now, which))
        time.sleep(apart)
        return ends


def fresh(steps, timestep):
    """The steps with an input from the newest measurement, which a plant gives one timestep before it is sent."""
    return (steps[:, 1] == 0.6) & (steps[:, 0] - 1e4 * steps[:, 2] < 2.2 * timestep)


def recoveries(steps, ends, timestep):
    """Timesteps from the end of each pause to the next step with a fresh input."""
    when = steps[fresh(steps, timestep), 0]
    found = np.searchsorted(when, ends)
    return np.where(found < len(when), (when[np.minimum(found, len(when) - 1)] - ends) / timestep, np.inf)


def oldest(steps):
    """s, the age of the oldest input that was applied and not the safe one."""
    told = steps[steps[:, 1] == 0.6]
    return (told[:, 0] - 1e4 * told[:, 2]).max()


def older(steps, limit):
    """How many inputs that are not the safe one were older than `limit` s: the process was stopped as it wrote them."""
    told = steps[steps[:, 1] == 0.6]
    return int((told[:, 0] - 1e4 * told[:, 2] > limit).sum())


def pauses(count, pairs, timestep=0.01):
    """Random pauses of 5 ms to 3 s in either end of so many runs; what came of them."""
    import tempfile
    from concurrent.futures import ThreadPoolExecutor

    def one(seed):
        rng = np.random.default_rng(seed)
        lengths = np.exp(rng.uniform(np.log(5e-3), np.log(3.0), int(count) // int(pairs)))
        with tempfile.TemporaryDirectory() as directory, Pair(directory, timestep) as pair:
            ends = pair.paused(lengths, rng, 0.4)
            pair.controller.signal(signal.SIGTERM)
            _, controller = pair.controller.result()
            return (lengths, recoveries(pair.steps, np.array([end for end, _ in ends]), timestep), oldest(pair.steps),
                    pair.steps[:, 1:], controller["counts"], older(pair.steps, TIMEOUT + 3 * timestep))

    with ThreadPoolExecutor(int(pairs)) as pool:
        runs = list(pool.map(one, range(int(pairs))))
    recovered, inputs = np.concatenate([run[1] for run in runs]), np.concatenate([run[3] for run in runs])
    inside = bool(((inputs >= [0.1, 0.0]) & (inputs <= 1.0)).all())
    counts = Counter()
    for run in runs:
        counts.update(run[4])
    print(json.dumps({"pauses": len(recovered), "not recovered": int(np.isinf(recovered).sum()),
                      "periods": {f"{share} %": float(np.quantile(recovered, share / 100)) for share in (50, 99, 100)},
                      "later than 3": int((recovered > 3).sum()), "oldest input, s": max(run[2] for run in runs),
                      "inputs older than the timeout and 3 timesteps": sum(run[5] for run in runs),
                      "steps": len(inputs), "inside the bounds": inside,
                      "counts": counts}))


def flood(count, timestep=0.02):
    """So many hostile frames from four connections at a controller in a run; what came of it."""
    import tempfile

    import zmq

    from ssmr_torch.faults.hostile_frames import frame

    with tempfile.TemporaryDirectory() as directory:
        os.environ["WIRE_LOG"] = str(Path(directory) / "log")
        with Pair(directory, timestep) as pair:
            status = Path(f"/proc/{pair.controller.popen.pid}/status")
            rng, context = np.random.default_rng(0), zmq.Context()
            foes = [context.socket(zmq.DEALER) for _ in range(4)]
            for foe in foes:
                foe.connect(pair.address)
            frames, sizes, sent, begun = [frame(rng, k, k) for k in range(5000)], [], 0, time.monotonic()
            while sent < int(count):
                if sent % (int(count) // 10) == 0:
                    sizes.append(int(status.read_text().split("VmRSS:")[1].split()[0]) / 1024)
                foes[sent % 4].send(frames[int(rng.integers(len(frames)))])  # waits where the queue is full
                sent += 1
            spent = time.monotonic() - begun
            time.sleep(2.0)
            sizes.append(int(status.read_text().split("VmRSS:")[1].split()[0]) / 1024)
            steps = pair.steps
            pair.controller.signal(signal.SIGTERM)
            exit_status, told = pair.controller.result()
            print(json.dumps({"frames": sent, "s": spent, "memory, MB": [round(size, 1) for size in sizes],
                              "log, bytes": sum(path.stat().st_size for path in Path(directory).glob("log*")),
                              "exit status": exit_status, "steps": len(steps), "oldest input, s": oldest(steps),
                              "share of fresh inputs": float(fresh(steps, timestep)[5:].mean()),
                              "inside the bounds": bool(((steps[:, 1:] >= [0.1, 0.0]) & (steps[:, 1:] <= 1.0)).all()),
                              "counts": told["counts"]}))
            context.destroy(linger=0)


if __name__ == "__main__":
    if os.environ.get("WIRE_LOG"):
        logging.basicConfig(level=logging.INFO, filename=os.environ["WIRE_LOG"] + str(os.getpid()))
    else:
        logging.disable(logging.CRITICAL)
    what, *given = sys.argv[1:]
    {"flood": flood, "controller": controller_process, "robot": robot_process, "pauses": pauses}[what](*given)
