"""Robot → card, noise, polarity and delays, recordings, model, controller, circles, step by step.

ssmr commission card=ROBOT.yaml plant=remote hydra.run.dir=DIR
"""

from pathlib import Path

from hydra.utils import instantiate

from ssmr_torch.entry_point import entry_point, save_result


@entry_point("commission", resumed="", at_a_robot=True)
def main(config, directory):
    from ssmr_torch.commissioning.commission import STEPS, commission
    from ssmr_torch.commissioning.directory import REPORT
    from ssmr_torch.commissioning.safety_guard import SafetyStop

    card = Path(config.card)
    plant = instantiate(config.rig)(instantiate(config.plant))
    try:
        done = commission(plant, card, directory, excitation=instantiate(config.excitation), confirm=config.confirm,
                          settings=instantiate(config.settings))
    except SafetyStop as stop:
        raise SystemExit(f"commission: {stop} The run so far is kept in {directory / 'stopped'}") from stop
    left = "" if len(done) == len(STEPS) else f"; the same command with hydra.run.dir={directory} goes on"
    print(f"\n{len(done)} of {len(STEPS)} steps are confirmed{left}\n{directory / REPORT}")
    save_result(directory, {"confirmed": float(len(done))})


if __name__ == "__main__":
    main()
