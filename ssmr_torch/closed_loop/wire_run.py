"""An artifact's controller that waits for a robot elsewhere; every run leaves a record."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ssmr_torch.closed_loop.wire_record import record_of
from ssmr_torch.deployment.artifact import Artifact
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.link import ControllerLink
from ssmr_torch.wire.runner import controller_for, prepare
from ssmr_torch.wire.seal import read_key
from ssmr_torch.wire.serving import serve


def serve_artifact(loaded: Artifact, task, make: Callable, source, *, bind: str, runs: int | None,
                   rest_tolerance: float, directory: Path, provenance: dict, key_file: str | None = None,
                   **options) -> dict | None:
    """Serve robots at the address `bind` and save every run; returns the metrics of the last one, None without any.

    make(source, task, input_bounds, timestep=s, output_names=…) → controller; source: the artifact or its model, see
    `wire.runner.made_of`.   runs: end after so many; None serves for ever.   rest_tolerance: m, see `controller_for`.
    directory: record.h5 of a single run, else record-NUMBER.h5.   key_file: see `wire.seal.read_key`.
    options: `deadline`, `timeout`, `patience` and `seed` of `ControllerEnd`.
    """
    origin = provenance | {"model": loaded.card["name"], "artifact": loaded.card["sha256"]}
    build = controller_for(loaded, lambda model, bounds, **more: make(source, task, bounds, **more), rest_tolerance)
    end = ControllerEnd(build, duration=task.duration, **options)
    results: list[dict] = []

    def save(end: ControllerEnd) -> None:
        record = record_of(end, task, origin)
        report = record.report(task.obstacles)
        results.append(report.metrics | {f"wire/{what}": n for what, n in sorted(end.counts.items())})
        path = record.save(directory / ("record.h5" if runs == 1 else f"record-{end.finished}.h5"))
        print(f"{origin['model']}: ISE {1e6 * results[-1]['ise']:.4g} mm², {dict(end.counts)}\n{report}\n{path}")

    with ControllerLink(bind, read_key(key_file)) as link:
        prepare(loaded, build)
        print(f"{origin['model']} waits for a robot at {link.endpoint}", flush=True)
        serve(link, end, runs=runs, done=save)
    return results[-1] if results else None
