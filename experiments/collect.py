"""Plant → trajectories: python experiments/collect.py plant=slow_manifold excitation.decays=40"""

from entry import entry_point
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.provenance import provenance


@entry_point("collect")
def main(config, directory):
    dataset = instantiate(config.excitation)(instantiate(config.plant))
    dataset.provenance.update(provenance(OmegaConf.to_container(config, resolve=True)))
    path = dataset.save(directory / "trajectories.h5")
    samples = sum(trajectory.length for trajectory in dataset)
    print(f"{len(dataset)} trajectories, {samples} samples: {path}")


if __name__ == "__main__":
    main()
