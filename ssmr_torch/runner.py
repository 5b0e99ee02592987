"""Former place of `ssmr_torch.wire.runner`: it names the new place. It will be removed with the next version."""

import sys

if __name__ == "__main__":
    sys.exit("python -m ssmr_torch.runner is now python -m ssmr_torch.wire.runner, with the same arguments")
