"""Pictures: the right colour at the right place, the right words, the same bytes."""

from dataclasses import replace

import numpy as np
import pytest

from restoration import canvas, page
from restoration.canvas import Panel, time_text
from restoration.errors import OutputError
from restoration.figures import BOTTOM, LEFT, draw_section, draw_strip, draw_there_and_back
from restoration.scene import (
    Line,
    Outline,
    OutputPlan,
    ParticlePlan,
    Rock,
    Scene,
    TimePlan,
    Transfer,
    Unit,
    Wall,
)
from restoration.units import YEAR

MYR = 1e6 * YEAR
WIDTH, HEIGHT = 9142.0, 10e3
SALT, SAND, WHITE = (242, 166, 194), (217, 196, 143), (255, 255, 255)


def interface(x):
    return -8e3 + 200 * np.cos(np.pi * x / WIDTH)


def make_scene(marks=(0, 6 * MYR, 0), exaggeration=1.0, surface=((0, 0), (WIDTH, 0)), title="T"):
    wall = Wall("no-slip", (0.0, 0.0), (0.0, 0.0))
    return Scene(
        title=title,
        outline=Outline(np.array(surface, float), np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])),
        rocks=(Rock("salt", 2150, 1e19, "#f2a6c2"), Rock("clastics", 2600, 1e19, "#d9c48f")),
        units=(Unit("salt", 0, "#f2a6c2"), Unit("Trias", 1, "#d9c48f")),
        unit_at=lambda p: (p[:, 1] > interface(p[:, 0])).astype(np.int16),
        lines=(),
        walls=dict.fromkeys(("left", "right", "base", "surface"), wall),
        gravity=9.81,
        cells=(32, 35),
        particles=ParticlePlan(16, 5, 0.5, 1),
        transfer=Transfer("hat", "hat", "harmonic"),
        time=TimePlan(tuple(marks), "midpoint", 0.5, 10),
        output=OutputPlan("marks", ("velocity",), True, True, exaggeration),
        cloud=None,
        notes=(),
    )


def flow(p):
    """Return an overturn that rises on the left, m/s; a stream function, zero on the walls."""
    a, b = np.pi * p[:, 0] / WIDTH, np.pi * (p[:, 1] + HEIGHT) / HEIGHT
    top = 5e-3 / YEAR
    return top * np.column_stack(
        [-np.sin(a) * np.sin(2 * b), np.cos(a) * np.sin(b) ** 2 * HEIGHT / WIDTH]
    )


def march(p, time, steps):
    for _ in range(steps):
        p = p + time / steps * flow(p + 0.5 * time / steps * flow(p))
    return p


@pytest.fixture(scope="module")
def cloud():
    return np.random.default_rng(0).random((20_000, 2)) * [WIDTH, HEIGHT] - [0, HEIGHT]


@pytest.fixture(scope="module")
def horizon():
    x = np.linspace(0, WIDTH, 200)
    return Line("salt / Trias", "horizon", np.column_stack([x, interface(x)]))


@pytest.fixture
def saved(monkeypatch):
    """Collect the figures that are saved."""
    kept = []
    save = page.Page.save
    monkeypatch.setattr(
        page.Page, "save", lambda self, path: (kept.append(self.figure), save(self, path))
    )
    return kept


def words(figure):
    from matplotlib.text import Text

    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def pixels(path, exaggeration=1.0):
    """Return the image of the section alone and a function that gives the colour at (x, z)."""
    from matplotlib.image import imread

    image = np.round(255 * imread(path)[..., :3]).astype(int)
    width = min(1400, 1400 / (exaggeration * HEIGHT / WIDTH))
    size = round(width), round(width * exaggeration * HEIGHT / WIDTH)
    low = image.shape[0] - BOTTOM
    part = image[low - size[1] : low, LEFT : LEFT + size[0]]

    def at(x, z):
        return tuple(part[int(-z / HEIGHT * size[1]), int(x / WIDTH * size[0])])

    return part, at


