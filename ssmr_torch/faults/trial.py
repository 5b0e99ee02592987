"""A trial: a function that writes recordings with one fault into a folder, and the answer that is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from ssmr_torch.faults.made_recordings import MadeRecordings, Robot, made_recordings
from ssmr_torch.faults.outcome import Expected, Found
from ssmr_torch.faults.reading import judged

Spoil = Callable[[MadeRecordings, np.random.Generator, Path], Expected]


@dataclass(frozen=True)
class Trial:
    """kind: of fault. spoil(recordings, rng, folder): changes them at random places and says what is expected; it
    writes the files itself where they are not the usual ones. robot: whose recordings; None for ones of its own.
    """

    kind: str
    name: str
    spoil: Spoil
    robot: Robot

    def run(self, folder: Path, seed: int = 0) -> Found:
        """Write the recordings with the fault into an empty folder, read them and judge."""
        made = made_recordings(self.robot)
        rng = np.random.default_rng([seed, crc32(f"{self.kind}: {self.name}".encode())])
        expected = self.spoil(made, rng, folder)
        card = folder / "card.yaml"
        if not card.exists():
            made.write(folder)
        outcome, said = judged(card, made, expected)
        return Found(self.kind, expected.case, outcome, said)


class Trials(list[Trial]):
    """The trials of one file, collected by a decorator."""

    def of(self, kind: str, robot: Robot | None = None) -> Callable[[Spoil], Spoil]:
        def collect(spoil: Spoil) -> Spoil:
            self.append(Trial(kind, spoil.__name__.replace("_", " "), spoil, robot or Robot()))
            return spoil

        return collect
