"""Check of the faults that were found when the recordings were read."""

from __future__ import annotations

from collections.abc import Mapping

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, Finding

SHOWN = 6           # faults that are said one by one


def faults(recorded: Recorded) -> Finding:
    """The faults that reading the recordings found, with their rows and remedies, and what was done about them."""
    notes = recorded.dataset.provenance.get("notes") or []
    if not notes:
        return Finding("faults", GOOD, "Reading found no fault in the recordings.", "", {"count": 0})
    rows = {done: sum(_rows(note) for note in notes if note["done"] == done)
            for done in ("bridged", "cut", "dropped", "corrected")}
    kept = sum(note["done"] == "kept" for note in notes)
    changed = ", ".join(f"{count} rows {done}" for done, count in rows.items() if count)
    runs = len({note["run"] for note in notes})
    said = (f"{len(notes)} fault{'s' if len(notes) > 1 else ''} in {runs} run{'s' if runs > 1 else ''}"
            f"{f', {changed}' if changed else ''}{f', {kept} kept' if kept else ''}. "
            + " ".join(f"{note['run']}: {note['said']}." for note in notes[:SHOWN])
            + (f" {len(notes) - SHOWN} more stand in the provenance." if len(notes) > SHOWN else ""))
    remedy = "Look at these rows in the files; a rule for each kind of fault stands under faults in the card."
    curves = [_curve(note, recorded) for note in notes if "recorded_m" in note["numbers"]]
    numbers = {"count": len(notes), "kept": kept, "rows": rows, "notes": list(notes)}
    return Finding("faults", LOOK, said, remedy, numbers, {"stretches": curves} if curves else {})


def _rows(note: Mapping) -> int:
    return note.get("count", sum(last - first + 1 for first, last in note["rows"]))


def _curve(note: Mapping, recorded: Recorded) -> dict:
    """What the figure shows of a fault: rows and values, m, around the first bad row, and the bad ones among them."""
    first, values = note["numbers"]["first_row"], note["numbers"]["recorded_m"]
    bad = [any(begin <= row <= end for begin, end in note["rows"]) for row in range(first, first + len(values))]
    return {"title": f"{note['run']}: {note['kind'].replace('_', ' ')}, {note['done']}", "first_row": first,
            "values": values, "bad": bad, "output": recorded.dataset.output_names[note["numbers"]["column"]]}
