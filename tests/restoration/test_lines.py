import numpy as np
import pytest

from restoration.lines import as_drawn, begin, points_of, refined, with_points
from restoration.scene import Line


def arc(n, radius=100.0):
    angle = np.linspace(0, np.pi, n)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def moving(points, name="a", kind="horizon"):
    (line,) = begin((Line(name, kind, np.asarray(points, float)),), longest=1e9)
    return line


def test_points_go_out_and_come_back():
    lines = (moving(arc(7)), moving(arc(4), "b", "fault"))
    moved = with_points(lines, points_of(lines) + 1)
    assert [(line.name, line.kind, len(line.points)) for line in moved] == [
        ("a", "horizon", 7),
        ("b", "fault", 4),
    ]
    assert moved[1].points == pytest.approx(arc(4) + 1)
    assert points_of(()).shape == (0, 2)
    assert with_points((), points_of(())) == ()


def test_new_vertices_lie_on_the_curve_to_fourth_order():
    off = []
    for n in (9, 17, 33):
        (line,) = refined((moving(arc(n)),), 1.0, 0.1, 1.0, 1.0)
        assert len(line.points) == 2 * n - 1
        assert line.points[line.way == 0] == pytest.approx(arc(n))
        inner = line.points[3:-3:2]
        off.append(np.abs(np.linalg.norm(inner, axis=1) - 100).max())
    assert np.log2(off[0] / off[1]) > 3.5
    assert np.log2(off[1] / off[2]) > 3.5


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_added_vertices_go_when_time_turns(way):
    lines = (moving(arc(30)),)
    for step in range(1, 6):
        lines = refined(lines, 2.0, 0.1, way * step, way)
    assert len(lines[0].points) > 100
    counts = []
    for step in (4.5, 3.5, 2.5, 1.5, 0.5):
        lines = refined(lines, 1e9, 1e9, way * step, -way)
        counts.append(len(lines[0].points))
    assert counts == sorted(counts, reverse=True)
    assert lines[0].points == pytest.approx(arc(30))
    assert as_drawn(lines)[0].points == pytest.approx(arc(30))


def test_what_was_added_beside_added_vertices_goes_with_them():
    """Stretched there, stretched more on the way back, and yet only the drawn ones remain."""
    lines = (moving(arc(30)),)
    for step in (1.0, 2.0, 3.0):
        lines = refined(lines, 4.0, 0.1, step, 1.0)
    lines = refined(lines, 1.0, 0.1, 2.9, -1.0)
    assert len(lines[0].points) > 200
    lines = refined(lines, 1e9, 1e9, 0.5, -1.0)
    assert lines[0].points == pytest.approx(arc(30))


def test_short_segments_are_left_alone():
    (line,) = refined((moving(arc(200)),), longest=50.0, shortest=10.0, time=1.0, dt=1.0)
    assert len(line.points) == 200


def test_sharp_turns_get_vertices():
    corner = moving([[0, 0], [10, 0], [20, 0], [20, 10], [20, 20]])
    assert len(refined((corner,), longest=50.0, shortest=1.0, time=1.0, dt=1.0)[0].points) == 7


def test_uneven_vertices_do_not_overshoot():
    """A long straight segment between short ones at an angle stays where it is."""
    line = moving([[0, 0], [1, 2], [2, 4], [1002, 4], [1003, 2], [1004, 0]])
    for _ in range(12):
        (line,) = refined((line,), longest=10.0, shortest=1.0, time=1.0, dt=1.0)
    assert line.points[:, 1].min() >= -1e-9
    assert line.points[:, 1].max() < 5
    assert (np.diff(line.points[:, 0]) > 0).all()


def test_drawn_lines_are_spaced_on_their_segments():
    corner = Line("a", "fault", np.array([[0, 0], [10, 0], [10, 3.0]]))
    points = begin((corner,), longest=2.5)[0].points
    assert points == pytest.approx(
        np.array([[0, 0], [2.5, 0], [5, 0], [7.5, 0], [10, 0], [10, 1.5], [10, 3]])
    )


def test_two_points_are_halved_on_their_chord():
    line = moving([[0, 0], [100, 0]])
    assert refined((line,), 60.0, 1.0, 1.0, 1.0)[0].points == pytest.approx(
        np.array([[0, 0], [50, 0], [100, 0]])
    )


def test_vertices_end_at_the_most():
    """A line that is stirred without end keeps its vertices, and halves its longest segments."""
    line = moving(np.column_stack([np.r_[0, 1, 10, 100.0], np.zeros(4)]))
    (fuller,) = refined((line,), longest=0.1, shortest=0.01, time=1.0, dt=1.0, most=5)
    assert sorted(fuller.points[:, 0]) == pytest.approx([0, 1, 10, 55, 100])
    assert len(refined((fuller,), 0.1, 0.01, 2.0, 1.0, most=5)[0].points) == 5
