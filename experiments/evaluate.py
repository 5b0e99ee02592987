"""Artifacts on trajectories → open-loop scores, table and figures.

ssmr evaluate artifact=[DIR,DIR] data.path=FILE.h5
"""

from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.experiments.entry import entry_point, save_json, save_result


@entry_point("evaluate")
def main(config, directory):
    from ssmr_torch.deployment import artifact
    from ssmr_torch.evaluation import figures
    from ssmr_torch.evaluation.comparison_tables import comparison_table, format_groups, stored
    from ssmr_torch.evaluation.run_groups import compare_groups
    from ssmr_torch.provenance import provenance
    from ssmr_torch.report.run_sections import prediction_figures

    paths = [config.artifact] if isinstance(config.artifact, str) else list(config.artifact)
    loaded = [artifact.load(path) for path in paths]
    models = artifact.by_name(loaded)
    dataset = instantiate(config.data).observing(artifact.common_outputs(loaded))
    for model in loaded:
        artifact.check_source(model, dataset)
    runs = dataset.select(config.split, config.kind)
    if not runs:
        raise ValueError(f"no trajectory has split={config.split} and kind={config.kind}; "
                         f"there are {sorted({(t.split, t.kind) for t in dataset})}")
    outputs = dataset.columns(config.outputs)
    found = compare_groups(models, runs, horizons=list(config.horizons), starts=config.starts, seed=config.seed,
                           outputs=outputs, noise=config.noise)
    scores, table = found.scores, format_groups(found)
    (directory / "scores.txt").write_text(table + "\n")
    costs = {name: model.card.get("cost", {}) for name, model in zip(models, loaded)}
    (directory / "comparison.md").write_text(comparison_table(scores, costs) + "\n")
    origin = provenance(OmegaConf.to_container(config, resolve=True)) | {
        "artifacts": {name: model.card["sha256"] for name, model in zip(models, loaded)}, "data": dataset.provenance}
    save_json(directory / "scores.json", stored(found) | {"provenance": origin})
    for name, figure in prediction_figures(models, scores, runs, dataset.output_names, outputs).items():
        figures.save(figure, directory / f"{name}.svg")
    print(f"{table}\n{directory / 'scores.json'}")
    save_result(directory, {f"{name}, {part.label}": part.mean for name in models for part in scores[name].horizons})
    return scores[next(iter(models))].horizons[-2].mean


if __name__ == "__main__":
    main()
