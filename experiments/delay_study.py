"""Decays and a controlled run → how well manifolds of several delays reconstruct the run (the paper's Fig. 3).

ssmr delay-study data.path=FILE.h5 record=record.h5
"""

from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.entry_point import entry_point
from ssmr_torch.result_files import save_json


@entry_point("delay_study")
def main(config, directory):
    from ssmr_torch.evaluation import figures, study_figures
    from ssmr_torch.paper.delay_study import controlled_run, format_reconstruction, reconstruction_study
    from ssmr_torch.provenance import provenance

    dataset = instantiate(config.data).observing(config.outputs)
    decays = dataset.select("train", "decay")
    run = controlled_run(config.record, dataset)
    rows = reconstruction_study(decays, run, **instantiate(config.manifold))
    figures.save(study_figures.reconstruction(rows, run.observation, dataset.output_names), directory / "delays.svg")
    numbers = [{name: value for name, value in row.items() if name != "outputs"} for row in rows]
    save_json(directory / "delays.json", {"rows": numbers, "provenance": provenance(
        OmegaConf.to_container(config, resolve=True))})
    print(f"{format_reconstruction(rows)}\n{directory / 'delays.svg'}")


if __name__ == "__main__":
    main()
