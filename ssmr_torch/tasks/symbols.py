"""Tasks that draw letters and symbols: the tip follows an outline at constant speed, from rest and back to rest."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.extras import require
from ssmr_torch.quantities import PATH, TEXT, TRACKED
from ssmr_torch.ranges import Number, OrNone, Text
from ssmr_torch.tasks.curves import Polyline
from ssmr_torch.tasks.references import Task, ramped_phase


@checked(text=Text("a text to draw (quote a number)", 100), half_size=Number(1e-6, 100.0, "m"),
         duration=Number(1e-2, 1e5, "s"), font=OrNone(PATH), ramp=Number(0.0, 1e4, "s"), tracked=TRACKED,
         name=OrNone(TEXT))
def symbol(text: str = "S", half_size: float = 0.020, duration: float = 10.0, ramp: float = 1.0,
           tracked: Sequence[int | str] = ("tip_x", "tip_y"), font: str | None = None,
           name: str | None = None, obstacles: Sequence | None = None) -> Task:
    """The outlines of a text, one after the other, all at the speed of `constant_speed`.

    The tip draws all the time: it closes each curve of `contours` and goes straight to the next at the same speed.
    One factor scales the text, so that the longer side of the box around it is 2 half_size; its centre is at rest.
    half_size in m; duration in s, with the ways from rest and back; ramp in s; font: a .ttf or .otf file (needs the
    extra `plots`), by default the outlines of DejaVu Sans in the package (Latin-1); name: by default the text.
    Raises ValueError for a size that is not positive, and where `contours` and `constant_speed` do.
    """
    if not (np.isfinite(half_size) and half_size > 0):
        raise ValueError(f"half_size is {half_size} m; expected a positive length in m, half of the text's longer side")
    corners = np.concatenate(contours(text, font))
    low, high = corners.min(axis=0), corners.max(axis=0)
    corners = (corners - (low + high) / 2) * (2 * half_size / (high - low).max())
    return constant_speed(corners, duration, ramp, tracked, text if name is None else name, obstacles)


def constant_speed(corners: np.ndarray, duration: float, ramp: float, tracked: Sequence[int | str],
                   name: str, obstacles=()) -> Task:
    """A path from rest straight through corners (n, 2) m and back to rest, at the speed length / (duration − ramp).

    The arc length is the phase of `ramped_phase`. Position, speed and acceleration along the path are continuous; the
    direction jumps at a corner. Speeding up takes speed · ramp / 2 of the length, and slowing down the same, so that
    corners nearer to rest are passed more slowly.   duration: s, of the whole path.   ramp: s.
    Raises ValueError unless two outputs are tracked and both ramps fit into the duration.
    """
    if len(tracked) != 2:
        raise ValueError(f"task {name!r} tracks {len(tracked)} outputs, {tuple(tracked)}; a drawing needs exactly two, "
                         "such as (tip_x, tip_y)")
    if not (np.isfinite(duration) and 0 <= 2 * ramp <= duration and duration > 0):
        raise ValueError(f"task {name!r} lasts {duration} s with ramps of {ramp} s; expected a positive duration "
                         "and a ramp between zero and half of it: shorten the ramp or lengthen the duration")
    corners = np.concatenate([np.zeros((1, 2)), corners, np.zeros((1, 2))])
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    corners = corners[np.append(True, steps > 0)]
    travelled = np.append(0.0, np.cumsum(steps[steps > 0]))
    phase, _ = ramped_phase(travelled[-1], travelled[-1] / (duration - ramp), ramp)
    return Task(name, duration, tuple(tracked), Polyline(travelled, np.asfortranarray(corners), phase), obstacles)


def contours(text: str, font: str | None = None, steps: int = 64) -> list[np.ndarray]:
    """The closed curves (n, 2) around the text's glyphs and their holes, in font units, y up; last point = first point.

    The glyphs stand side by side at their advance widths, without kerning. Each Bézier curve of the font becomes
    `steps` straight pieces, which shortens it by a share of order 1 / steps².
    Raises FileNotFoundError for a missing font file, ModuleNotFoundError where fontTools is needed and missing, and
    ValueError for a file that is not a font, a missing character, no steps, and a text with nothing to draw.
    """
    if not isinstance(text, str) or steps < 1:
        raise ValueError(f"the text is {text!r} and steps is {steps}; expected a string (quote a number) "
                         "and 1 step or more")
    glyphs = dict(_package_glyphs(text, steps) if font is None else _font_glyphs(text, Path(font), steps))
    missing = sorted(set(text) - set(glyphs))
    if missing:
        whose = "the package's DejaVu Sans" if font is None else Path(font).name
        raise ValueError(f"{whose} has no glyph for {', '.join(map(repr, missing))} of the text {text!r}; leave them "
                         "out, or give a font (.ttf or .otf file) that has them")
    curves, advance = [], 0.0
    for character in text:
        drawn, width = glyphs[character]
        curves += [curve + (advance, 0.0) for curve in drawn]
        advance += width
    if not curves:
        raise ValueError(f"the text {text!r} has nothing to draw; give at least one letter")
    return curves


Glyph = tuple[str, tuple[list[np.ndarray], float]]  # a character, its closed contours and its advance width


def _package_glyphs(text: str, steps: int) -> Iterator[Glyph]:
    """The characters of the text for which the package has outlines (tools/make_outlines.py)."""
    fractions = np.arange(1, steps + 1)[:, None] / steps
    for line in files("ssmr_torch.tasks").joinpath("dejavu_sans.txt").read_text(encoding="utf-8").splitlines():
        if line[1:2] != "\t" or line[0] not in text:
            continue
        character, width, path = line.split("\t")
        drawn = []
        for command, numbers in re.findall("([MLQ])([^MLQ]*)", path):
            points = np.array(numbers.split(), dtype=np.float64).reshape(-1, 2)
            if command == "M":
                drawn.append([])
            drawn[-1].extend(_bezier(fractions, drawn[-1][-1], *points) if command == "Q" else points)
        yield character, (_closed(drawn), float(width))


def _font_glyphs(text: str, file: Path, steps: int) -> Iterator[Glyph]:
    """The characters of the text that the font has."""
    if not file.is_file():
        raise FileNotFoundError(f"there is no font file {file}; give a .ttf or .otf file, or leave font out to use "
                                "the package's DejaVu Sans")
    require("fontTools")
    # Imported only here, so that a controller and other tasks do not load fontTools.
    from fontTools.ttLib import TTFont, TTLibError

    try:
        source = TTFont(file)
    except TTLibError as problem:
        raise ValueError(f"{file} is not a font ({problem}); expected a .ttf or .otf file with one face") from problem
    with source:
        names, glyphs = source.getBestCmap() or {}, source.getGlyphSet()
        for character in set(text) & set(map(chr, names)):
            glyph = glyphs[names[ord(character)]]
            yield character, (_flattened(glyph, glyphs, steps), glyph.width)


def _flattened(glyph, glyphs, steps: int) -> list[np.ndarray]:
    """The closed contours of one glyph, each curve in `steps` straight pieces."""
    from fontTools.pens.basePen import BasePen

    fractions = np.arange(1, steps + 1)[:, None] / steps
    drawn = []

    class Pen(BasePen):
        """Splits the font's splines into quadratic and cubic Bézier curves and follows components."""

        def _moveTo(self, point):
            drawn.append([point])

        def _lineTo(self, point):
            drawn[-1].append(point)

        def _qCurveToOne(self, control, end):
            drawn[-1].extend(_bezier(fractions, self._getCurrentPoint(), control, end))

        def _curveToOne(self, first, second, end):
            drawn[-1].extend(_bezier(fractions, self._getCurrentPoint(), first, second, end))

    glyph.draw(Pen(glyphs))
    return _closed(drawn)


def _closed(drawn: Sequence) -> list[np.ndarray]:
    """Each contour with its first point repeated at the end. A contour of a single point is dropped."""
    closed = [np.array([*contour, contour[0]], dtype=np.float64) for contour in drawn]
    return [contour for contour in closed if np.ptp(contour, axis=0).any()]


def _bezier(t: np.ndarray, *controls: Sequence[float]) -> np.ndarray:
    """The Bézier curve with these control points at t (n, 1), (n, 2), by De Casteljau's algorithm."""
    points = [np.asarray(point, dtype=np.float64) for point in controls]
    while len(points) > 1:
        points = [(1 - t) * start + t * end for start, end in zip(points, points[1:])]
    return points[0]
