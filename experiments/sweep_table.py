"""The table that a sweep ends with."""

import csv
import json
from pathlib import Path

from hydra.experimental.callback import Callback


class SweepTable(Callback):
    """After a multirun, gather every job's result.json into sweep.csv, best first by the first metric."""

    def on_multirun_end(self, config, **kwargs) -> None:
        directory = Path(config.hydra.sweep.dir)
        rows = []
        for file in sorted(directory.glob("*/result.json")):
            result = json.loads(file.read_text())
            rows.append({"job": file.parent.name, "overrides": " ".join(result["overrides"]), **result["metrics"]})
        if not rows:
            return
        columns = list(dict.fromkeys(column for row in sorted(rows, key=lambda row: "failed" in row) for column in row))
        first = next((column for column in columns[2:] if column != "failed"), "job")
        rows.sort(key=lambda row: (row.get(first) is None, row.get(first)))
        with open(directory / "sweep.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(rows)
        print(f"\n{len(rows)} jobs, best first by {first}: {directory / 'sweep.csv'}")
        print(f"  job  {'  '.join(columns[2:])}  overrides")
        for row in rows:
            values = "  ".join(f"{row.get(column):.4g}" if isinstance(row.get(column), float) else str(row.get(column))
                               for column in columns[2:])
            print(f"  {row['job']:>3}  {values}  {row['overrides']}")
