"""Faults that are injected on purpose, each with its right answer, and what the package makes of them."""
