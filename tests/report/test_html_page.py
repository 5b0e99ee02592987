"""The report is one complete, escaped HTML page."""

from html.parser import HTMLParser

import numpy as np
import pytest

import ssmr_torch
from ssmr_torch.evaluation import figures
from ssmr_torch.report.html_page import Picture, Section, Table, write_report

VOID = {"meta", "link", "br", "img", "hr", "input"}
SVG_HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'


class Page(HTMLParser):
    """Elements, identifiers and links of a page; fails on a tag that is closed in the wrong order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.texts = [], [], []
        self.feed(text)
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data.strip()))

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    def text_in(self, tag):
        return [text for name, text in self.texts if name == tag and text]


def drawing():
    return figures.error_over_horizon(np.array([0.05, 1.0]), {"SSMR": np.array([1e-4, 1e-3])})


def sections():
    rows = [["SSMR", 0.492], ["DMD", float("inf")], ["TPWL", None]]
    table = Table(["model", "1 s (mm)"], rows, "Mean RMSE.")
    picture = Picture(drawing(), "RMSE against the horizon.", "500 starts", "mm")
    return [Section("Prediction", ["First.", table, picture]), Section("Control", [picture, "Last."])]


@pytest.fixture
def page(tmp_path):
    path = write_report(tmp_path, "A report", sections(), {"configuration": "a1b2c3"})
    return Page(path.read_text("utf-8"))


def test_the_page_is_well_formed_and_holds_all_parts_in_order(page):
    assert page.text_in("h1") == ["A report"]
    assert page.text_in("h2") == ["Prediction", "Control"]
    assert page.text_in("p") == ["First.", "Last."]
    assert len(page.all("svg")) == 2 and len(page.all("table")) == 1
    assert page.text_in("b") == ["Table 1.", "Figure 1.", "Figure 2."]


def test_the_page_loads_nothing_and_runs_nothing(page):
    assert not {"script", "link", "iframe", "img"} & {name for name, _ in page.elements}
    for _, attributes in page.elements:
        assert not any(name.startswith("on") or name == "src" for name in attributes)
        for name in ("href", "xlink:href"):
            assert attributes.get(name, "#").startswith(("#", "data:image/"))


def test_the_same_figure_twice_gives_no_identifier_twice_and_every_link_has_its_target(page):
    identifiers = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(identifiers) == len(set(identifiers)) > 0
    links = [a["xlink:href"][1:] for a in page.all("use")]
    links += [a["clip-path"][5:-1] for _, a in page.elements if "clip-path" in a]
    assert links and set(links) <= set(identifiers)


def test_numbers_stand_right_and_text_left(page):
    cells = [(attributes.get("class"), text) for attributes, text in zip(page.all("td"), page.text_in("td"))]
    assert cells == [(None, "SSMR"), ("number", "0.492"), (None, "DMD"), ("number", "∞"), (None, "TPWL"),
                     ("number", "–")]
    assert [attributes.get("class") for attributes in page.all("th")] == [None, "number"]


def test_captions_say_how_many_and_in_which_unit(page):
    captions = page.text_in("figcaption")
    assert captions[1] == captions[2] == "RMSE against the horizon. (n = 500 starts; unit: mm)"


def test_the_footer_says_where_the_numbers_come_from(page):
    footer = dict(zip(page.text_in("dt"), page.text_in("dd")))
    assert footer["configuration"] == "a1b2c3" and footer["ssmr_torch"] == ssmr_torch.__version__
    assert footer["written"].endswith("UTC")


def test_text_is_shown_as_it_is_and_never_read_as_markup(tmp_path):
    attack = "<script>alert('1')</script> & more"
    parts = [attack, Table([attack], [[attack]], attack), Picture(drawing(), attack, attack, attack)]
    page = Page(write_report(tmp_path, attack, [Section(attack, parts)], {attack: attack}).read_text("utf-8"))
    assert not page.all("script")
    assert {attack} == {*page.text_in("h1"), *page.text_in("h2"), *page.text_in("p"), *page.text_in("td")}


def test_a_saved_svg_file_is_shown_like_the_figure_itself(tmp_path):
    path = figures.save(drawing(), tmp_path / "figure.svg")
    assert Picture(path, "c", "1", "mm").drawing("a") == Picture(drawing(), "c", "1", "mm").drawing("a")


@pytest.mark.parametrize("body", ["<script>1</script>", '<g onload="f()"/>', "<foreignObject/>",
                                  '<use xlink:href="http://example.org/x.svg"/>', "<g>"])
def test_an_svg_file_that_is_more_than_a_drawing_is_refused_and_no_report_is_left(body, tmp_path):
    (tmp_path / "bad.svg").write_text(f"{SVG_HEAD}{body}</svg>")
    with pytest.raises(ValueError, match="figures.save"):
        write_report(tmp_path / "out", "t", [Section("s", [Picture(tmp_path / "bad.svg", "c", "1", "mm")])])
    assert not (tmp_path / "out").exists()


def test_a_new_report_replaces_the_old_one_and_leaves_nothing_beside_it(tmp_path):
    write_report(tmp_path, "old", sections())
    path = write_report(tmp_path, "new", sections())
    assert list(tmp_path.iterdir()) == [path] and "<h1>new</h1>" in path.read_text("utf-8")


def test_bad_input_is_refused(tmp_path):
    with pytest.raises(ValueError, match="3 cells"):
        Table(["a", "b"], [[1, 2], [1, 2, 3]], "caption")
    with pytest.raises(ValueError, match="unit"):
        Picture(drawing(), "caption", "500 starts", "")
    with pytest.raises(ValueError, match="expected a paragraph"):
        Section("heading", [1.0])
    with pytest.raises(ValueError, match="one Section"):
        write_report(tmp_path, "title", [])
    with pytest.raises(ValueError, match="title"):
        write_report(tmp_path, " ", sections())
