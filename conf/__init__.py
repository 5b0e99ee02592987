"""The configurations: groups of Hydra, one folder each."""
