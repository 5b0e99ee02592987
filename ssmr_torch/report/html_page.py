"""Report of a run as one HTML file, with all figures inside; for a screen, a phone or paper."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from numbers import Real
from pathlib import Path
from xml.etree import ElementTree

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ssmr_torch import __version__
from ssmr_torch.evaluation import figures
from ssmr_torch.result_files import save_text

TEMPLATE = "html_page.jinja"
FILE_NAME = "report.html"
SVG = "http://www.w3.org/2000/svg"
HREF = "{http://www.w3.org/1999/xlink}href"
DRAWN = {f"{{{SVG}}}{tag}" for tag in (
    "svg", "g", "defs", "style", "clipPath", "path", "rect", "circle", "ellipse", "line", "polyline",
    "polygon", "use", "text", "tspan", "image", "title", "desc", "linearGradient", "radialGradient",
    "stop", "marker")}
ElementTree.register_namespace("", SVG)
ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")


@dataclass(frozen=True)
class Table:
    """header: one label per column, units included; rows: text, numbers, or None for a value that does not exist.

    Numbers are shown with four significant digits and aligned right. Raises ValueError if a row has another length than
    the header.
    """

    header: Sequence[str]
    rows: Sequence[Sequence]
    caption: str

    def __post_init__(self):
        for index, row in enumerate(self.rows):
            if len(row) != len(self.header):
                raise ValueError(f"row {index} of the table {self.caption!r} has {len(row)} cells, but the header has "
                                 f"{len(self.header)}; give one cell per column")
        _require_text("a table's caption", self.caption)

    @property
    def numeric(self) -> list[bool]:
        """Whether a column holds numbers."""
        return [any(_is_number(row[column]) for row in self.rows) for column in range(len(self.header))]

    @property
    def cells(self) -> list[list[str]]:
        return [[_cell(value) for value in row] for row in self.rows]


@dataclass(frozen=True)
class Picture:
    """A figure with its caption. figure: a matplotlib Figure, or the path of an .svg file.

    count: amount of data behind the figure ("500 starts"); unit: unit of its values ("mm"). Both are added to the
    caption. Raises ValueError if a text is empty or the SVG contains scripts, FileNotFoundError if the file is missing.
    """

    figure: object
    caption: str
    count: str
    unit: str

    def __post_init__(self):
        for name in ("caption", "count", "unit"):
            _require_text(f"a figure's {name}", getattr(self, name))

    def drawing(self, prefix: str) -> Markup:
        """The SVG element. Its identifiers get the prefix, because identifiers in one page must be unique."""
        is_path = isinstance(self.figure, (str, Path))
        text = Path(self.figure).read_text(encoding="utf-8") if is_path else figures.svg(self.figure)
        try:
            root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise ValueError(f"the figure {self.caption!r} is not an SVG drawing ({error}); "
                             "give a matplotlib Figure, or an .svg file written by figures.save") from error
        for metadata in root.findall(f"{{{SVG}}}metadata"):
            root.remove(metadata)
        for element in root.iter():
            _check_drawn(element, self.caption)
            for name, value in element.items():
                value = value.replace("url(#", f"url(#{prefix}-")
                if name == "id" or (name in ("href", HREF) and value.startswith("#")):
                    value = f"{prefix}-{value}" if name == "id" else f"#{prefix}-{value[1:]}"
                element.set(name, value)
        return Markup(ElementTree.tostring(root, encoding="unicode"))


@dataclass(frozen=True)
class Section:
    """A heading and what follows it, in order: paragraphs (text), tables, pictures."""

    heading: str
    parts: Sequence[str | Table | Picture]

    def __post_init__(self):
        _require_text("a section's heading", self.heading)
        for part in self.parts:
            if not isinstance(part, (str, Table, Picture)):
                raise ValueError(f"section {self.heading!r} contains a {type(part).__name__}; "
                                 "expected a paragraph (text), a Table or a Picture")


def write_report(directory: str | Path, title: str, sections: Sequence[Section],
                 provenance: Mapping[str, str] | None = None) -> Path:
    """Write directory/report.html with all sections and then their provenance. Returns its path.

    provenance: the sources of the numbers (hash of the configuration, commit, data, seed); the package's version and
    the time are added. All text is escaped. The file appears only when it is complete.
    Raises ValueError without a title or sections.
    """
    _require_text("the report's title", title)
    if not sections or not all(isinstance(section, Section) for section in sections):
        raise ValueError(f"{len(sections)} sections of the types {[type(s).__name__ for s in sections]}; "
                         "expected one Section or more")
    environment = Environment(loader=PackageLoader("ssmr_torch", "report"), autoescape=True,
                              undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    footer = {**(provenance or {}), "ssmr_torch": __version__,
              "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")}
    page = environment.get_template(TEMPLATE).render(title=title, sections=_numbered(sections),
                                                     provenance=footer)
    return save_text(Path(directory) / FILE_NAME, page)


def _numbered(sections: Sequence[Section]) -> list[dict]:
    """The values for the template: every part with its kind. Tables and figures are numbered through the report."""
    tables = drawings = 0
    shown = []
    for section in sections:
        parts = []
        for part in section.parts:
            if isinstance(part, Table):
                tables += 1
                parts.append({"kind": "table", "number": tables, "part": part})
            elif isinstance(part, Picture):
                drawings += 1
                parts.append({"kind": "figure", "number": drawings, "part": part,
                              "svg": part.drawing(f"figure{drawings}")})
            else:
                parts.append({"kind": "paragraph", "part": part})
        shown.append({"heading": section.heading, "parts": parts})
    return shown


def _check_drawn(element: ElementTree.Element, caption: str) -> None:
    """Refuse elements that could run or load something when the report is opened."""
    links = [value for name, value in element.items() if name in ("href", HREF)]
    foreign = [value for value in links if not value.startswith(("#", "data:image/"))]
    handlers = [name for name in element.keys() if name.lower().startswith("on")]
    if element.tag not in DRAWN or foreign or handlers:
        raise ValueError(f"the figure {caption!r} contains {element.tag} {foreign + handlers}, which is not part of a "
                         "drawing; give a matplotlib Figure, or an .svg file written by figures.save")


def _is_number(value) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _cell(value) -> str:
    if value is None:
        return "–"
    if not _is_number(value):
        return str(value)
    if math.isfinite(value):
        return f"{value:.4g}" if not float(value).is_integer() else f"{int(value)}"
    return "not a number" if math.isnan(value) else ("∞" if value > 0 else "−∞")


def _require_text(what: str, text: str) -> None:
    if not isinstance(text, str) or not text.strip():
        raise ValueError(f"{what} is {text!r}; expected a text")
