"""Artifacts on trajectories → open-loop scores, table and figures.

ssmr evaluate artifact=[DIR,DIR] data.path=FILE.h5
"""

from hydra.utils import instantiate

from ssmr_torch.entry_point import entry_point, origin_of, save_result


@entry_point("evaluate")
def main(config, directory):
    from ssmr_torch.report.artifact_scores import score_artifacts

    paths = [config.artifact] if isinstance(config.artifact, str) else list(config.artifact)
    scores = score_artifacts(paths, lambda: instantiate(config.data), split=config.split, kind=config.kind,
                             outputs=config.outputs, horizons=list(config.horizons), starts=config.starts,
                             seed=config.seed, noise=config.noise)
    print(scores.table, scores.save(directory, origin_of(config)), sep="\n")
    save_result(directory, scores.metrics)
    return scores.metric


if __name__ == "__main__":
    main()
