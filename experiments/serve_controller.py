"""Artifact as a controller that waits for a robot elsewhere (docs/wire.md) → record.h5, settings.json.

ssmr serve-controller artifact=DIR task=figure_eight
"""

from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.experiments.entry import entry_point, save_json, save_result


@entry_point("serve_controller")
def main(config, directory):
    from ssmr_torch.closed_loop.wire_record import record_of
    from ssmr_torch.deployment import artifact
    from ssmr_torch.provenance import provenance
    from ssmr_torch.wire.controller_end import ControllerEnd
    from ssmr_torch.wire.link import ControllerLink
    from ssmr_torch.wire.runner import controller_for, made_of, prepare
    from ssmr_torch.wire.serving import serve

    loaded, task = artifact.load(config.artifact), instantiate(config.task)
    plain = OmegaConf.to_container(config, resolve=True)
    save_json(directory / "settings.json", {part: plain[part] for part in ("controller", "task")})
    origin = provenance(plain) | {"model": loaded.card["name"], "artifact": loaded.card["sha256"]}
    make, source = instantiate(config.controller), made_of(loaded, config.controller._target_)
    build = controller_for(loaded, lambda model, bounds, **more: make(source, task, bounds, **more),
                           config.rest_tolerance)
    end = ControllerEnd(build, duration=task.duration, deadline=config.deadline, timeout=config.timeout,
                        patience=config.patience, seed=config.seed)
    results = []

    def save(end):
        name = "record.h5" if config.runs == 1 else f"record-{end.finished}.h5"
        record = record_of(end, task, origin)
        counts = {f"wire/{what}": n for what, n in sorted(end.counts.items())}
        report = record.report(task.obstacles)
        results.append(report.metrics | counts)
        print(f"{origin['model']}: ISE {1e6 * results[-1]['ise']:.4g} mm², {dict(end.counts)}\n{report}\n"
              f"{record.save(directory / name)}")

    with ControllerLink(config.bind) as link:
        prepare(loaded, build)
        print(f"{origin['model']} waits for a robot at {link.endpoint}", flush=True)
        serve(link, end, runs=config.runs, done=save)
    save_result(directory, results[-1] if results else {})
    return results[-1]["ise"] if results else float("inf")


if __name__ == "__main__":
    main()
