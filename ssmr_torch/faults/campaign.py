"""The campaign: every kind of fault is injected, each result is judged by its known answer, and counted in a table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from tqdm import tqdm

from ssmr_torch.faults.limited_work import LimitedWork, ProcessEnded, TookTooLong
from ssmr_torch.faults.outcome import BAD, OUTCOMES, counts
from ssmr_torch.lazy import found
from ssmr_torch.result_files import save_csv, save_json

ROOM = "ssmr_torch.faults"
# Trials of recordings: one file each, with TRIALS.
RECORDINGS = {
    "clean": ("clean_trials",), "measurements": ("measurement_trials", "level_trials", "missing_row_trials"),
    "clocks": ("clock_trials", "two_clock_trials"),
    "text": ("dialect_trials",), "tools": ("tool_trials", "container_trials"), "cards": ("card_trials",)}


@dataclass(frozen=True)
class Work:
    """A part of the campaign with a size of its own.

    target: function(count, seed) → rows. size: name of the count in the configuration. kind: put before the kinds of
    its rows, where these do not say whose they are.
    """

    target: str
    size: str
    kind: str = ""


OTHERS = {
    "flips": Work("damaged_files:flips", "flips"), "control": Work("garbage_control:steps", "steps"),
    "wire": Work("hostile_frames:frames", "frames"),
    "settings": Work("wrong_settings:wrong_settings", "settings", "settings: "),
    "interruptions": Work("interrupted_work:interrupted", "moments", "interrupted: ")}
GROUPS = (*RECORDINGS, *OTHERS)


class FaultsFound(ValueError):
    """Some faults had another outcome than they should have."""


def run_trial(file: str, place: int, seed: int) -> dict:
    """One trial of recordings in a folder of its own; its row."""
    with TemporaryDirectory() as folder:
        return found(f"{ROOM}.{file}:TRIALS")[place].run(Path(folder), seed).row()


def campaign(directory: Path, sizes: Mapping[str, int], *, only: tuple[str, ...] = (), repeats: int = 1, seed: int = 0,
             limit: float = 60.0, provenance: Mapping | None = None, progress: bool = True,
             say: Callable[[str], None] = print) -> list[dict]:
    """Inject the faults of these groups, or of all; the table, a row for each kind with the count of each outcome.

    sizes: of the groups with a size of their own, by the name of the size; 0 leaves a group out. repeats: draws of
    places and sizes of each trial of recordings. limit: s of wall time for a trial; a group with a size may take 20
    times as long. Writes trials.csv, faults.csv and faults.json into the directory, complete after every trial.
    Raises ValueError for an unknown group, and `FaultsFound` after the table where an outcome is wrong.
    """
    unknown = [name for name in only if name not in GROUPS]
    if unknown:
        raise ValueError(f"only names {unknown[0]!r}; the groups are {', '.join(GROUPS)}")
    chosen = [name for name in GROUPS if not only or name in only]
    rows: list[dict] = []
    with LimitedWork() as work:
        for found_rows in tqdm(list(_jobs(work, chosen, sizes, repeats, seed, limit)), desc="faults",
                               disable=not progress):
            rows += found_rows()
            _save(directory, rows, provenance)
    table = counts(rows)
    for line in lines_of(table):
        say(line)
    bad = [row for row in rows if row["outcome"] in BAD]
    for row in bad:
        say(f"{row['outcome']}: {row['kind']}, {row['case']}: {row['said'][:300]}")
    if bad:
        raise FaultsFound(f"{len(bad)} of {len(rows)} faults had a wrong outcome; {directory / 'trials.csv'} has all")
    return table


def _jobs(work: LimitedWork, chosen: list[str], sizes: Mapping[str, int], repeats: int, seed: int,
          limit: float) -> Iterator[Callable[[], list[dict]]]:
    for name in chosen:
        for file in RECORDINGS.get(name, ()):
            for place, trial in enumerate(found(f"{ROOM}.{file}:TRIALS")):
                for draw in range(repeats):
                    yield _job(work, f"{ROOM}.campaign:run_trial", limit, (trial.kind, trial.name),
                               file=file, place=place, seed=seed + draw)
        other = OTHERS.get(name)
        if other and sizes.get(other.size) and find_spec(f"{ROOM}.{other.target.partition(':')[0]}"):
            yield _job(work, f"{ROOM}.{other.target}", 20 * limit, (name, f"{sizes[other.size]} {other.size}"),
                       before=other.kind, count=sizes[other.size], seed=seed)


def _job(work: LimitedWork, target: str, limit: float, named: tuple[str, str], before: str = "",
         **arguments) -> Callable[[], list[dict]]:
    def do() -> list[dict]:
        kind, case = named
        try:
            good, result = work.call(target, limit, **arguments)
        except TookTooLong as late:
            return [{"kind": kind, "case": case, "outcome": "hang", "said": str(late)}]
        except ProcessEnded as ended:
            return [{"kind": kind, "case": case, "outcome": "traceback", "said": str(ended)}]
        if not good:
            return [{"kind": kind, "case": case, "outcome": "traceback", "said": result}]
        return [result] if isinstance(result, dict) else [{**row, "kind": before + row["kind"]} for row in result]

    return do


def _save(directory: Path, rows: list[dict], provenance: Mapping | None) -> None:
    save_csv(directory / "trials.csv", rows)
    save_csv(directory / "faults.csv", counts(rows))
    save_json(directory / "faults.json", {"rows": counts(rows), "trials": rows, "provenance": dict(provenance or {})})


def lines_of(table: list[dict]) -> list[str]:
    """The table as text."""
    columns = ["kind", "trials", *OUTCOMES]
    width = max([len("kind"), *(len(row["kind"]) for row in table)])
    head = "  ".join([columns[0].ljust(width), *(column.rjust(9) for column in columns[1:])])
    return [head, *("  ".join([row["kind"].ljust(width), *(str(row[column] or "–").rjust(9) for column in columns[1:])])
                    for row in table)]
