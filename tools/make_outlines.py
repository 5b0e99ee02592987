"""DejaVu Sans → the outlines that tasks draw where no font is installed: python tools/make_outlines.py

One line per character of Latin-1: the character, its advance width, and its contours as an SVG path of M, L and Q (font
units, y up). Needs fontTools and matplotlib, which brings the font and its licence.
"""

from importlib.util import find_spec
from pathlib import Path

from fontTools.pens.basePen import BasePen
from fontTools.ttLib import TTFont

FONTS = Path(find_spec("matplotlib").submodule_search_locations[0], "mpl-data", "fonts", "ttf")
OUTLINES = Path(__file__).resolve().parents[1] / "ssmr_torch" / "tasks" / "dejavu_sans.txt"
CHARACTERS = [chr(code) for code in (*range(0x20, 0x7F), *range(0xA1, 0x100)) if code != 0xAD]


class PathPen(BasePen):
    """The path, with the points that a TrueType font only implies."""

    def __init__(self, glyphs):
        super().__init__(glyphs)
        self.path = []

    def _moveTo(self, point):
        self._add("M", point)

    def _lineTo(self, point):
        self._add("L", point)

    def _qCurveToOne(self, control, end):
        self._add("Q", control, end)

    def _add(self, letter, *points):
        self.path.append(" ".join([letter, *(f"{value:g}" for point in points for value in point)]))


def main():
    licence = (FONTS / "LICENSE_DEJAVU").read_text(encoding="utf-8").rstrip().splitlines()
    lines = [f"# {line}".rstrip() for line in ["Outlines of DejaVu Sans, with its licence:", "", *licence]]
    with TTFont(FONTS / "DejaVuSans.ttf") as source:
        names, glyphs = source.getBestCmap(), source.getGlyphSet()
        for character in CHARACTERS:
            glyph, pen = glyphs[names[ord(character)]], PathPen(glyphs)
            glyph.draw(pen)
            lines.append("\t".join([character, str(glyph.width), " ".join(pen.path)]))
    OUTLINES.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
