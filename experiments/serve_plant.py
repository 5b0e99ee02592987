"""Plant as a robot that looks for a controller elsewhere (docs/wire.md).

ssmr serve-plant plant=trunk connect=tcp://HOST:5555
"""

from hydra.utils import instantiate

from ssmr_torch.entry_point import entry_point, save_result


@entry_point("serve_plant", at_a_robot=True)
def main(config, directory):
    from ssmr_torch.wire.link import RobotLink
    from ssmr_torch.wire.robot_end import RobotEnd
    from ssmr_torch.wire.seal import read_key

    plant = instantiate(config.rig)(instantiate(config.plant))
    with RobotLink(config.connect, read_key(config.key_file)) as link:
        robot = RobotEnd(plant, link, real_time=config.real_time, timeout=config.timeout, patience=config.patience,
                         answer_within=config.answer_within, safe_input=config.safe_input)
        print(f"{plant.name} looks for a controller at {config.connect}", flush=True)
        robot.drive(config.runs, config.wait)
    print(f"{plant.name}: {dict(robot.counts)}")
    save_result(directory, dict(robot.counts))


if __name__ == "__main__":
    main()
