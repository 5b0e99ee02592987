"""Checkpoint → artifact: python experiments/export.py checkpoint=FILE.ckpt; also mat=FILE.mat of a published model"""

from entry import entry_point

from ssmr_torch import artifact
from ssmr_torch.fitting.training import load_model
from ssmr_torch.provenance import fingerprint, provenance
from ssmr_torch.published_models import read_ssmr_model


def published_card(tables, output_names):
    """What a published file does not tell: the observed outputs, and that inputs are normalized to 0 … 1."""
    inputs, outputs = tables.input_dim, tables.output_dim
    return {"name": "SSMR (published)", "output_names": list(output_names), "rest": [0.0] * outputs,
            "input_names": [f"u{j + 1}" for j in range(inputs)], "input_unit": "1",
            "input_range": [[0.0] * inputs, [1.0] * inputs]}


@entry_point("export")
def main(config, directory):
    if (config.checkpoint is None) == (config.mat is None):
        raise ValueError("give either checkpoint=FILE.ckpt or mat=FILE.mat")
    if config.mat is not None:
        tables = read_ssmr_model(config.mat, length_unit=config.length_unit, input_unit=config.input_unit,
                                 state_scale=config.state_scale)
        card = published_card(tables, config.output_names)
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