@pytest.mark.parametrize("exaggeration", [1.0, 2.0, 0.5])
def test_rocks_have_their_colours_where_they_are(tmp_path, cloud, exaggeration):
    scene = make_scene(exaggeration=exaggeration)
    x = march(cloud, 4 * MYR, 40)
    draw_section(tmp_path / "a.png", scene, 4 * MYR, x, scene.unit_at(cloud))
    part, at = pixels(tmp_path / "a.png", exaggeration)
    assert at(100, -5000) == SALT  # the salt has risen on the left
    assert at(100, -1200) == SALT
    assert at(9000, -5000) == at(4500, -5000) == at(100, -100) == SAND
    assert at(9000, -9900) == SALT
    assert at(4500, -9200) == SAND
    inner = part[4:-4, 4:-4].reshape(-1, 3)  # the frame is a line
    assert {tuple(color) for color in np.unique(inner, axis=0)} == {SALT, SAND}
    share = np.mean((inner == SALT).all(axis=1))
    assert share == pytest.approx(0.2, abs=0.01)


def test_nothing_is_drawn_above_the_surface(tmp_path, cloud):
    surface = [(0, -2000), (WIDTH / 2, 0), (WIDTH, -4000)]
    scene = make_scene(surface=surface)
    draw_section(tmp_path / "a.png", scene, 0, cloud, scene.unit_at(cloud))
    _, at = pixels(tmp_path / "a.png")
    assert at(200, -1500) == at(9000, -3500) == WHITE
    assert at(200, -2500) == at(9000, -4500) == at(WIDTH / 2, -300) == SAND
    flat = replace(scene, outline=make_scene().outline)
    draw_section(tmp_path / "b.png", flat, 0, cloud, flat.unit_at(cloud), outline=scene.outline)
    _, at = pixels(tmp_path / "b.png")
    assert at(200, -1500) == WHITE


def test_lines_are_drawn_where_they_are(tmp_path, cloud):
    scene = make_scene()
    fault = Line("F1", "fault", np.array([[2000.0, -1000], [4000, -6000]]))
    level = Line("top", "horizon", np.array([[0.0, -4000], [WIDTH, -4000]]))
    draw_section(tmp_path / "a.png", scene, 0, cloud, scene.unit_at(cloud), [fault, level])
    _, at = pixels(tmp_path / "a.png")
    red, green, blue = at(3000, -3500)
    assert red > 150 > 80 > green
    assert red > 150 > 80 > blue
    assert max(min(at(8000, z) for z in range(-4010, -3990, 2))) < 60
    assert at(8000, -4050) == at(3000, -3300) == SAND


def test_section_says_what_it_shows(tmp_path, saved, cloud, horizon):
    scene = make_scene(title="Profil 7 $x_{$")
    draw_section(
        tmp_path / "a.png",
        scene,
        4 * MYR,
        cloud,
        scene.unit_at(cloud),
        [horizon],
        (cloud, flow(cloud)),
    )
    found = words(saved[0])
    for word in ("Profil 7 $x_{$", "t = 4.00 Myr", "Distance (km)", "Depth (km)"):
        assert word in found
    assert "V.E. 1:1      2 km" in found
    legend = [
        text.strip() for text in found if text.strip() in ("Trias (clastics)", "salt", "horizon")
    ]
    assert legend == ["Trias (clastics)", "salt", "horizon"]
    assert {"0", "2", "10"} <= set(found)
    assert not any(word.startswith("-") for word in found)  # depths count downwards


def test_elevation_exaggeration_and_odd_names(tmp_path, saved, cloud):
    scene = make_scene((0, -2 * MYR), 2.5, [(0, -50), (WIDTH, 0)])
    scene = replace(
        scene, units=(Unit("_salt", 0, "#f2a6c2"), Unit("a\n$b_{" + 50 * "x", 1, "#d9c48f"))
    )
    draw_section(tmp_path / "a.png", scene, -1.5 * MYR, cloud, scene.unit_at(cloud))
    found = words(saved[0])
    assert "Elevation (km)" in found
    assert "1.50 Ma" in found
    assert "V.E. \N{MULTIPLICATION SIGN} 2.5      2 km" in found
    assert {"-2", "-10"} <= set(found)
    assert any("_salt (salt)" in word for word in found)
    assert any(word.strip().startswith("a $b_{xxx") and len(word) < 35 for word in found)


def test_small_sections_are_in_metres(tmp_path, saved, cloud):
    scene = make_scene(surface=[(0, 0), (0.9, 0)])
    outline = Outline(scene.outline.surface, np.array([[0, -0.4], [0.9, -0.4]]))
    x = cloud * [0.9 / WIDTH, 0.4 / HEIGHT]
    draw_section(
        tmp_path / "a.png",
        replace(scene, outline=outline),
        0,
        x,
        scene.unit_at(cloud),
        label="first",
    )
    found = words(saved[0])
    assert {"Distance (m)", "Depth (m)", "V.E. 1:1      0.2 m", "first", "0.8"} <= set(found)


