"""Units that files say, compared with those of the recording card."""

from __future__ import annotations

from ssmr_torch.data.recording_card import RecordingCard
from ssmr_torch.recording_files.table import Table

SAME = 0.01          # of the sampling time, within which a file and a card agree


def refuse_other_units(table: Table, card: RecordingCard, file: str) -> None:
    """Raises ValueError where a file says another unit of a column, or another sampling time, than the card.

    Inputs that the card calls "1" may have any unit.
    """
    if card.sampling_time is not None and table.interval:
        given = card.sampling_time * card.units.scale("time")
        if abs(given - table.interval) > SAME * table.interval:
            raise ValueError(f"{file}: the file says a sampling time of {table.interval:.6g} s, the card {given:.6g} "
                             "s; correct sampling_time, or name the column of time")
    named = {"length": card.columns.observation, "input": card.columns.input,
             "time": [card.columns.time] if isinstance(card.columns.time, str) else []}
    for key, names in named.items():
        expected = getattr(card.units, key)
        for name in names:
            said = table.units.get(table.find(name) or name)
            if said is None or said in (expected, "1") or (key == "input" and expected == "1"):
                continue
            remedy = f"write {said} as units.{key}" if _known(card, key, said) else f"convert the column {_to(key)}"
            raise ValueError(f"{file}: the file says {said}, the card {expected}, of the column {name!r}; {remedy}, or "
                             "correct the file")


def _known(card: RecordingCard, key: str, unit: str) -> bool:
    try:
        card.units.changed(**{key: unit})
    except ValueError:
        return False
    return True


def _to(key: str) -> str:
    return {"length": "to m, cm or mm", "input": "to N or mN, or write \"1\" as units.input", "time": "to s"}[key]

