"""What mkdocs needs beyond its plugins: pages from above docs/, formulas without a script, lines of docstrings.

README.md, CONTRIBUTING.md and CHANGELOG.md lie above docs/. They become the pages readme.md, contributing.md and
changes.md, and links to them are rewritten. Formulas in $…$ become MathML, which browsers draw themselves: the site
needs no network. Where a line of a docstring says what an argument is, it begins a line on the page as well.
"""

import re
from html import unescape
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
PAGES = {"readme.md": "README.md", "contributing.md": "CONTRIBUTING.md", "changes.md": "CHANGELOG.md"}
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)

PARAGRAPH = re.compile(r"<p>.*?</p>", re.DOTALL)
ARGUMENT = re.compile(r"\n(?=(?:\w[\w, ]{0,40}(?: \([^)\n]*\))?: |Raises ))")


def on_files(files, config):
    """Add the pages that are made of files above docs/."""
    for page, source in PAGES.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text.replace("](docs/", "](")))
    return files


def on_page_markdown(markdown, page, config, files):
    """Point links to the files above docs/ at the pages made of them."""
    up = "../" * page.file.src_uri.count("/")
    for name, source in PAGES.items():
        markdown = re.sub(rf"\]\((\.\./)*{source}", f"]({up}{name}", markdown)
    return markdown


def on_page_content(html, page, config, files):
    """Formulas as MathML; on the pages of the API, arguments on lines of their own."""
    shown = {"div": "block", "span": "inline"}
    html = FORMULA.sub(lambda found: convert(unescape(found[2]), display=shown[found[1]]), html)
    if page.file.src_uri.startswith("api/"):
        html = PARAGRAPH.sub(lambda found: ARGUMENT.sub("<br>\n", found[0]), html)
    return html