def test_long_legend_fits_on_the_page(tmp_path, saved, cloud):
    scene = make_scene(exaggeration=0.1)
    units = tuple(Unit(f"unit {k}", k % 2, "#d9c48f") for k in range(30))
    draw_section(tmp_path / "a.png", replace(scene, units=units), 0, cloud, scene.unit_at(cloud))
    box = saved[0].legends[0].get_window_extent()
    assert box.y0 > 0
    assert box.x1 < saved[0].bbox.x1


def test_arrows_show_the_velocity(tmp_path, saved, cloud):
    from matplotlib.quiver import Quiver, QuiverKey

    scene = make_scene()
    draw_section(
        tmp_path / "a.png", scene, 0, cloud, scene.unit_at(cloud), velocity=(cloud, flow(cloud))
    )
    [arrows] = saved[0].findobj(Quiver)
    u = np.column_stack([arrows.U, arrows.V])
    np.testing.assert_array_equal(u, flow(arrows.XY))
    assert 200 < len(u) < 500
    assert arrows.angles == "xy"  # so that they lie along the flow when exaggerated
    [key] = saved[0].findobj(QuiverKey)
    assert pytest.approx(5e-3 / YEAR) == key.U
    assert key.text.get_text() == "5 mm/yr"
    draw_section(
        tmp_path / "b.png", scene, 0, cloud, scene.unit_at(cloud), velocity=(cloud, 0 * cloud)
    )
    assert saved[1].findobj(Quiver) == []


@pytest.mark.parametrize(
    ("marks", "time", "before", "text"),
    [
        ((0, 6, 0), 6, None, "t = 6.00 Myr"),
        ((0, 6, 0), 0, None, "t = 0.00 Myr"),
        ((0, 6, 0), 0, 6, "t = 0.00 Myr (restored)"),
        ((0, 6, 0), 6, 0, "t = 6.00 Myr"),
        ((0, -2), 0, None, "today"),
        ((0, -2), -2, None, "2.00 Ma"),
        ((0, -2), -2, 0, "2.00 Ma (restored)"),
        ((-2, 0), -2, None, "2.00 Ma"),
        ((0, -2, 0), 0, -2, "today (forward)"),
        ((0, 0.035), 0.035, 0, "t = 35.00 kyr"),
        ((0, -0.02), -0.01, 0, "10.00 ka (restored)"),
    ],
)
def test_time_in_words(marks, time, before, text):
    scene = make_scene([mark * MYR for mark in marks])
    assert time_text(scene, time * MYR, None if before is None else before * MYR) == text


def test_strip_has_one_scale_and_one_legend(tmp_path, saved, cloud, horizon):
    scene = make_scene()
    unit = scene.unit_at(cloud)
    later = march(cloud, 4 * MYR, 40)
    panels = [
        Panel(scene, 0.0, cloud, unit, (horizon,), label="start"),
        Panel(scene, 4 * MYR, later, unit),
        (scene, 0.0, cloud, unit, [horizon]),
    ]
    draw_strip(tmp_path / "strip.png", panels)
    [figure] = saved
    assert len(figure.axes) == 3
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in figure.axes}) == 1
    assert len({tuple(axes.bbox.size.round()) for axes in figure.axes}) == 1
    assert len({round(axes.bbox.y0) for axes in figure.axes}) == 1  # side by side
    assert len(figure.legends) == 1
    assert {"start", "t = 4.00 Myr", "t = 0.00 Myr (restored)"} <= set(words(figure))
    first, second, third = (axes.images[0].get_array() for axes in figure.axes)
    np.testing.assert_array_equal(first, third)
    row, column = first.shape[0] // 2, 5
    assert tuple(second[row, column][:3]) == SALT
    assert tuple(first[row, column][:3]) == SAND


def test_wide_strip_goes_downwards(tmp_path, saved, cloud):
    scene = make_scene(exaggeration=0.1)
    draw_strip(
        tmp_path / "s.png", [(scene, k * MYR, cloud, scene.unit_at(cloud)) for k in range(4)]
    )
    assert len({round(axes.bbox.x0) for axes in saved[0].axes}) == 1
    assert [axes.bbox.y0 for axes in saved[0].axes] == sorted(
        (axes.bbox.y0 for axes in saved[0].axes), reverse=True
    )


