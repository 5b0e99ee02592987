"""Checkpoint, or a published .mat model → artifact, and its deployable forms in C, for Torch, as ONNX.

ssmr export checkpoint=FILE.ckpt formats=[c]; of an existing artifact: ssmr export artifact=DIR formats=[c]
"""

from ssmr_torch.entry_point import entry_point
from ssmr_torch.lazy import found

PUBLISHED = "ssmr_torch.paper.models:read_published_model"
OF_PUBLISHED = ("output_names", "input_names", "rest", "length_unit", "input_unit", "state_scale")


@entry_point("export")
def main(config, directory):
    from ssmr_torch.deployment.artifact import DEPLOYED
    from ssmr_torch.deployment.export_of_artifact import save_with_forms, source_of
    from ssmr_torch.deployment.exported_programs import deploy

    formats = [config.formats] if isinstance(config.formats, str) else list(config.formats or [])
    source = source_of(config.artifact, config.checkpoint, config.mat)
    forms = deploy(config.artifact, formats) if source is None else save_with_forms(
        config.artifact, *model_of(config), formats, source=source, name=config.name)
    print(f"artifact: {config.artifact}", *(f"{DEPLOYED}/ {form}" for form in forms), sep="\n")


def model_of(config):
    """The model, and what its checkpoint or its published file says of it."""
    from ssmr_torch.deployment.checkpoint_copy import load_twin

    if config.mat is not None:
        return found(PUBLISHED)(config.mat, **{name: config[name] for name in OF_PUBLISHED})
    return load_twin(config.checkpoint) or found("ssmr_torch.fitting.checkpoints:load_arrays")(config.checkpoint)


if __name__ == "__main__":
    main()
