"""Recordings → a controller designed from them alone: artifact with model and controller, design.md, figures.

ssmr design data.path=FILE.h5 task=circle plant=tendon_chain; bounds='[[0,0],[1,1]]' in place of a plant
"""

from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.entry_point import entry_point, save_result


@entry_point("design")
def main(config, directory):
    plant = config.get("plant")
    if (config.bounds is None) == (plant is None):
        raise ValueError("give either plant=NAME, whose bounds hold, or bounds=[[lowest, …],[highest, …]], one number "
                         "for each input, in the unit of the recordings")
    own = [each for each in HydraConfig.get().overrides.task if each.startswith(("model.", "fit"))]
    if own:
        raise ValueError(f"{own[0]} is given, and a kind of model is fitted by its defaults here; fit it by ssmr.fit "
                         "and give what it returns to ssmr.design")
    from ssmr_torch.controller_design.design import design

    kind = HydraConfig.get().runtime.choices.model
    bounds = OmegaConf.to_container(config.bounds) if plant is None else instantiate(plant).input_bounds
    data, task = instantiate(config.data).observing(config.outputs), instantiate(config.task)
    designed = design(kind, data, task, bounds, progress=config.progress)
    report, path = designed.report, designed.save(config.artifact)
    report.save(directory, figures=config.figures)
    print("\n".join([str(report), *report.sentences, f"{directory / 'design.md'}", f"{path}"]))
    facts = report.facts
    save_result(directory, {name: facts[name] for name in ("predicted_error", "model_error", "actuator_error", "reach",
                                                           "minutes", "seconds")})
    return facts["predicted_error"] if facts["predicted_error"] is not None else float("inf")


if __name__ == "__main__":
    main()
