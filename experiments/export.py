"""Checkpoint → artifact: python experiments/export.py checkpoint=FILE.ckpt; also mat=FILE.mat of a published model"""

from entry import entry_point

from ssmr_torch import artifact
from ssmr_torch.fitting.training import load_model
from ssmr_torch.provenance import fingerprint, provenance
from ssmr_torch.published_models import read_published_model


@entry_point("export")
def main(config, directory):
    if (config.checkpoint is None) == (config.mat is None):
        raise ValueError("give either checkpoint=FILE.ckpt or mat=FILE.mat")
    if config.mat is not None:
        tables, card = read_published_model(
            config.mat, output_names=config.output_names, input_names=config.input_names, rest=config.rest,
            length_unit=config.length_unit, input_unit=config.input_unit, state_scale=config.state_scale)
    else:
        model, card = load_model(config.checkpoint)
        tables = model.tables()
    path = artifact.save(config.artifact, tables, name=config.name or card["name"], output_names=card["output_names"],
                         input_names=card["input_names"], rest=card["rest"], input_range=card["input_range"],
                         input_unit=card["input_unit"], scores=card.get("scores"), cost=card.get("cost"),
                         provenance=provenance() | {"source": fingerprint(config.checkpoint or config.mat),
                                                    "training": card.get("training"), "data": card.get("data")})
    artifact.load(path)
    print(f"artifact: {path}")


if __name__ == "__main__":
    main()
