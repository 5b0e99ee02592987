"""Trajectories → every model at its best, scored side by side: comparison.json, comparison.md, figure.

ssmr compare data.path=FILE.h5
"""

from hydra.utils import instantiate

from ssmr_torch.entry_point import entry_point, origin_of, save_json, save_result
from ssmr_torch.result_files import save_text


@entry_point("compare")
def main(config, directory):
    from ssmr_torch.evaluation import figures
    from ssmr_torch.fitting.compare_models import compare

    dataset = instantiate(config.data).observing(config.outputs)
    models = None if config.models is None else list(config.models)
    found = compare(dataset, models, scored=config.scored, noise=config.noise, horizons=list(config.horizons),
                    starts=config.starts, seed=config.seed)
    origin = origin_of(config) | {"data": dataset.provenance}
    save_json(directory / "comparison.json", found.as_dict() | {"provenance": origin})
    save_text(directory / "comparison.md", found.markdown)
    figures.save(found.figure(), directory / "comparison.svg")
    for name, model in found.models.items() if config.artifacts else ():
        model.save(directory / "models" / name)
    print(f"{found}\n{directory / 'comparison.json'}")
    first, scores = next(iter(found.models)), found.found.scores
    save_result(directory, {f"{name}, {part.label}": part.mean for name in scores for part in scores[name].horizons})
    return scores[first].horizons[-2].mean


if __name__ == "__main__":
    main()
