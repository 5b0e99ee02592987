"""Claims about letters and symbols."""

import subprocess
import sys

import numpy as np
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.t2CharStringPen import T2CharStringPen

from ssmr_torch.tasks.symbols import contours, symbol

EXAMPLES = {"S": symbol(), "I": symbol("I"), "ASL": symbol("ASL", ramp=0.7), "ETH": symbol("ETH", ramp=0.7),
            "two words": symbol("a b", half_size=0.01, duration=20.0)}


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def speed(task, time, h=1e-6):
    return np.linalg.norm(task.reference(time + h) - task.reference(time - h), axis=1) / (2 * h)


@pytest.fixture
def circle_font(tmp_path):
    """A font of cubic Bézier curves whose O is a circle of radius 1000 and whose I has nothing to draw."""
    builder = FontBuilder(2000, isTTF=False)
    builder.setupGlyphOrder([".notdef", "O", "I"])
    builder.setupCharacterMap({ord("O"): "O", ord("I"): "I"})
    empty, pen = T2CharStringPen(2000, None), T2CharStringPen(2000, None)
    pen.moveTo((1000, 0))
    for quarter in range(4):
        turn = np.linalg.matrix_power([[0, -1], [1, 0]], quarter)
        pen.curveTo(*(tuple(turn @ point) for point in ((1000, 552), (552, 1000), (0, 1000))))
    pen.closePath()
    drawn = {".notdef": empty.getCharString(), "O": pen.getCharString(), "I": empty.getCharString()}
    builder.setupCFF("Circle", {}, drawn, {})
    builder.setupHorizontalMetrics({name: (2000, 0) for name in drawn})
    builder.setupHorizontalHeader()
    builder.save(tmp_path / "circle.otf")
    return str(tmp_path / "circle.otf")


@pytest.mark.parametrize("task", EXAMPLES.values(), ids=EXAMPLES)
def test_the_drawing_starts_and_ends_at_rest_with_speed_zero(task):
    np.testing.assert_array_equal(task.reference([0.0, task.duration, task.duration + 1.0]), 0.0)
    for end, side in ((0.0, 1), (task.duration, -1)):
        assert np.abs(task.reference(end + side * 1e-3)).max() < 1e-9


@pytest.mark.parametrize("task", EXAMPLES.values(), ids=EXAMPLES)
def test_between_the_ramps_the_speed_is_constant(task):
    time = np.linspace(1.0 + 1e-3, task.duration - 1.0 - 1e-3, 2003)
    speeds = speed(task, time)
    # A difference that happens to span a corner measures the chord, which is shorter: rare, as it is 2e-6 s wide.
    assert np.mean(np.abs(speeds / np.median(speeds) - 1) < 1e-2) > 0.998
    total = length(task.reference(np.linspace(0, task.duration, 200001)))
    ramp = 0.7 if task.name in ("ASL", "ETH") else 1.0
    assert np.median(speeds) == pytest.approx(total / (task.duration - ramp), rel=1e-3)


def test_the_speed_along_the_drawing_changes_without_jumps():
    """On a grid twice as fine the largest change of the acceleration along the path halves; a jump would stay."""
    changes = []
    for samples in (2001, 4001):
        time = np.linspace(-0.1, 1.2, samples)  # s, on the straight from rest to the S: the distance is the arc length
        distance = np.linalg.norm(EXAMPLES["S"].reference(time), axis=1)
        changes.append(np.abs(np.diff(distance, 3)).max() * (samples - 1.0) ** 2)
    assert changes[1] < 0.6 * changes[0]


@pytest.mark.parametrize(("word", "half_size"), [("S", 0.02), ("I", 0.02), ("ASL", 0.02), ("ETH", 0.02),
                                                 ("two words", 0.01)])
def test_a_text_fills_its_box_in_one_direction_and_is_centred(word, half_size):
    points = EXAMPLES[word].reference(np.linspace(0, EXAMPLES[word].duration, 100001))
    np.testing.assert_allclose(points.max(axis=0), -points.min(axis=0), rtol=0, atol=2e-3 * half_size)
    assert np.abs(points).max() <= half_size * (1 + 1e-12)
    assert np.abs(points).max() == pytest.approx(half_size, rel=1e-3)


@pytest.mark.parametrize("word", ["ASL", "ETH"])
def test_the_configured_ramps_leave_every_letter_at_full_speed(word):
    """The slow part is the straight between rest and the letters: on a ray from rest."""
    task = EXAMPLES[word]
    for time in (np.linspace(0, 0.7, 50)[1:], task.duration - np.linspace(0, 0.7, 50)[1:]):
        slow = task.reference(time)
        np.testing.assert_allclose(slow[:, 0] * slow[-1, 1], slow[:, 1] * slow[-1, 0], rtol=0, atol=1e-15)


@pytest.mark.parametrize(("text", "expected"), [("I", 1), ("S", 1), ("O", 2), ("A", 2), ("B", 3), ("i", 2), ("é", 3),
                                                ("ASL", 4), ("ETH", 3), ("A A", 4)])
