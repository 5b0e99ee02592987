"""Writes commissioning.md: the result of each confirmed step, with its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ssmr_torch import __version__

TITLES = {"card": "The card", "noise": "Noise at rest", "steps": "Polarity, order and delay of the inputs",
          "collection": "Recordings", "check": "What the recordings hold",
          "design": "The model and the controller", "slow circle": "A slow circle", "fast circle": "A fast circle"}
FIGURES = {"steps": ("steps.svg",), "check": ("recordings.svg",), "fast circle": ("circles.svg",)}


def written(robot: str, confirmed: Sequence[Mapping], present: Sequence[str]) -> str:
    """The report as Markdown.

    confirmed: entries with `step`, `time`, `said` and `faults`, in order.   present: names of the figures that exist.
    """
    lines = [f"# Commissioning of {robot}", "",
             f"ssmr_torch {__version__}; {len(confirmed)} of {len(TITLES)} steps are confirmed."]
    for number, entry in enumerate(confirmed, start=1):
        lines += ["", f"## {number}. {TITLES[entry['step']]}", "", entry["said"]]
        lines += [f"\n**Please check**: {fault}." for fault in entry["faults"]]
        lines += [f"\n![{TITLES[entry['step']]}]({name})" for name in FIGURES.get(entry["step"], ()) if name in present]
        lines += ["", f"Confirmed {entry['time']}."]
    return "\n".join(lines) + "\n"
