"""Faults of every kind → what the package makes of them: a table of kind × outcome.

ssmr faults only=[measurements,clocks]
"""

from ssmr_torch.entry_point import entry_point, origin_of, save_result


@entry_point("faults")
def main(config, directory):
    from ssmr_torch.faults.campaign import campaign

    table = campaign(directory, config.sizes, only=tuple(config.only), repeats=config.repeats, seed=config.seed,
                     limit=config.time_limit, provenance=origin_of(config), progress=config.progress)
    print(directory / "faults.json")
    save_result(directory, {"trials": float(table[-1]["trials"]) if table else 0.0})


if __name__ == "__main__":
    main()
