"""The site: built without a warning, every link inside it leads somewhere, and nothing in it needs a network."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest

ROOT = Path(__file__).resolve().parents[2]
FETCHED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src"}
FORMULA = re.compile(r"\$\$|\\\(|\\frac|\\dot")

pytestmark = [pytest.mark.slow, pytest.mark.skipif(
    not (ROOT / "ssmr_torch" / "paper").is_dir(), reason="the site has pages of paper/, which was deleted")]


class Page(HTMLParser):
    """The anchors of a page, its links, and what a browser would fetch for it."""

    def __init__(self, path):
        super().__init__()
        self.anchors, self.links, self.fetched = set(), [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.anchors |= {found[key] for key in ("id", "name") if found.get(key)}
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        canonical = tag == "link" and found.get("rel") in ("canonical", "prev", "next")
        if FETCHED.get(tag) in found and not canonical:
            self.fetched.append(found[FETCHED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for needed in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        pytest.importorskip(needed, reason="needs pip install 'ssmr_torch[docs]'")
    at = tmp_path_factory.mktemp("site")
    done = subprocess.run([sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(at)], cwd=ROOT,
                          capture_output=True, text=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"})
    assert done.returncode == 0 and "WARNING" not in done.stderr, done.stdout + done.stderr
    return {path: Page(path) for path in at.rglob("*.html")}


def test_every_page_of_the_documentation_is_in_the_site(site):
    names = {path.stem for path in site}
    assert {path.stem for path in (ROOT / "docs").rglob("*.md")} | {"readme", "changes", "contributing"} <= names


def test_every_link_inside_the_site_leads_to_a_page_and_an_anchor_that_exist(site):
    dead = []
    for path, page in site.items():
        for link in page.links:
            target, anchor = urldefrag(link)
            if re.match(r"[a-z]+:", link) or path.name == "404.html":
                continue
            there = (path.parent / unquote(target)).resolve() if target else path
            if not there.exists() or (anchor and there in site and unquote(anchor) not in site[there].anchors):
                dead.append(f"{path.name}: {link}")
    assert not dead


def test_the_site_fetches_nothing_from_elsewhere(site):
    outside = {source for page in site.values() for source in page.fetched if re.match(r"([a-z]+:)?//", source)}
    assert not outside


def test_formulas_are_drawn_without_a_script(site):
    for path in site:
        text = path.read_text(encoding="utf-8")
        prose = re.sub(r"<(code|pre|script|annotation)\b.*?</\1>", "", text, flags=re.DOTALL)
        assert not FORMULA.search(prose), path.name
    assert any("<math" in path.read_text(encoding="utf-8") for path in site)


def test_the_snippets_on_the_pages_are_there(site):
    for path in site:
        assert "--8<--" not in path.read_text(encoding="utf-8"), path.name
