"""Robots are drawn in mm as a viewer sees them, with the path of their tip so far."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from PIL import Image

from ssmr_torch.evaluation import figures, robot_figures
from ssmr_torch.evaluation.robot_figures import HANGING, STANDING, Camera, robot_animation, robot_stills
from ssmr_torch.report.html_page import Picture

LENGTH = 0.195
TIME = 0.02 * np.arange(301)
LETTER = 0.015 * np.stack([np.sin(2 * np.pi * TIME / 6.0), np.sin(4 * np.pi * TIME / 6.0)], axis=1)
TIP_PATH = np.column_stack([1.05 * LETTER, LENGTH - 5.0 * (LETTER ** 2).sum(axis=1)])
REFERENCE = np.column_stack([LETTER, np.full(len(TIME), LENGTH)])


def arm(rings=20, around=12):
    """A cone along +z, its radius 13 to 5 mm: nodes (N, 3) m, and the triangles (F, 3) of its side."""
    height, angle = np.linspace(0.0, LENGTH, rings), 2 * np.pi * np.arange(around) / around
    radius = np.linspace(0.013, 0.005, rings)[:, None]
    nodes = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.repeat(height[:, None], around, 1)], axis=-1)
    corner = np.arange((rings - 1) * around).reshape(rings - 1, around)
    beside = np.roll(corner, -1, axis=1)
    lower, upper = (corner, beside, beside + around), (corner, beside + around, corner + around)
    return nodes.reshape(-1, 3), np.concatenate([np.stack(half, axis=-1).reshape(-1, 3) for half in (lower, upper)])


def bent(nodes, indices):
    """The arm with its tip where TIP_PATH has it, sheared along a parabola."""
    moved = TIP_PATH[indices] - [0.0, 0.0, LENGTH]
    return nodes + (nodes[:, 2:] / LENGTH) ** 2 * moved[:, None]


def motion(count=4, **resolution):
    nodes, triangles = arm(**resolution)
    indices = np.linspace(30, 290, count).round().astype(int)
    return {"shapes": bent(nodes, indices), "triangles": triangles, "times": TIME[indices], "tip_path": TIP_PATH,
            "tip_times": TIME, "reference": REFERENCE, "rest": nodes, "camera": HANGING, "plane": (0, 1)}


def rows(figure):
    """The axes that show the robot, and those that show the plane."""
    return [axes for axes in figure.axes if not axes.axison], [axes for axes in figure.axes if axes.axison]


def line_of(axes, label):
    return next(line for line in axes.get_lines() if line.get_label() == label)


def surface_of(axes):
    return max((c for c in axes.collections if isinstance(c, PolyCollection)), key=lambda c: c.get_zorder())


@pytest.mark.parametrize(("changed", "message"), [
    ({"times": TIME[:3]}, r"\(3,\) for 4 shapes"),
    ({"triangles": np.array([[0, 1, 240]])}, "0 to 240.*0 to 239.*one mesh"),
    ({"triangles": np.array([[0, -1, 2]])}, "-1 to 2.*0 to 239"),
    ({"triangles": np.array([[0.0, 1.0, 2.0]])}, "float64.*whole numbers"),
    ({"triangles": np.empty((0, 3), dtype=int)}, r"\(0, 3\)"),
    ({"shapes": np.zeros((4, 240, 2))}, r"\(4, 240, 2\).*\(K, N, 3\)"),
    ({"rest": np.zeros((239, 3))}, "239 nodes, but the shapes have 240"),
    ({"tip_times": TIME[:-1]}, r"\(300,\) for 301 rows of tip_path"),
    ({"tip_path": TIP_PATH * np.nan}, "903 of 903 values of tip_path.*diverged"),
    ({"tip_times": TIME + 1.0}, "0.6 to 5.8 s, but tip_path covers only 1 to 7 s"),
    ({"times": np.array([3.0, 2.0, 4.0, 5.0])}, "are not ascending"),
    ({"plane": (0, 3)}, r"\(0, 3\)"),
    ({"plane": (1, 1)}, r"\(1, 1\)"),
])
def test_arrays_that_do_not_fit_together_are_refused_with_both_numbers(changed, message, tmp_path):
    given = motion() | changed
    with pytest.raises(ValueError, match=message):
        robot_stills(**given)
    with pytest.raises(ValueError, match=message):
        robot_animation(tmp_path / "robot.gif", **given)
    assert not list(tmp_path.iterdir())


def test_the_path_so_far_ends_at_the_tip_at_that_time():
    given = motion()
    given["times"] = given["times"] + 0.005
    stages, planes = rows(robot_stills(**given))
    for time, stage, plane in zip(given["times"], stages, planes):
        tip = 1e3 * np.array([np.interp(time, TIME, coordinate) for coordinate in TIP_PATH.T])
        for axes, seen in ((stage, HANGING.frame[:2] @ tip), (plane, tip[:2])):
            path = line_of(axes, "SSMR").get_xydata()
            np.testing.assert_allclose(path[-1], seen, atol=1e-9)
            assert len(path) == 1 + np.sum(TIME < time)
            dot = next(line for line in axes.get_lines() if line.get_marker() == "o")
            np.testing.assert_allclose(dot.get_xydata(), [seen], atol=1e-9)


def test_every_panel_shows_the_whole_reference_over_the_path_over_the_surface():
    stages, planes = rows(robot_stills(**motion()))
    for axes in (*stages, *planes):
        frame = HANGING.frame[:2] if axes in stages else np.eye(3)[:2]
        reference, path = line_of(axes, "reference"), line_of(axes, "SSMR")
        np.testing.assert_allclose(reference.get_xydata(), 1e3 * REFERENCE @ frame.T, atol=1e-9)
        assert reference.get_linestyle() == "--" and reference.get_zorder() > path.get_zorder()
        assert axes in planes or path.get_zorder() > surface_of(axes).get_zorder()


def test_all_stills_have_one_scale_and_hold_everything():
    given = motion()
    figure = robot_stills(**given)
    figure.draw_without_rendering()
    for axes_row in rows(figure):
        assert len({(*axes.get_xlim(), *axes.get_ylim()) for axes in axes_row}) == 1
        assert all(axes.get_aspect() == 1.0 for axes in axes_row)
        sizes = [axes.get_window_extent().size for axes in axes_row]
        np.testing.assert_allclose(sizes, sizes[:1] * len(sizes), rtol=1e-6)
    (left, right), (bottom, top) = rows(figure)[0][0].get_xlim(), rows(figure)[0][0].get_ylim()
    across, up = 1e3 * (HANGING.frame[:2] @ np.concatenate([*given["shapes"], TIP_PATH, REFERENCE]).T)
    assert left < across.min() and across.max() < right and bottom < up.min() and up.max() < top


def test_stills_say_when_and_how_large_in_mm():
    figure = robot_stills(**motion())
    stages, planes = rows(figure)
    assert [axes.get_title() for axes in stages] == ["0.60 s", "2.34 s", "4.06 s", "5.80 s"]
    assert planes[0].get_xlabel() == "x (mm)" and planes[0].get_ylabel() == "y (mm)"
    words = next(text.get_text() for text in stages[0].texts if text.get_text().endswith("mm"))
    bar = next(line for line in stages[0].get_lines() if line.get_linewidth() == 1.6 and line.get_color() == "black")
    assert words == f"{np.ptp(bar.get_xdata()):g} mm"


def test_without_plane_reference_or_rest_there_is_one_row_with_the_path_alone():
    given = motion() | {"plane": None, "reference": None, "rest": None}
    stages, planes = rows(robot_stills(**given, name="yours"))
    assert len(stages) == 4 and not planes and len(stages[0].collections) == 1
    assert line_of(stages[0], "yours").get_color() == figures.colours(["yours"])["yours"]


def test_near_faces_cover_far_ones():
    """A triangle, and half of it nearer to the viewer: the half is painted last, whichever the mesh lists first."""
    far = 0.02 * np.eye(3)
    near = far / 2 + 0.02 * STANDING.frame[2]
    for nodes in (np.concatenate([far, near]), np.concatenate([near, far])):
        figure = robot_stills(nodes[None], np.arange(6).reshape(2, 3), [1.0], TIP_PATH, tip_times=TIME)
        first, last = (path.vertices[:3] for path in surface_of(figure.axes[0]).get_paths())
        np.testing.assert_allclose(first, 1e3 * far @ STANDING.frame[:2].T, atol=1e-9)
        np.testing.assert_allclose(last, 1e3 * near @ STANDING.frame[:2].T, atol=1e-9)


def test_the_shade_depends_on_the_light_but_not_on_the_order_of_a_triangles_nodes():
    light = robot_figures.LIGHT / np.linalg.norm(robot_figures.LIGHT)
    across, along = np.linalg.svd(light[None])[2][1:]
    lit = np.array([[np.zeros(3), across, along]])
    aside = np.array([[np.zeros(3), light, np.array([0.0, 0.0, 1.0])]])
    bright, dark = robot_figures._shade(lit), robot_figures._shade(aside)
    assert (bright > dark).all() and (bright <= robot_figures.LIT).all() and (dark >= robot_figures.SHADOW).all()
    np.testing.assert_allclose(robot_figures._shade(lit[:, [0, 2, 1]]), bright)


@pytest.mark.parametrize("up", ["+x", "+y", "+z", "-x", "-y", "-z"])
def test_a_camera_keeps_lengths_and_orientation_and_shows_up_above(up):
    for elevation, azimuth in ((0.0, 0.0), (35.0, -70.0), (-90.0, 200.0)):
        frame = Camera(elevation, azimuth, up).frame
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        axis = np.eye(3)["xyz".index(up[1])] * (1.0 if up[0] == "+" else -1.0)
        seen = [0.0, np.cos(np.deg2rad(elevation)), np.sin(np.deg2rad(elevation))]
        np.testing.assert_allclose(frame @ axis, seen, atol=1e-12)


def test_a_letter_in_x_and_y_is_not_mirrored_by_the_cameras_at_hand():
    for camera in (STANDING, HANGING):
        assert np.linalg.det(camera.frame[:2, :2]) > 0.2 and camera.frame[0, 0] > 0.8 and camera.frame[1, 1] > 0.2


def test_an_invalid_camera_is_refused():
    with pytest.raises(ValueError, match="'z'; expected one of"):
        Camera(up="z")
    with pytest.raises(ValueError, match="nan°"):
        Camera(azimuth=float("nan"))


def test_the_sheet_is_behind_the_robot_only_where_the_robot_is_nearer():
    for elevation, zorder in ((-24.0, 2.5), (24.0, 1)):
        stages, _ = rows(robot_stills(**motion() | {"camera": Camera(elevation, -70.0, "-z")}))
        assert stages[0].patches[0].get_zorder() == zorder


def test_stills_of_a_large_surface_make_a_small_drawing_that_the_report_takes():
    given = motion(count=5, rings=51, around=30)
    assert len(given["triangles"]) == 3000
    figure = robot_stills(**given)
    drawing = Picture(figure, "The trunk.", "one run", "mm").drawing("figure1")
    assert len(drawing.encode()) < 400e3
    assert drawing.count("data:image/png;base64,") == 5


def test_the_same_stills_give_the_same_drawing():
    assert figures.svg(robot_stills(**motion())) == figures.svg(robot_stills(**motion()))


def test_stills_are_saved_like_every_figure(tmp_path):
    for suffix in figures.FORMATS:
        assert figures.save(robot_stills(**motion(count=1)), tmp_path / f"stills{suffix}").stat().st_size > 1000


@pytest.mark.parametrize("plane", [None, (0, 1)])
def test_an_animation_has_a_frame_per_shape_at_the_rate_asked_for_and_no_leftovers(plane, tmp_path):
    path = robot_animation(tmp_path / "new" / "robot.gif", **motion(count=7) | {"plane": plane}, rate=20.0)
    with Image.open(path) as animation:
        assert animation.n_frames == 7 and animation.info["duration"] == 50 and animation.info["loop"] == 0
    assert [entry.name for entry in path.parent.iterdir()] == ["robot.gif"]


def test_an_animation_shows_the_path_growing(tmp_path):
    path = robot_animation(tmp_path / "robot.gif", **motion(count=4) | {"reference": None})
    blue = []
    with Image.open(path) as animation:
        for frame in range(animation.n_frames):
            animation.seek(frame)
            pixels = np.asarray(animation.convert("RGB"), dtype=int)
            blue.append(np.sum(np.abs(pixels - [0x00, 0x72, 0xB2]).sum(axis=-1) < 60))
    assert (np.diff(blue) > 100).all()


def test_an_animation_that_fails_leaves_the_one_before(tmp_path, monkeypatch):
    def fail(writer):
        raise OSError("no space left")

    path = tmp_path / "robot.gif"
    path.write_bytes(b"the one before")
    monkeypatch.setattr(robot_figures.PillowWriter, "finish", fail)
    with pytest.raises(OSError, match="no space"):
        robot_animation(path, **motion(count=2))
    assert path.read_bytes() == b"the one before" and len(list(tmp_path.iterdir())) == 1


def test_only_a_gif_at_a_rate_it_can_have_is_written(tmp_path):
    with pytest.raises(ValueError, match="robot.mp4.*ending in .gif"):
        robot_animation(tmp_path / "robot.mp4", **motion())
    with pytest.raises(ValueError, match="100.0 frames per second; a GIF can show 1 to 50"):
        robot_animation(tmp_path / "robot.gif", **motion(), rate=100.0)


def test_drawing_changes_nothing_of_the_callers():
    given = motion()
    before = {name: value.copy() for name, value in given.items() if isinstance(value, np.ndarray)}
    robot_stills(**given)
    for name, value in before.items():
        np.testing.assert_array_equal(given[name], value)
    code = "import sys; import ssmr_torch.evaluation.robot_figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
