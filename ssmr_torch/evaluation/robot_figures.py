"""Stills and animations of a deforming robot: its surface, the path of its tip, and the reference; axes in mm."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from ssmr_torch.evaluation.figures import METHODS, MM, WIDTH, colours, panels, styled
from ssmr_torch.result_files import written_aside

AXES = ("x", "y", "z")
SHADOW, LIT = np.array([0.25, 0.31, 0.38]), np.array([0.93, 0.91, 0.87])
REST, SHEET = "#DDDDDD", "#DCEEF9"
# direction of the light (right, up, towards the viewer): from behind the viewer's left shoulder, for every camera
LIGHT = np.array([-0.45, 0.60, 0.66])


@dataclass(frozen=True)
class Camera:
    """A viewer at infinite distance, so that one scale bar is valid for the whole picture.

    elevation: degrees above the horizontal plane, below it when negative.   azimuth: degrees about `up`, from the
    next axis in x → y → z → x.   up: the axis that points up in the picture, "+x" to "-z".
    Raises ValueError if an angle is not finite, or for an unknown axis.
    """

    elevation: float = 30.0
    azimuth: float = -62.0
    up: str = "+z"

    def __post_init__(self):
        if self.up not in [sign + axis for sign in "+-" for axis in AXES]:
            raise ValueError(f"the axis that points up is {self.up!r}; expected one of +x, +y, +z, -x, -y, -z")
        if not np.isfinite([self.elevation, self.azimuth]).all():
            raise ValueError(f"elevation {self.elevation}° and azimuth {self.azimuth}°; expected finite angles")

    @property
    def frame(self) -> np.ndarray:
        """(3, 3): the unit vectors right, up and towards the viewer as rows, right-handed."""
        sign = 1.0 if self.up[0] == "+" else -1.0
        above, ahead, aside = np.roll(np.eye(3), -AXES.index(self.up[1]), axis=0) * [[sign], [1.0], [sign]]
        azimuth, elevation = np.deg2rad([self.azimuth, self.elevation])
        outwards = np.cos(azimuth) * ahead + np.sin(azimuth) * aside
        right = np.cos(azimuth) * aside - np.sin(azimuth) * ahead
        towards = np.cos(elevation) * outwards + np.sin(elevation) * above
        return np.stack([right, np.cross(towards, right), towards])


STANDING = Camera()
# from below, because from there a letter written in x and y is neither mirrored nor behind the robot
HANGING = Camera(elevation=-24.0, azimuth=-72.0, up="-z")


@styled
def robot_stills(shapes: np.ndarray, triangles: np.ndarray, times: np.ndarray, tip_path: np.ndarray,
                 reference: np.ndarray | None = None, *, tip_times: np.ndarray, rest: np.ndarray | None = None,
                 camera: Camera = STANDING, plane: Sequence[int] | None = None, name: str = "SSMR") -> Figure:
    """The robot at K instants side by side, each with the path of its tip so far and the whole reference.

    shapes: (K, N, 3) m, the nodes; triangles: (F, 3) nodes of the surface; times: (K,) s, ascending.
    tip_path: (T, 3) m at tip_times (T,) s, which contain the instants; reference: (T', 3) m; rest: (N, 3) m, drawn
    as a pale silhouette. All positions are absolute.   plane: the two axes of the reference; a second row then shows
    this plane from the front.   name: name of the controlling model, for colour and legend.
    Raises ValueError if sizes differ, a value is not finite, or an instant is outside the path.
    """
    motion = _Motion(shapes, triangles, times, tip_path, tip_times, reference, rest, plane)
    count, label, gap = len(motion.times), 0.45, 0.12
    width = min((WIDTH - label) / count - gap, 1.8)
    heights = [_height(motion.everything @ camera.frame[:2].T, width, 2.9)]
    if plane is not None:
        heights.append(_height(motion.drawn[:, motion.plane], width, 2.0))
    size = label + count * (width + gap), sum(heights) + 0.9
    figure, grid = panels(*size, len(heights), count, height_ratios=heights, squeeze=False)
    for index, (column, time) in enumerate(zip(grid.T, motion.times)):
        for view in _views(column, motion, camera.frame, name, np.array(heights) / width, leftmost=index == 0):
            view.show(index)
        column[0].set_title(f"{time:.2f} s")
    return figure


def add_circles(stills: Figure, centers: np.ndarray, radii: np.ndarray) -> None:
    """Obstacles on the second row of `robot_stills`: centers (K, C, 2) m in its plane at the instants, radii (C,) m."""
    for axes, at in zip(stills.axes[len(centers):], centers):
        for center, radius in zip(at, radii):
            axes.add_patch(Circle(MM * center, MM * radius, facecolor=REST, edgecolor="#888888", linewidth=0.6,
                                  zorder=1))


@styled
def robot_animation(path: str | Path, shapes: np.ndarray, triangles: np.ndarray, times: np.ndarray,
                    tip_path: np.ndarray, reference: np.ndarray | None = None, *, tip_times: np.ndarray,
                    rest: np.ndarray | None = None, camera: Camera = STANDING, plane: Sequence[int] | None = None,
                    name: str = "SSMR", rate: float = 25.0, dpi: float = 100.0) -> Path:
    """Write the robot's motion as an animated .gif, one frame per shape; arguments are those of `robot_stills`.

    rate: frames per second; instants 1/rate s apart play in real time.   The file appears only when it is complete.
    Raises the errors of `robot_stills`, and ValueError for another kind of file or a rate that a GIF cannot have.
    """
    path = Path(path)
    if path.suffix != ".gif":
        raise ValueError(f"cannot write an animation as {path.name!r}; expected a name ending in .gif")
    if not 1.0 <= rate <= 50.0:
        raise ValueError(f"{rate} frames per second; a GIF can show 1 to 50: use fewer shapes and a lower rate")
    motion = _Motion(shapes, triangles, times, tip_path, tip_times, reference, rest, plane)
    stage = motion.everything @ camera.frame[:2].T
    height = _height(stage, 2.8, 3.6)
    widths = [np.clip(height / _height(stage, 1.0, 2.6), 1.4, 2.8)]
    if plane is not None:
        widths.append(height / _height(motion.drawn[:, motion.plane], 1.0, 1.6))
    size = sum(widths) + 0.4 * len(widths), height + 0.8
    figure, grid = panels(*size, 1, len(widths), width_ratios=widths, squeeze=False)
    views = _views(grid[0], motion, camera.frame, name, height / np.array(widths), leftmost=True)
    title = grid[0, 0].set_title(f"{motion.times[-1]:.2f} s")
    # the layout is computed only once, because otherwise the panels move from frame to frame. It is computed twice
    # here, because the first pass measures the panels at wrong positions
    figure.draw_without_rendering()
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    writer = PillowWriter(fps=rate)
    with written_aside(path) as aside, _named_gif(aside) as gif:
        writer.setup(figure, gif, dpi)
        for index, time in enumerate(motion.times):
            for view in views:
                view.show(index)
            title.set_text(f"{time:.2f} s")
            writer.grab_frame()
        writer.finish()
    return path


@contextmanager
def _named_gif(aside: Path) -> Iterator[Path]:
    """A file that is named as the writer of animations asks for, and has another name at the end."""
    gif = aside.with_suffix(".part.gif")
    try:
        yield gif
        os.replace(gif, aside)
    finally:
        gif.unlink(missing_ok=True)


class _Motion:
    """The checked arguments; positions in mm, times in s."""

    def __init__(self, shapes, triangles, times, tip_path, tip_times, reference, rest, plane):
        self.shapes, self.tip_path = _positions("shapes", shapes, 3), _positions("tip_path", tip_path, 2)
        self.reference = np.empty((0, 3)) if reference is None else _positions("reference", reference, 2)
        self.rest = None if rest is None else _positions("rest", rest, 2)
        self.times = _ascending("times", times, len(self.shapes), "shapes")
        self.tip_times = _ascending("tip_times", tip_times, len(self.tip_path), "rows of tip_path")
        self.triangles, nodes = np.asarray(triangles), self.shapes.shape[1]
        self.plane = None if plane is None else tuple(plane)
        if self.triangles.dtype.kind not in "iu" or self.triangles.shape[1:] != (3,) or not len(self.triangles):
            raise ValueError(f"triangles are {self.triangles.dtype} of shape {self.triangles.shape}; "
                             "expected (F, 3) whole numbers, the nodes of each")
        if self.triangles.min() < 0 or self.triangles.max() >= nodes:
            raise ValueError(f"triangles use the nodes {self.triangles.min()} to {self.triangles.max()}, but the "
                             f"shapes have the nodes 0 to {nodes - 1}; give both from one mesh")
        if self.rest is not None and len(self.rest) != nodes:
            raise ValueError(f"rest has {len(self.rest)} nodes, but the shapes have {nodes}; give both from one mesh")
        if self.times[0] < self.tip_times[0] or self.times[-1] > self.tip_times[-1]:
            raise ValueError(f"the instants are {self.times[0]:g} to {self.times[-1]:g} s, but tip_path covers only "
                             f"{self.tip_times[0]:g} to {self.tip_times[-1]:g} s; give the path of the same run")
        if plane is not None and (len(self.plane) != 2 or len({*self.plane} & {0, 1, 2}) != 2):
            raise ValueError(f"plane is {plane}; expected two of the axes 0, 1, 2, for example (0, 1) for x and y")

    @property
    def drawn(self) -> np.ndarray:
        """(T + T', 3) mm: the tip's path and the reference."""
        return np.concatenate([self.tip_path, self.reference])

    @property
    def everything(self) -> np.ndarray:
        """(·, 3) mm: `drawn`, and the surface at all instants and at rest."""
        shapes = self.shapes if self.rest is None else np.concatenate([self.shapes, self.rest[None]])
        return np.concatenate([shapes[:, np.unique(self.triangles)].reshape(-1, 3), self.drawn])

    def path_until(self, time: float) -> np.ndarray:
        """(·, 3) mm: the tip's path, its last point interpolated at that time."""
        tip = [np.interp(time, self.tip_times, coordinate) for coordinate in self.tip_path.T]
        return np.concatenate([self.tip_path[self.tip_times < time], [tip]])


class _View:
    """The artists of one panel: the path so far with its tip, the reference, and the surface if it is drawn."""

    def __init__(self, axes: Axes, motion: _Motion, frame: np.ndarray, name: str, surface: bool):
        self.motion, self.frame = motion, frame
        self.surface = PolyCollection([], linewidths=0.25, zorder=2, rasterized=True) if surface else None
        if surface:
            axes.add_collection(self.surface, autolim=False)
        if surface and motion.rest is not None:
            silhouette = (motion.rest @ frame[:2].T)[motion.triangles]
            pale = PolyCollection(silhouette, color=REST, linewidths=0.25, zorder=1.5, rasterized=True)
            axes.add_collection(pale, autolim=False)
        colour, (black, dashes) = colours([name])[name], METHODS["reference"]
        self.path, = axes.plot([], [], color=colour, linewidth=1.6, zorder=3, label=name)
        if len(motion.reference):
            axes.plot(*frame[:2] @ motion.reference.T, dashes, color=black, linewidth=0.8, zorder=4, label="reference")
        self.tip, = axes.plot([], [], "o", color=colour, mec="white", markersize=4.5, mew=0.7, zorder=5)

    def show(self, index: int) -> None:
        path = self.frame[:2] @ self.motion.path_until(self.motion.times[index]).T
        self.path.set_data(*path)
        self.tip.set_data(*path[:, -1:])
        if self.surface is not None:
            faces = (self.motion.shapes[index] @ self.frame.T)[self.motion.triangles]
            # the faces are drawn from far to near, so that near faces cover far ones
            faces = faces[np.argsort(faces[..., 2].mean(axis=1), kind="stable")]
            self.surface.set(verts=faces[..., :2], color=_shade(faces))


def _views(panel_axes: Sequence[Axes], motion: _Motion, frame: np.ndarray, name: str, ratios: np.ndarray,
           leftmost: bool) -> list[_View]:
    """Views of the robot in the first axes, and of the plane in the second, if there are two. ratios: height / width.
    """
    stage, *flat = panel_axes
    _limit(stage, motion.everything @ frame[:2].T, ratios[0])
    stage.set_axis_off()
    if flat:
        _draw_sheet(stage, motion, frame)
    views = [_View(stage, motion, frame, name, surface=True)]
    if leftmost:
        _draw_scale_bar(stage)
        _draw_compass(stage, frame)
        stage.figure.legend(*stage.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    for axes in flat:
        _limit(axes, motion.drawn[:, motion.plane], ratios[1])
        views.append(_View(axes, motion, np.eye(3)[list(motion.plane)], name, surface=False))
        across, upwards = (AXES[axis] for axis in motion.plane)
        axes.set(xlabel=f"{across} (mm)", ylabel=f"{upwards} (mm)" if leftmost else "")
        axes.tick_params(labelleft=leftmost)
        axes.locator_params(nbins=4, steps=[1, 2, 5, 10])
    return views


def _shade(faces: np.ndarray) -> np.ndarray:
    """Colours (F, 3) of faces (F, 3, 3) in the viewer's frame: matt, and darker if they face away from light or viewer.
    """
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    # the node order of a triangle does not say which side is outside, but the visible side always is
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0)
    brightness = (0.5 + 0.5 * normals @ LIGHT / np.linalg.norm(LIGHT)) * (0.65 + 0.35 * normals[:, 2])
    return SHADOW + brightness[:, None] * (LIT - SHADOW)


def _draw_sheet(axes: Axes, motion: _Motion, frame: np.ndarray) -> None:
    """Draw the plane as a sheet on which the tip writes, behind or in front of the robot as the viewer sees it."""
    drawn = motion.reference if len(motion.reference) else motion.tip_path
    normal = 3 - sum(motion.plane)
    margin = 0.2 * np.ptp(drawn[:, motion.plane], axis=0).max()
    low, high = drawn.min(axis=0) - margin, drawn.max(axis=0) + margin
    corners = np.full((4, 3), drawn[:, normal].mean())
    for axis, ends in zip(motion.plane, ([0, 1, 1, 0], [0, 0, 1, 1])):
        corners[:, axis] = np.array([low, high])[ends, axis]
    behind = (motion.shapes[..., normal].mean() - corners[0, normal]) * frame[2, normal] > 0.0
    axes.add_patch(Polygon(corners @ frame[:2].T, facecolor=SHEET, alpha=None if behind else 0.7,
                           zorder=1 if behind else 2.5))


def _draw_scale_bar(axes: Axes) -> None:
    left, right = axes.get_xlim()
    lengths = [step * 10.0 ** power for power in range(-3, 5) for step in (1, 2, 5)]
    length = max([size for size in lengths if size <= 0.4 * (right - left)], default=lengths[0])
    below = axes.get_xaxis_transform()
    axes.plot([left, left + length], [-0.03, -0.03], color="black", linewidth=1.6, clip_on=False, transform=below)
    axes.annotate(f"{length:g} mm", (left + length, -0.03), (3, 0), below, "offset points", va="center", fontsize=7)


def _draw_compass(axes: Axes, frame: np.ndarray) -> None:
    """Draw the three axes as the viewer sees them; an axis that points at the viewer is left out."""
    corner = {"xy": (0.01, 0.95), "xycoords": "axes fraction", "textcoords": "offset points"}
    arrowhead = {"arrowstyle": "<-", "linewidth": 0.7, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}
    for letter, arrow in zip(AXES, 13.0 * frame[:2].T):
        if (length := np.linalg.norm(arrow)) > 4.0:
            axes.annotate("", xytext=arrow, arrowprops=arrowhead, **corner)
            axes.annotate(letter, xytext=(1.0 + 5.0 / length) * arrow, ha="center", va="center", fontsize=7, **corner)


def _height(points: np.ndarray, width: float, most: float) -> float:
    """Height in inches of a panel of this width that shows the points (·, 2) with equal scales, at most `most`."""
    span = np.ptp(points, axis=0)
    return float(np.clip(width * span[1] / max(span[0], 1e-9), 0.6 * width, most))


def _limit(axes: Axes, points: np.ndarray, ratio: float) -> None:
    """Set limits of equal scale around the points (·, 2), with this ratio of height to width."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = 1.06 * max(*(high - low) / (1.0, ratio), 1e-3) * np.array([1.0, ratio])
    xlim, ylim = np.stack([low + high - span, low + high + span], axis=1) / 2
    axes.set(xlim=xlim, ylim=ylim, aspect="equal")


def _positions(what: str, given, dimensions: int) -> np.ndarray:
    """Positions in mm from positions in m. Raises ValueError for another shape or a value that is not finite."""
    positions = np.asarray(given, dtype=np.float64)
    if positions.ndim != dimensions or positions.shape[-1] != 3 or positions.size == 0:
        raise ValueError(f"{what} has shape {positions.shape}; expected {('(·, 3)', '(K, N, 3)')[dimensions - 2]} m")
    if not np.isfinite(positions).all():
        raise ValueError(f"{np.sum(~np.isfinite(positions))} of {positions.size} values of {what} are not finite; "
                         "cut the run where it diverged")
    return MM * positions


def _ascending(what: str, given, count: int, of: str) -> np.ndarray:
    times = np.asarray(given, dtype=np.float64)
    if times.shape != (count,):
        raise ValueError(f"{what} has shape {times.shape} for {count} {of}; expected ({count},), one for each")
    if not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
        raise ValueError(f"{what} from {times[0]:g} to {times[-1]:g} s are not ascending; "
                         "expected finite times, each later than the one before")
    return times
