"""Checkpoint, or a published .mat model → artifact, and its deployable forms in C, for Torch, as ONNX.

ssmr export checkpoint=FILE.ckpt formats=[c]; of an existing artifact: ssmr export artifact=DIR formats=[c]
"""

from pathlib import Path

from ssmr_torch.experiments.entry import entry_point


@entry_point("export")
def main(config, directory):
    from ssmr_torch.deployment import artifact
    from ssmr_torch.deployment.deploy import deploy
    from ssmr_torch.provenance import fingerprint, provenance

    path, forms = Path(config.artifact), []
    formats = [config.formats] if isinstance(config.formats, str) else list(config.formats or [])
    given = [source for source in (config.checkpoint, config.mat) if source is not None]
    if len(given) > 1 or not given and not (path / "card.json").is_file():
        raise ValueError("give either checkpoint=FILE.ckpt or mat=FILE.mat, or artifact=DIR of an existing artifact, "
                         "to write its deployable forms")
    if not given:
        forms = deploy(path, formats)
    else:
        model, card = model_of(config)
        artifact.save(path, model, name=config.name or card["name"], output_names=card["output_names"],
                      input_names=card["input_names"], rest=card["rest"], input_range=card["input_range"],
                      input_unit=card["input_unit"], scores=card.get("scores"), cost=card.get("cost"),
                      sampling_time=card.get("sampling_time"), output_range=card.get("output_range"),
                      provenance=provenance() | {"source": fingerprint(given[0]), "training": card.get("training"),
                                                 "data": card.get("data")},
                      complete=lambda aside: forms.extend(deploy(aside, formats)))
        artifact.load(path)
    print(f"artifact: {path}", *(f"{artifact.DEPLOYED}/ {form}" for form in forms), sep="\n")


def model_of(config):
    """The model of a checkpoint or of a published file, and what an artifact's card says of it."""
    if config.mat is None:
        from ssmr_torch.deployment.checkpoint_twin import load_twin

        twin = load_twin(config.checkpoint)
        if twin is not None:
            return twin
        from ssmr_torch.fitting.checkpoints import load_model

        model, card = load_model(config.checkpoint)
        return model.reduced.numpy(), card
    from ssmr_torch.paper.models import read_published_model

    return read_published_model(
        config.mat, output_names=config.output_names, input_names=config.input_names, rest=config.rest,
        length_unit=config.length_unit, input_unit=config.input_unit, state_scale=config.state_scale)


if __name__ == "__main__":
    main()
