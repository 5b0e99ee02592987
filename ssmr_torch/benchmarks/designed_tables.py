"""The rows of designed.py as tables: one page for each robot, and the worst of all by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ssmr_torch import data_sheet as sheet

PLAIN = "design", "readjustment", "rehearsal"  # rows that are no runs


def in_words(row: dict) -> str:
    """One row, in a line."""
    if "raised" in row:
        return f"failed: {row['raised'].splitlines()[0]}"
    if "design" in row:
        facts = row["design"]
        return f"{facts['seconds']:.0f} s, {facts['model']}"
    if "rmse" not in row:
        return ", ".join(f"{name} {row[name]}" for name in ("out of reach", "fastest", "words") if name in row)
    return f"{share(row['rmse'], row)} of the reach after the approach, {share(row['rmse after 1 s'], row)} after 1 s" \
        + (f", ISE {1e6 * row['ise']:.4g} mm²" if "ise" in row else "") + (", LOST" if row["lost"] else "") \
        + (f", fallbacks {row['reasons']}" if row.get("reasons") else "")


def share(error: float | None, row: dict) -> str:
    return "∞" if error is None else f"{sheet.number(100 * error / row['reach'], 3)} %"


def runs(robot: str, rows: Mapping[str, Mapping]) -> Iterator[dict]:
    """Every run of a robot as one row: what it was, its errors as shares of the reach, losses, fallbacks, times."""
    for key, row in rows.items():
        of, *parts = key.split("/")
        if of != robot or parts[0] in PLAIN:
            continue
        unit = row.get("reach")
        found = {"robot": of, **dict(zip(("part", "model", "condition", "told", "task"), parts)),
                 "seed": int(parts[-1])}
        found |= {f"{name}, % of reach": None if unit is None or row.get(key) is None else 100 * row[key] / unit
                  for name, key in (("RMSE", "rmse"), ("RMSE after 1 s", "rmse after 1 s"), ("within", "rmse within"))}
        yield found | {"ISE, mm²": None if row.get("ise") is None else 1e6 * row["ise"],
                       "lost": bool(row.get("lost", True)), "fallbacks": row.get("fallbacks"),
                       "at a bound, %": None if unit is None else 100 * row["at a bound"],
                       **{f"{name}, ms": None if row.get(key) is None else 1e3 * row[key] for name, key in (
                           ("step median", "solve_time_median"), ("step 99 %", "solve_time_p99"),
                           ("slowest step", "slowest step"))}, "failure": row.get("raised", "")}


def page(robot, rows: dict[str, dict]) -> str:
    """All tables of a robot as Markdown."""
    runs = {tuple(key.split("/")): row for key, row in rows.items() if key.startswith(f"{robot.name}/")}
    ise = robot.name == "emulated_bench"
    parts = [f"# {robot.name}", _what(robot, ise)]
    for part in ("nominal", "far", "disturbed"):
        mine = {key[2:]: row for key, row in runs.items() if key[1] == part}
        if mine:
            parts += [f"## {part}", _table(mine, ise)]
    for title, kind in (("Rehearsals", "rehearsal"), ("Readjustments", "readjustment"), ("Designs", "design")):
        mine = {key[2:]: row for key, row in runs.items() if key[1] == kind}
        if mine:
            parts += [f"## {title}", _listed(kind, mine)]
    return "\n\n".join(parts) + "\n"


def _what(robot, ise: bool) -> str:
    notes = [f"{condition.name}: {condition.note}" for condition in robot.conditions if condition.note]
    number = "ISE in mm²" if ise else "root-mean-square error after the approach, in % of the reach"
    return f"Cells: {number}, mean over the seeds, and how many of them were lost or failed." \
        + (f" {'; '.join(notes)}." if notes else "")


def _table(rows: dict[tuple, dict], ise: bool) -> str:
    """Rows by model, condition and told; columns by task."""
    tasks = list(dict.fromkeys(key[3] for key in rows))
    lines = [["model", "condition", "told", *tasks, "worst after 1 s", "lost", "fallbacks", "at a bound",
              "step, ms: median", "99 %", "slowest"]]
    for head in dict.fromkeys(key[:3] for key in rows):
        mine = {key: row for key, row in rows.items() if key[:3] == head}
        cells = [_cell([row for key, row in mine.items() if key[3] == task], ise) for task in tasks]
        lines.append([*head, *cells, *_totals(list(mine.values()))])
    return _markdown(lines)


def _cell(rows: list[dict], ise: bool) -> str:
    """Mean over the seeds; of what is out of reach also the error where it is not."""
    if not rows:
        return ""
    good = [row for row in rows if row.get("rmse") is not None]
    lost = [row for row in rows if "raised" in row or row["lost"]]
    text = "failed"
    if good:
        unit = good[0]["reach"]
        text = sheet.number(1e6 * np.mean([row.get("ise", np.inf) for row in good]), 4) if ise else \
            sheet.number(100 * np.mean([row["rmse"] for row in good]) / unit, 3)
        within = [row["rmse within"] for row in good if row["within"] < 0.999 and row["rmse within"] is not None]
        if within and not ise:
            text += f" ({sheet.number(100 * np.mean(within) / unit, 3)} on {100 * good[0]['within']:.0f} % in reach)"
        if ise and good[0].get("static ise", 0.0) > 1e-6:
            text += f" (floor {sheet.number(1e6 * good[0]['static ise'], 3)})"
    return text + (f", {len(lost)} of {len(rows)} lost" if lost else "")


def _totals(rows: list[dict]) -> list[str]:
    run = [row for row in rows if row.get("rmse") is not None]
    lost = sum("raised" in row or row["lost"] for row in rows)
    worst = max((row["rmse after 1 s"] / row["reach"] for row in run), default=np.inf)
    times = [[1e3 * row[name] for row in run if name in row] for name in ("solve_time_median", "solve_time_p99",
                                                                          "slowest step")]
    return [f"{sheet.number(100 * worst, 3)} %", f"{lost} of {len(rows)}",
            f"{sum(row.get('fallbacks', 0) for row in run):g}",
            f"{100 * max((row.get('at a bound', 0.0) for row in run), default=0.0):.0f} %",
            *(sheet.number(each(numbers), 3) if numbers else "" for each, numbers in zip((np.median, max, max), times))]


def _listed(kind: str, rows: dict[tuple, dict]) -> str:
    lines = []
    for key, row in rows.items():
        name = ", ".join(key)
        if "raised" in row or kind == "readjustment":
            lines.append(f"- {name}: {row.get('words') or in_words(row)}")
        elif kind == "rehearsal":
            held = ", ".join(f"{which} {100 * part:.3g} %" for which, part in row["held"].items())
            known = [each for each in row["floor"] if np.isfinite(each)]
            lines.append(f"- {name}: {100 * row['out of reach']:.3g} % out of reach at rest, at most "
                         f"{1e3 * max(known, default=np.inf):.3g} mm, and {len(row['floor']) - len(known)} of "
                         f"{len(row['floor'])} points where the model does not rest; fastest {row['fastest']} times; "
                         f"at bounds: {held or 'none'}")
        else:
            lines.append(f"- {name}: {_design(row['design'])}")
    return "\n".join(lines)


def _design(facts: dict) -> str:
    actuator = {name: value for name, value in facts["actuator"].items() if value and name not in
                ("timestep", "input_range", "ease")}
    twin = ", ".join(f"{case} {'lost' if error is None else f'{100 * error:.3g} %'}"
                     for case, error in facts["against_twin"].items())
    return (f"{facts['seconds']:.0f} s; actuator {actuator or 'none'}; {facts['model']}, held-out error "
            f"{100 * facts['model_error']:.3g} % of {1e3 * facts['reach']:.4g} mm; {facts['designs']['safe']} of "
            f"{facts['designs']['count']} with margins, judged by {facts['designs']['judged_by']}; move "
            f"{facts['weights']['move']:g}, observer × {facts['weights']['observer']}; twin: {twin}")


def worst(rows: dict[str, dict]) -> str:
    """Worst robot and task of the nominal runs, and all that was lost."""
    nominal = {tuple(key.split("/")): row for key, row in rows.items() if key.split("/")[1] == "nominal"}
    errors: dict[tuple, list[float]] = {}
    for key, row in nominal.items():
        of_reach = np.inf if row.get("rmse") is None else row["rmse"] / row["reach"]
        errors.setdefault((key[0], key[2], key[5]), []).append(of_reach)
    lines = []
    if errors:
        where = max(errors, key=lambda key: np.mean(errors[key]))
        lines.append(f"worst nominal robot and task: {where[0]}, {where[2]} by {where[1]}: "
                     f"{sheet.number(100 * np.mean(errors[where]), 3)} % of the reach")
    runs = {key: row for key, row in rows.items() if key.split("/")[1] not in PLAIN}
    lost = [key for key, row in runs.items() if row.get("lost") or "raised" in row]
    lines.append(f"lost or failed: {len(lost)} of {len(runs)} runs" + "".join(f"\n  {key}" for key in lost))
    return "\n".join(lines)


def _markdown(rows: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (rows[0], ["---"] * len(rows[0]), *rows[1:]))
