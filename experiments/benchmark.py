"""One benchmark → one table, as text, CSV and JSON; without a name, the list of them.

ssmr benchmark step horizons=[5,10]
"""

import sys

from hydra.core.hydra_config import HydraConfig

from ssmr_torch.benchmarks.catalogue import NAMES, as_overrides, listed, settings_of
from ssmr_torch.benchmarks.machine import one_thread
from ssmr_torch.configuration import plain
from ssmr_torch.entry_point import entry_point, offer, origin_of, save_result


@entry_point("benchmark")
def run(config, directory):
    from ssmr_torch.benchmarks.table import tabulate
    from ssmr_torch.lazy import found

    name, settings = HydraConfig.get().runtime.choices.benchmark, plain(config)
    if name is None:
        raise ValueError(f"no benchmark is named; expected the name of one: {', '.join(NAMES)}")
    rows = tabulate(name, found(f"ssmr_torch.benchmarks.{name}:rows")(**settings), settings, directory,
                    origin_of(config))
    save_result(directory, {"rows": float(len(rows))}, name=name)


def main():
    try:
        sys.argv[1:] = as_overrides(sys.argv[1:]) or sys.exit(print(listed()))
    except ValueError as unknown:
        sys.exit(f"benchmark: {unknown}")
    one_thread()
    offer("benchmark", {name: settings_of(name) for name in NAMES})
    run()


if __name__ == "__main__":
    main()
