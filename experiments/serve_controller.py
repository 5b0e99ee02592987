"""Artifact as a controller that waits for a robot elsewhere (docs/wire.md) → record.h5, settings.json.

ssmr serve-controller artifact=DIR task=figure_eight
"""

from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.entry_point import entry_point, origin_of, save_json, save_result


@entry_point("serve_controller", at_a_robot=True)
def main(config, directory):
    from ssmr_torch.closed_loop.wire_run import serve_artifact
    from ssmr_torch.deployment import artifact
    from ssmr_torch.wire.runner import made_of

    loaded, task = artifact.load(config.artifact), instantiate(config.task)
    plain = OmegaConf.to_container(config, resolve=True)
    save_json(directory / "settings.json", {part: plain[part] for part in ("controller", "task")}, sealed=False)
    last = serve_artifact(
        loaded, task, instantiate(config.controller), made_of(loaded, config.controller._target_), bind=config.bind,
        runs=config.runs, rest_tolerance=config.rest_tolerance, directory=directory, provenance=origin_of(config),
        deadline=config.deadline, timeout=config.timeout, patience=config.patience, seed=config.seed,
        key_file=config.key_file)
    save_result(directory, last or {})
    return last["ise"] if last else float("inf")


if __name__ == "__main__":
    main()
