"""A log of what the other end causes, which cannot be flooded."""

from __future__ import annotations

import logging
from collections import Counter

# So many events of a kind are logged one by one; after them only each tenth, hundredth, … of it.
FIRST = 3


class Notices:
    """Writes the first events of a kind to a log, later only those whose number is a power of ten.

    10⁶ malformed messages thus leave nine lines. The counts of the ends still hold every one.
    """

    def __init__(self, log: logging.Logger, first: int = FIRST):
        self.log, self.first = log, int(first)
        self.seen: Counter[str] = Counter()

    def say(self, kind: str, text: str, *, level: int = logging.WARNING) -> None:
        """Log the text, unless there were too many of this kind."""
        self.seen[kind] += 1
        number = self.seen[kind]
        if number < self.first:
            self.log.log(level, "%s", text)
        elif number == self.first or set(str(number)[1:]) == {"0"} and str(number)[0] == "1":
            self.log.log(level, "%s (number %d; of more, only those with a power of ten are logged)", text, number)
