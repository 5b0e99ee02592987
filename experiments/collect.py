"""Plant → trajectories.h5, in parallel; the same command in the same directory goes on after a kill.

ssmr collect plant=slow_manifold excitation.decays.count=40
"""

from hydra.utils import instantiate

from ssmr_torch.entry_point import entry_point, origin_of


@entry_point("collect", resumed="")
def main(config, directory):
    from ssmr_torch.collection.resumption import COMPLETE, discard_recorded

    plant = instantiate(config.rig)(instantiate(config.plant))
    dataset = instantiate(config.excitation)(plant, directory=directory, workers=config.workers)
    path = directory / COMPLETE
    if not path.exists():
        dataset.provenance.update(origin_of(config))
        rates = getattr(getattr(plant, "plant", plant), "eigenvalues", [])  # of the plant on the rig
        dataset.provenance["eigenvalues"] = [[float(rate.real), float(rate.imag)] for rate in rates]
        dataset.save(path)
    discard_recorded(directory)
    samples = sum(trajectory.length for trajectory in dataset)
    print(f"{len(dataset)} trajectories, {samples} samples: {path}")


if __name__ == "__main__":
    main()
