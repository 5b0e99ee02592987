"""Tasks: the path that a robot shall trace, as displacement from rest over time. Each function here gives a `Task`.

    task = ssmr_torch.tasks.figure_eight(tracked=["tip_x", "tip_y"])    # also circle, rose, letter
    task = ssmr_torch.tasks.path(times, points, outputs=["tip_x", "tip_y"])           # your own points
    task = ssmr_torch.tasks.circle(obstacles=[ssmr_torch.tasks.obstacles.Circle([0.0, 0.01], 0.004)])
"""

from typing import TYPE_CHECKING

from ssmr_torch.lazy import lazily

if TYPE_CHECKING:
    from ssmr_torch.tasks import obstacles
    from ssmr_torch.tasks.references import Task, circle, figure_eight, path, rose
    from ssmr_torch.tasks.symbols import symbol as letter

__all__ = ["Task", "circle", "figure_eight", "letter", "obstacles", "path", "rose"]

__getattr__, __dir__ = lazily(__name__, {
    **{name: f"ssmr_torch.tasks.references:{name}" for name in ("Task", "circle", "figure_eight", "path", "rose")},
    "letter": "ssmr_torch.tasks.symbols:symbol", "obstacles": "ssmr_torch.tasks.obstacles:"})
