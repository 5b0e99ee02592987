"""Stamps that are text: dates and times of day as they are written, as nanoseconds."""

from __future__ import annotations

import numpy as np

SECOND, DAY = 10 ** 9, 86400 * 10 ** 9  # ns
ZONE = r"(?P<zone>Z|[A-Z]{2,5}|(?:UTC|GMT)?[+-]\d{2}:?(?:\d{2})?)?"
PATTERNS = (
    r"(?P<date>.*?)[T\s_,]*(?<!\d)(?P<h>\d{1,2}):(?P<m>\d{2}):(?P<s>\d{2})(?:[.,:](?P<f>\d+))?"
    rf"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*{ZONE}",
    rf"(?P<date>\d{{8}})[T\s_-]?(?P<h>\d{{2}})(?P<m>\d{{2}})(?P<s>\d{{2}})(?:[.,](?P<f>\d+))?(?P<half>)\s*{ZONE}",
    r"(?P<date>)(?P<h>)(?P<m>\d{1,2}):(?P<s>\d{2})[.,](?P<f>\d+)(?P<half>)(?P<zone>)",  # minutes of Excel
)
DATES = ("%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%Y%m%d", "%d.%m.%Y", "%d.%m.%y", "%m/%d/%Y", "%d/%m/%Y", "%m/%d/%y",
         "%d/%m/%y", "%d-%m-%Y", "%d-%b-%Y", "%d %b %Y", "%b %d, %Y", "%b %d %Y", "%d %B %Y", "%B %d, %Y",
         "%a %b %d %Y", "%a, %d %b %Y")
HOURS = {"Z": 0, "UTC": 0, "GMT": 0, "CET": 1, "CEST": 2, "BST": 1, "EST": -5, "EDT": -4, "CST": -6, "CDT": -5,
         "MST": -7, "MDT": -6, "PST": -8, "PDT": -7, "JST": 9}


def is_text(stamps: np.ndarray) -> bool:
    """Whether a column holds text or dates, not numbers."""
    return stamps.dtype.kind in "OSUM"


def nanoseconds(stamps: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Nanoseconds (T,) int64 of stamps as text or datetime64, and which rows have one, (T,).

    Known are ISO 8601 and other dates with a time of day, and times of day alone, which go on at midnight. Offsets such
    as +02:00 are subtracted row by row, so that summer time makes no gap. Fractions are exact to 1 ns.
    Raises ValueError for what is no time, naming `where` and the row, and for dates of which day and month cannot be
    told apart.
    """
    import pandas

    if stamps.dtype.kind == "M":
        return stamps.astype("datetime64[ns]").astype(np.int64), ~np.isnat(stamps)
    column = pandas.Series(stamps, dtype=object)
    there = column.notna().to_numpy()
    if there.any() and all(hasattr(value, "utcoffset") for value in column[there]):
        utc = pandas.to_datetime(column, utc=True).dt.tz_localize(None).to_numpy("datetime64[ns]")
        return utc.astype(np.int64), there
    text = column.where(column.notna(), "").map(lambda cell: cell.decode() if isinstance(cell, bytes) else str(cell))
    text = text.str.strip().str.strip("\"'")
    there = there & (text != "").to_numpy() & (text.str.lower() != "nat").to_numpy()
    parts = _parts(text[there], where)
    found = np.zeros(len(stamps), dtype=np.int64)
    found[there] = _clock(parts) + _days(parts["date"], where) - _offsets(parts["zone"], where)
    if not parts["date"].any():
        found[there] = _past_midnight(found[there])
    return found, there


def _parts(text, where: str):
    """date, h, m, s, f, half, zone of each stamp."""
    best = None
    for pattern in PATTERNS:
        parts = text.str.extract(rf"^{pattern}$")
        failed = parts["s"].isna()
        if not failed.any():
            return parts.fillna("")
        best = failed if best is None or failed.sum() < best.sum() else best
    row = best[best].index[0]
    raise ValueError(f"{where}: row {row} (from 0) holds {text[row]!r}; expected a number, or a date and a time of "
                     "day, as 2024-03-31T01:59:59.900+01:00")


def _clock(parts) -> np.ndarray:
    """Nanoseconds since midnight."""
    hours = parts["h"].replace("", "0").astype(np.int64)
    half = parts["half"].str.lower().str[:1]
    hours = hours.where(half == "", hours % 12 + 12 * (half == "p"))
    seconds = 3600 * hours + 60 * parts["m"].astype(np.int64) + parts["s"].astype(np.int64)
    fraction = parts["f"].str[:9].str.pad(9, side="right", fillchar="0").astype(np.int64)
    return (SECOND * seconds + fraction).to_numpy(dtype=np.int64)


def _days(dates, where: str) -> np.ndarray:
    """Nanoseconds of midnight of each date."""
    import pandas

    dates = dates.str.strip(" ,T_")
    written = pandas.Index(dates.unique())
    if list(written) == [""]:
        return np.zeros(len(dates), dtype=np.int64)
    readings = {}
    for form in DATES:
        days = pandas.to_datetime(written, format=form, errors="coerce")
        if not days.isna().any():
            midnight = days.to_numpy("datetime64[ns]").astype(np.int64)
            readings.setdefault(tuple(np.diff(midnight)), midnight)
    if not readings:
        raise ValueError(f"{where} holds the date {written[0]!r}; expected one such as 2024-03-31")
    plausible = {steps: midnight for steps, midnight in readings.items() if max(map(abs, steps), default=0) <= DAY}
    if len(readings) > 1 and len(plausible) != 1:
        raise ValueError(f"{where} holds the dates {list(written[:2])}, in which day and month cannot be told apart; "
                         "write them as 2024-03-31")
    midnight = next(iter((plausible or readings).values()))
    return dates.map(dict(zip(written, midnight))).to_numpy(dtype=np.int64)


def _offsets(zones, where: str) -> np.ndarray:
    """Nanoseconds by which each stamp is ahead of UTC; one name of a zone throughout counts as none."""
    written = list(zones.unique())
    ahead = {}
    for zone in written:
        digits = zone.removeprefix("UTC").removeprefix("GMT").replace(":", "")
        if digits[:1] in ("+", "-"):
            minutes = 60 * int(digits[1:3]) + int(digits[3:5] or 0)
            ahead[zone] = (-1 if digits[0] == "-" else 1) * 60 * minutes
        elif len(written) == 1:
            ahead[zone] = 0
        elif zone in HOURS:
            ahead[zone] = 3600 * HOURS[zone]
        else:
            raise ValueError(f"{where} holds stamps of several time zones, of which {zone or 'none'!r} is not known; "
                             "write offsets, as +01:00")
    return zones.map(ahead).to_numpy(dtype=np.int64) * SECOND


def _past_midnight(stamps: np.ndarray) -> np.ndarray:
    """Times of day go on after midnight, where they fall by almost a day (or by an hour, where only minutes stand)."""
    span = DAY if stamps.max(initial=0) >= 3600 * SECOND else 3600 * SECOND
    falls = np.r_[0, np.diff(stamps)] < -0.9 * span
    return stamps + span * np.cumsum(falls)