@pytest.mark.parametrize("exaggeration", [1.0, 0.1])
def test_there_and_back(tmp_path, saved, cloud, horizon, exaggeration):
    scene = make_scene(exaggeration=exaggeration)
    end = cloud + np.where(cloud[:, :1] < WIDTH / 2, [3.0, 4.0], [30.0, 40.0])
    start = cloud.copy()
    start[:7] = np.nan
    back = Line(horizon.name, "horizon", horizon.points + np.array([0, 12]))
    stats = {"mean_m": 27.5, "p99_m": 50.0, "max_m": 50.0}
    stats["horizons"] = [{"name": horizon.name, "mean_m": 11.2, "max_m": 12.0}]
    draw_there_and_back(
        tmp_path / "t.png", scene, start, end, scene.unit_at(cloud), [horizon], [back], stats
    )
    where, _, histogram, lines = saved[0].axes
    distance = where.images[0].get_array()
    assert distance[50, 10] == pytest.approx(5)
    assert distance[50, -10] == pytest.approx(50)
    assert sum(bar.get_height() for bar in histogram.patches) == len(cloud) - 7
    assert histogram.get_xscale() == histogram.get_yscale() == "log"
    assert [line.get_xdata()[0] for line in histogram.lines] == [27.5, 50, 50]
    drawn = [line.get_xydata() for line in lines.lines]
    assert any(np.array_equal(points, horizon.points) for points in drawn)
    assert any(np.array_equal(points, back.points) for points in drawn)
    found = words(saved[0])
    assert {"mean 27.5 m", "p99 50 m", "max 50 m", "19993 particles by their distance"} <= set(
        found
    )
    assert any("salt / Trias\n   mean 11.2 m, max 12 m" in word for word in found)


def test_exact_return_can_be_drawn(tmp_path, cloud):
    scene = make_scene()
    stats = {"mean_m": 0.0, "p99_m": 0.0, "max_m": 0.0}
    draw_there_and_back(
        tmp_path / "t.png", scene, cloud, cloud, scene.unit_at(cloud), [], [], stats
    )
    assert (tmp_path / "t.png").stat().st_size > 10_000


def test_same_bytes_whatever_the_users_settings(tmp_path, cloud, horizon):
    import matplotlib

    scene = make_scene()
    draw_section(tmp_path / "a.png", scene, 0, cloud, scene.unit_at(cloud), [horizon])
    with matplotlib.rc_context({"font.size": 30, "xtick.minor.visible": True}):
        draw_section(tmp_path / "b.png", scene, 0, cloud, scene.unit_at(cloud), [horizon])
        assert matplotlib.rcParams["font.size"] == 30
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_picture_that_cannot_be_written(tmp_path, cloud):
    scene = make_scene()
    (tmp_path / "figures").write_text("")
    with pytest.raises(OutputError, match=r"a.png: not written: a file stands where a folder"):
        draw_section(tmp_path / "figures" / "a.png", scene, 0, cloud, scene.unit_at(cloud))


def test_matplotlib_is_imported_late():
    import subprocess
    import sys

    code = "import sys, restoration.figures; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_nearest_particle_is_the_nearest(cloud):
    panel = Panel(make_scene(), 0.0, cloud, None)
    found = canvas.nearest_particle(panel, (0, WIDTH, -HEIGHT, 0), (7, 5))
    for row, column in ((0, 0), (4, 0), (0, 6), (2, 3)):
        place = [(column + 0.5) * WIDTH / 7, -(row + 0.5) * HEIGHT / 5]
        assert found[row, column] == np.argmin(np.hypot(*(cloud - place).T))


@pytest.mark.parametrize(
    ("value", "expected"), [(1.0, 1), (2.0, 2), (4.9, 2), (5.0, 5), (99, 50), (0.03, 0.02)]
)
def test_round_number(value, expected):
    assert page.round_number(value) == pytest.approx(expected)


def test_pictures_have_no_holes(tmp_path, cloud):
    """One particle alone fills the section."""
    scene = make_scene()
    draw_section(tmp_path / "a.png", scene, 0, cloud[:1], np.array([1], np.int16))
    _, at = pixels(tmp_path / "a.png")
    assert at(100, -100) == at(9000, -9900) == SAND
