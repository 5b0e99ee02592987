"""Checkpoint → artifact: python experiments/export.py checkpoint=FILE.ckpt; also mat=FILE.mat of a published model"""

from entry import entry_point

from ssmr_torch import artifact
from ssmr_torch.fitting.training import load_model
from ssmr_torch.provenance import provenance
from ssmr_torch.published_models import read_ssmr_model


@entry_point("export")
def main(config, directory):
    if (config.checkpoint is None) == (config.mat is None):
        raise ValueError("give either checkpoint=FILE.ckpt or mat=FILE.mat")
    if config.mat is not None:
        tables = read_ssmr_model(config.mat, length_unit=config.length_unit, input_unit=config.input_unit)
        card = {"name": "SSMR (published)", "output_names": ["tip_x", "tip_y", "tip_z"][:tables.output_dim], "rest": [0.0] * tables.output_dim,
                "input_names": [f"u{j + 1}" for j in range(tables.input_dim)], "input_unit": "1",
                "input_bounds": [[0.0] * tables.input_dim, [1.0] * tables.input_dim]}
    else:
        model, card = load_model(config.checkpoint)
        tables = model.tables()
    path = artifact.save(config.artifact, tables, name=config.name or card["name"], output_names=card["output_names"],
                         input_names=card["input_names"], rest=card["rest"], input_bounds=card["input_bounds"],
                         input_unit=card["input_unit"], scores=card.get("scores"),
                         provenance=provenance() | {"source": str(config.checkpoint or config.mat),
                                                    "data": card.get("data")})
    artifact.load(path)
    print(f"artifact: {path}")


if __name__ == "__main__":
    main()
