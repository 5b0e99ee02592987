"""The runs that a recording card names, and the pieces of runs between seams."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ssmr_torch.data.recording_card import RecordingCard
from ssmr_torch.data.run_boundaries import find_seams
from ssmr_torch.recording_clocks.gaps import find_time_gaps
from ssmr_torch.recording_faults.recording import Recording

PIECE = re.compile(r"(?P<run>.+)/(?P<number>\d+)")


def with_full_names(card: RecordingCard, runs: Sequence[str]) -> RecordingCard:
    """The card with the full names of the runs that it names: "session:r1" for "r1" where only one run is called so.

    A name may be that of a piece, "m/1", of a run that exists.
    Raises ValueError for a name that no run has, with the nearest.
    """
    def full(names: Iterable[str], key: str) -> list[str]:
        found = {name: _full(name, runs) for name in names}
        unknown = [name for name, known in found.items() if known is None]
        if unknown:
            near = difflib.get_close_matches(unknown[0], runs, n=1)
            raise ValueError(f"{key} names the runs {list(found)}, of which {unknown} do not exist; "
                             f"{f'did you mean {near[0]!r}? ' if near else ''}the runs are {list(runs[:10])}"
                             f"{'…' if len(runs) > 10 else ''}")
        return list(found.values())

    seams = card.seams
    if isinstance(seams, dict):
        seams = dict(zip(full(seams, "seams"), seams.values()))
    return card.changed(
        decays=full(card.decays, "decays"), centred=full(card.centred, "centred"), seams=seams,
        split={split: full(names, f"split.{split}") for split, names in card.split.items()})


def kind_and_split(name: str, card: RecordingCard) -> dict:
    """What the card says that a run, or a piece of one, is for; what it says of the run holds for its pieces."""
    found = PIECE.fullmatch(name)
    names = {name, *([found["run"]] if found else [])}
    splits = [split for wanted in (name, found and found["run"])
              for split, runs in card.split.items() if wanted in runs]
    return {"kind": "decay" if names & set(card.decays) else "controlled", "split": splits[0] if splits else "train",
            "centred": bool(names & set(card.centred))}


def in_pieces(recordings: Sequence[Recording], card: RecordingCard) -> list[Recording]:
    """The recordings; those of which the card names a piece, such as m/1, are cut at their seams.

    Seams are those that the card declares, else those that are found, and gaps in time.
    Raises ValueError for a piece that does not exist.
    """
    named = {*card.decays, *card.centred, *(name for names in card.split.values() for name in names)}
    return [piece for recording in recordings
            for piece in (_pieces(recording, named, card) if any(_of(recording, name) for name in named)
                          else [recording])]


def _full(name: str, runs: Sequence[str]) -> str | None:
    if name in runs:
        return name
    short = [run for run in runs if run.partition(":")[2] == name]
    if len(short) == 1:
        return short[0]
    found = PIECE.fullmatch(name)
    run = _full(found["run"], runs) if found else None
    return f"{run}/{int(found['number'])}" if run else None


def _of(recording: Recording, name: str) -> bool:
    """Whether a name is that of a piece of this recording."""
    found = PIECE.fullmatch(name)
    return bool(found) and found["run"] == recording.name


def _pieces(recording: Recording, named: set[str], card: RecordingCard) -> list[Recording]:
    if recording.seams == "auto":
        good = np.flatnonzero(np.isfinite(recording.observation).all(axis=1) & np.isfinite(recording.time))
        starts = good[[*find_seams(recording.observation[good]), *find_time_gaps(recording.time[good])]]
        starts = sorted(int(start) for start in starts)
    else:
        starts = [int(start) for start in np.searchsorted(recording.rows, recording.seams)]
    edges = [0, *starts, len(recording.time)]
    missing = [name for name in named
               if _of(recording, name) and int(PIECE.fullmatch(name)["number"]) >= len(edges) - 1]
    if missing:
        raise ValueError(f"{sorted(missing)} do not exist: {recording.name} has {len(edges) - 1} pieces, "
                         f"{recording.name}/0 to {recording.name}/{len(edges) - 2}, cut at the rows "
                         f"{recording.rows[starts].tolist()}; declare its seams, or name one of these")
    pieces = []
    for number, (start, stop) in enumerate(zip(edges, edges[1:])):
        name, rows = f"{recording.name}/{number}", slice(start, stop)
        if stop - start < 2:
            raise ValueError(f"{name} has {stop - start} samples; at least 2 are needed: move its seam")
        pieces.append(replace(
            recording, name=name, time=recording.time[rows], observation=recording.observation[rows],
            input=recording.input[rows], rows=recording.rows[rows], seams=(), notes=() if number else recording.notes,
            **kind_and_split(name, card)))
    return pieces