def test_every_outline_and_every_hole_is_one_closed_contour(text, expected):
    found = contours(text)
    assert len(found) == expected
    for contour in found:
        np.testing.assert_array_equal(contour[0], contour[-1])


def test_the_outline_of_an_upright_bar_is_its_rectangle():
    (bar,) = contours("I")
    width, height = np.ptp(bar, axis=0)
    assert len(bar) == 5 and height > 5 * width
    assert length(bar) == pytest.approx(2 * (width + height), rel=1e-14)
    total = length(symbol("I").reference(np.linspace(0, 10.0, 200001)))
    ways = 2 * np.hypot(0.02, 0.02 * width / height)
    assert total == pytest.approx(0.08 * (1 + width / height) + ways, rel=1e-4)


@pytest.mark.parametrize("text", ["S", "O", "é"])
def test_the_length_of_an_outline_converges_with_the_square_of_the_steps(text):
    lengths = [sum(map(length, contours(text, steps=steps))) for steps in (8, 16, 32, 64)]
    changes = np.diff(lengths)
    assert (changes > 0).all()
    np.testing.assert_allclose(changes[:-1] / changes[1:], 4.0, rtol=0.05)
    assert changes[-1] < 1e-4 * lengths[-1]


def test_letters_stand_side_by_side_in_reading_order():
    (alone,), (first, *_, last) = contours("I"), contours("IAI")
    np.testing.assert_array_equal(first, alone)
    shift = last - first
    assert np.ptp(shift, axis=0).max() == 0 and shift[0, 0] > np.ptp(contours("A")[1], axis=0)[0] and shift[0, 1] == 0


def test_a_font_file_of_cubic_curves_is_drawn_as_well(circle_font):
    (circle,) = contours("O", circle_font)
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 1000, rtol=5e-4)
    assert length(circle) == pytest.approx(2000 * np.pi, rel=5e-4)
    with pytest.raises(ValueError, match="nothing to draw"):
        symbol("I", font=circle_font)


def test_the_name_is_the_text_unless_it_is_given():
    assert symbol("ASL").name == "ASL" and symbol("ASL", name="lab").name == "lab"


def test_a_text_that_cannot_be_drawn_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no glyph for '漢' of the text 'A漢'"):
        symbol("A漢")
    for text in ("", "  "):
        with pytest.raises(ValueError, match=r"text is '\s*'; expected a text to draw"):
            symbol(text)
    with pytest.raises(ValueError, match="quote a number"):
        symbol(8)
    with pytest.raises(ValueError, match="steps is 0"):
        contours("S", steps=0)
    with pytest.raises(FileNotFoundError, match="none.ttf; give a .ttf or .otf file"):
        symbol(font=str(tmp_path / "none.ttf"))
    (tmp_path / "text.ttf").write_text("no font")
    with pytest.raises(ValueError, match="is not a font"):
        symbol(font=str(tmp_path / "text.ttf"))


@pytest.mark.parametrize(("build", "message"), [
    (lambda: symbol(half_size=0.0), "half_size is 0.0 m"),
    (lambda: symbol(half_size=float("nan")), "half_size is nan m"),
    (lambda: symbol(duration=-1.0), r"duration is -1\.0 s; expected"),
    (lambda: symbol(ramp=-1.0), r"ramp is -1\.0 s; expected"),
    (lambda: symbol(duration=2.0, ramp=1.5), "shorten the ramp"),
    (lambda: symbol(tracked=("tip_x", "tip_y", "tip_z")), "tracks 3 outputs"),
])
def test_impossible_sizes_times_and_outputs_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_the_packages_outlines_are_those_of_dejavu_sans_to_the_last_digit():
    fonts = pytest.importorskip("matplotlib", reason="matplotlib brings the font").get_data_path()
    latin = "".join(chr(code) for code in (*range(0x20, 0x7F), *range(0xA1, 0x100)) if code != 0xAD)
    own, read = contours(latin, steps=3), contours(latin, f"{fonts}/fonts/ttf/DejaVuSans.ttf", steps=3)
    assert len(own) == len(read) > 250
    for outline, expected in zip(own, read):
        np.testing.assert_array_equal(outline, expected)


def test_neither_matplotlib_nor_fonttools_is_needed_where_no_font_is_given():
    code = ("import sys; sys.modules['fontTools'] = sys.modules['matplotlib'] = None; "
            "from ssmr_torch.tasks.symbols import symbol; symbol(); symbol('ETH'); symbol('é')")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_fonttools_a_font_is_refused_with_what_to_install(circle_font, monkeypatch):
    monkeypatch.setitem(sys.modules, "fontTools", None)
    with pytest.raises(ModuleNotFoundError, match=r"fontTools is not installed: pip install 'ssmr_torch\[plots\]'"):
        symbol("O", font=circle_font)
