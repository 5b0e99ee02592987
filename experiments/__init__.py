"""The entry points, each a Hydra application: `ssmr NAME` is `python experiments/NAME.py`."""
